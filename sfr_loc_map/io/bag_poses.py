"""Poses in a bag: odometry topics and static transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.plausibility import check_extrinsics
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.io.bag import ODOMETRY, TF, Bag, Topic
from sfr_loc_map.io.trajectory_file import check_order

GROUND_TRUTH = "ground_truth/odometry"
CONFIGURATION = "localisation/configuration"
STRING = "std_msgs/msg/String"


@dataclass(frozen=True, slots=True, eq=False)
class BagOdometry:
    """The messages of an odometry topic.

    Attributes:
        trajectory: Poses in the order of recording.
        covariance: `(N, 6, 6)` of position and rotation, as in the messages (m^2, rad^2).
    """

    trajectory: Trajectory
    covariance: FloatArray


def read_odometry(bag: Bag, topic: Topic) -> BagOdometry:
    """Read the poses of an odometry topic.

    Raises:
        InputError: If a pose is not finite or its quaternion has no length.
    """
    stamps, rows, covariances = [], [], []
    for _, stamp_ns, message in bag.messages([topic]):
        position, quat = message.pose.pose.position, message.pose.pose.orientation
        stamps.append(stamp_ns)
        rows.append((position.x, position.y, position.z, quat.x, quat.y, quat.z, quat.w))
        covariances.append(message.pose.covariance)
    values = np.array(rows, np.float64).reshape(-1, 7)
    try:
        trajectory = Trajectory(np.array(stamps, np.int64), values[:, :3].copy(), values[:, 3:].copy())
    except GeometryError as error:
        raise InputError(f"'{topic.bag_name}' of bag '{bag.path}': {error}") from error
    return BagOdometry(trajectory, np.array(covariances, np.float64).reshape(-1, 6, 6))


def read_trajectory(bag: Bag, name: str) -> Trajectory | None:
    """Read the poses of an odometry topic by its relative name; None if the bag has none.

    Args:
        bag: The bag.
        name: `ground_truth/odometry` or `localisation/odometry`, within any one namespace.

    Raises:
        InputError: If a pose is not finite, its quaternion has no length, or stamps go backwards.
    """
    topic = bag.find(name, ODOMETRY)
    if topic is None:
        return None
    trajectory = read_odometry(bag, topic).trajectory
    check_order(trajectory.stamps_ns.tolist(), f"'{topic.bag_name}' of bag '{bag.path}'", strict=False)
    return trajectory if len(trajectory) else None


def read_extrinsics(bag: Bag, rb_frame: str, sb_frame: str) -> Transform | None:
    """Return `T_rb_sb` of `/tf_static`, else of the parameters of the localisation node that was recorded, or None.

    A recording of nodes that have it as a parameter may be without `/tf_static`, which needs tf2_msgs.

    Raises:
        InputError: If it is there but no rigid motion.
    """
    return read_static_transform(bag, rb_frame, sb_frame) or _configured_extrinsics(bag)


def _configured_extrinsics(bag: Bag) -> Transform | None:
    found = [name for name in bag.matches(CONFIGURATION) if bag.topics[name] == STRING]
    if len(found) != 1:  # none, or of several rovers
        return None
    topic = Topic(CONFIGURATION, found[0], STRING)
    message = bag.first([topic]).get(topic.name)
    if message is None:
        return None
    where = f"'{topic.bag_name}' of bag '{bag.path}'"
    try:
        values = parse_json(message.data)
        translation, quat = (values.get(f"T_rb_locsb.{name}", []) for name in ("translation_m", "quat_xyzw"))
        if not any(quat):  # not given
            return None
        transform = Transform.from_quat(np.array(translation, np.float64), np.array(quat, np.float64))
        check_extrinsics(transform.translation)
    except (GeometryError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{where}: T_rb_locsb cannot be read: {error}; leave the topic out") from error
    return transform


def read_static_transform(bag: Bag, parent: str, child: str) -> Transform | None:
    """Return `T_parent_child` of `/tf_static`, over frames in between where there are some, or None.

    Raises:
        InputError: If a transform is not a rigid motion.
    """
    topic = bag.find("tf_static", TF)
    if topic is None:
        return None
    frames = FrameTree()
    for _, _, message in bag.messages([topic]):
        for item in message.transforms:
            position, quat = item.transform.translation, item.transform.rotation
            try:
                pose = Transform.from_quat((position.x, position.y, position.z), (quat.x, quat.y, quat.z, quat.w))
            except GeometryError as error:
                raise InputError(f"/tf_static of bag '{bag.path}': '{item.child_frame_id}': {error}") from error
            frames.add(item.header.frame_id.strip("/"), item.child_frame_id.strip("/"), pose)
    return frames.find(parent, child)
