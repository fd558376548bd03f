"""Poses in a bag: odometry, the frames on /tf and /tf_static, and the extrinsics of a rig."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.extrinsics import RigInBody, rig_in_body
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.plausibility import check_extrinsics
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.frames import (
    Frame,
    FrameSeries,
    add_transform,
    body_of,
    check_one_body,
    pose_row,
    trajectory_of,
    valid_indices,
)
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.message_types import STRING, TF
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import configuration_topic

_log = logging.getLogger(__name__)


def read_odometry(bag: Bag, topic: Topic) -> tuple[Trajectory, FloatArray]:
    """Read the poses and covariances `(N, 6, 6)` (m^2, rad^2) of a topic in the order of recording.

    Invalid poses among valid poses are skipped, as in the monitor, and a warning reports their number. InputError if
    the topic has several bodies or frames.
    """
    rows, covariances, bodies = [], [], set[tuple[str, str]]()
    for _, _, message in bag.messages([topic]):
        bodies.add(body_of(message))
        rows.append(pose_row(message, message.pose.pose))
        covariances.append(message.pose.covariance)
    where = f"'{topic.bag_name}' of bag '{bag.path}'"
    check_one_body(bodies, where)
    valid = valid_indices(rows, where)
    with refusing(where, "record it again"):
        trajectory = trajectory_of([rows[k] for k in valid])
    return trajectory, np.array([covariances[k] for k in valid], np.float64).reshape(-1, 6, 6)


def read_frame_tree(bag: Bag) -> FrameTree:
    """Return the tree of the frames in `/tf_static`; empty if the bag does not have this topic.

    A warning reports a frame with several parents, of which the last is used.
    """
    frames, topic = FrameTree(), bag.find("tf_static", TF)
    parents: dict[str, str] = {}
    for _, _, message in () if topic is None else bag.messages([topic]):
        for item in message.transforms:
            child, parent = item.child_frame_id.strip("/"), item.header.frame_id.strip("/")
            earlier = parents.get(child, parent)
            parents[child] = parent
            if earlier != parent:
                _log.warning(
                    f"/tf_static of bag '{bag.path}': '{child}' has the parents '{earlier}' and '{parent}': the last "
                    "is used"
                )
            with refusing(f"/tf_static of bag '{bag.path}': '{child}'", "record it again"):
                add_transform(frames, item)
    return frames


def read_frames(bag: Bag, child: str = "", parent: str = "") -> dict[str, Frame]:
    """Return the frames in `/tf` and `/tf_static` that have a parent, with their poses; see `FrameSeries.chosen`."""
    series = FrameSeries()
    for name in ("tf_static", "tf"):
        topic = bag.find(name, TF)
        for _, _, message in () if topic is None else bag.messages([topic]):
            for item in message.transforms:
                frame = series.frame_of(item, is_static=name == "tf_static")
                frame.rows.append(pose_row(item, item.transform))
    return series.chosen(child, parent)


def read_extrinsics(bag: Bag, camera_frame: str, baseline_m: float, base_frame: str = "") -> RigInBody | None:
    """Return the pose of the rig from /tf_static or, if unknown there, from a recorded localisation node; else None."""
    if (mount := rig_in_body(read_frame_tree(bag), camera_frame, baseline_m, base_frame)) is not None:
        return replace(mount, read_from=f"/tf_static, {mount.read_from}")
    configuration = configuration_topic(Task.LOCALISATION)
    found_in = [name for name in bag.matches(configuration) if bag.topics[name] == STRING]
    if len(found_in) != 1:  # the topic is missing, or there are topics of several rovers
        return None
    message = bag.first([Topic(configuration, found_in[0], STRING)]).get(configuration)
    if message is None:
        return None
    advice = "set extrinsics.translation_m and extrinsics.quat_xyzw in sfr.yaml"
    with refusing(f"'{found_in[0]}' of bag '{bag.path}': T_rb_locsb cannot be read", advice):
        values = parse_json(message.data)
        if not isinstance(values, dict):
            raise TypeError("the message is not a JSON object")
        translation, quat = (values.get(f"T_rb_locsb.{name}", []) for name in ("translation_m", "quat_xyzw"))
        if not any(quat):  # not given
            return None
        transform = Transform.from_quat(np.array(translation, np.float64), np.array(quat, np.float64))
        check_extrinsics(transform.translation)
    return RigInBody(transform, found_in[0])
