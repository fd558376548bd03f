"""The pairs of a task in a bag without their images: the stamps of the messages of each pair, and its pose.

One pass over the topics of the task reads the stamps of all messages, the poses of mapping pairs, and the calibrations,
which must be constant. The stamps determine the pairs (`stamp_pairs`).
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.bag import Bag, Topic, restamped
from sfr_loc_map.io.bag.frames import pose_of
from sfr_loc_map.io.layouts.bag_cameras import BagCameras, CameraTopics, require_topic
from sfr_loc_map.io.layouts.head_pose import head_poses
from sfr_loc_map.io.layouts.stamp_pairs import stereo_pairs, without_partner
from sfr_loc_map.io.source_config import FramesConfig, SyncConfig
from sfr_loc_map.io.stamps.stamp_checks import increasing_stamps
from sfr_loc_map.message_types import POINTS, POSE
from sfr_loc_map.stamp_pairing import match_stamps
from sfr_loc_map.topics import NAV_POSE, TRUE_POINTS

_log = logging.getLogger(__name__)

_Pairs = dict[int, dict[str, int]]
"""For the stamp of each pair, which is that of its left image, the stamps of its messages by topic; ns."""


@dataclass(frozen=True, slots=True)
class BagIndex:
    """The pairs of a task in a bag."""

    pairs: Mapping[int, Mapping[str, int]]
    """For the stamp of each pair, in ascending order, the stamps of its messages by topic; ns."""
    missing_ns: tuple[int, ...]
    """Stamps of left images without a right image, or of mapping pairs without a pose. These pairs are skipped."""
    T_lm_navsb: Mapping[int, Transform]
    """Poses of the mapping pairs by their stamps; empty for a drive."""


@dataclass(frozen=True, slots=True)
class MappingTopics:
    """The topics of mapping pairs in a bag."""

    cameras: CameraTopics
    points: Topic | None  #: True points; None without truth.
    poses: Topic | None  #: `nav/pose`; None if the poses are those of frames or joints (`head_pose`).

    @classmethod
    def of(cls, cameras: CameraTopics) -> MappingTopics:
        """Return the topics of mapping pairs; InputError if a topic has a wrong type."""
        bag = cameras.bag
        poses = require_topic(bag, NAV_POSE, POSE) if bag.matches(NAV_POSE) else None
        return cls(cameras, bag.find(TRUE_POINTS, POINTS), poses)


def index_of_drive(topics: CameraTopics, sync: SyncConfig) -> BagIndex:
    """Read the index of a drive."""
    stamps_ns = _read(topics).stamps_ns
    pairs = _image_pairs(topics, stamps_ns, sync)
    missing_ns = () if topics.layout else without_partner(stamps_ns[topics.images[0].name], pairs)
    return BagIndex(pairs, missing_ns, {})


def index_of_mapping(topics: MappingTopics, cameras: BagCameras, sync: SyncConfig, frames: FramesConfig) -> BagIndex:
    """Read the index of mapping pairs; a warning reports pairs without a pose."""
    bag, points, poses = topics.cameras.bag, topics.points, topics.poses
    messages = _read(topics.cameras, points, poses)
    pairs = _image_pairs(topics.cameras, messages.stamps_ns, replace(sync, right_offset_s=0.0))
    if points is not None:
        matched = match_stamps(list(pairs), messages.stamps_ns[points.name], sync.stamp_tolerance_ns)
        for stamp_ns, points_ns in matched.items():
            pairs[stamp_ns][points.name] = points_ns
    if poses is None:
        T_rb_navsb = head_poses(bag, cameras.frame, cameras.rig.baseline_m, tuple(pairs), frames)
        return BagIndex(pairs, (), dict(zip(pairs, T_rb_navsb, strict=True)))  # LM is RB (docs/formats.md)
    pose_of_pair = _matching_poses(bag, list(pairs), messages.poses, sync)
    return BagIndex(
        {stamp_ns: pairs[stamp_ns] | {poses.name: pose_ns} for stamp_ns, pose_ns in pose_of_pair.items()},
        tuple(stamp_ns for stamp_ns in pairs if stamp_ns not in pose_of_pair),
        {stamp_ns: messages.poses[pose_ns] for stamp_ns, pose_ns in pose_of_pair.items()},
    )


class _Messages(NamedTuple):
    """The content of the messages of a task that determines the pairs."""

    stamps_ns: dict[str, list[int]]  #: Increasing stamps of images and true points by topic.
    poses: dict[int, Transform]  #: Poses on `nav/pose` by stamp.


def _read(cameras: CameraTopics, points: Topic | None = None, poses: Topic | None = None) -> _Messages:
    """Read the messages of a task in one pass, and check its calibrations.

    InputError if a calibration changes, if all stamps of a topic are 0, if many do not increase, or if a pose is
    invalid.
    """
    bag = cameras.bag
    stamped = [*cameras.images, *([points] if points else [])]
    stamps_ns: dict[str, list[int]] = {topic.name: [] for topic in stamped}
    infos: dict[str, set[bytes]] = {topic.name: set() for topic in cameras.infos}
    pose_by_stamp: dict[int, Transform] = {}
    repeated_poses = 0
    for topic, stamp_ns, raw in bag.stream([*stamped, *cameras.infos, *([poses] if poses else [])]):
        if topic.name in stamps_ns:
            stamps_ns[topic.name].append(stamp_ns)
        elif topic.name in infos:
            infos[topic.name].add(restamped(raw, 0))
        elif stamp_ns in pose_by_stamp:
            repeated_poses += 1
        else:
            pose_by_stamp[stamp_ns] = _pose_in(bag, topic, stamp_ns, raw)
    for topic in cameras.infos:
        cameras.check_one_calibration(topic, infos[topic.name])
    if poses is not None and repeated_poses:
        _log.warning(
            f"bag '{bag.path}', '{poses.bag_name}': {repeated_poses} of {repeated_poses + len(pose_by_stamp)} messages "
            "ignored: they have the stamps of earlier ones"
        )
    increasing_ns = {}
    for topic in stamped:
        where = f"bag '{bag.path}', '{topic.bag_name}'"
        increasing_ns[topic.name] = increasing_stamps(stamps_ns[topic.name], where)
    return _Messages(increasing_ns, pose_by_stamp)


def _pose_in(bag: Bag, topic: Topic, stamp_ns: int, raw: bytes) -> Transform:
    """Return the pose in a message on `nav/pose`."""
    message = bag.deserialise(topic, raw)
    with refusing(f"bag '{bag.path}', '{topic.bag_name}', stamp {stamp_ns}", "correct or remove the pair"):
        return pose_of(message.pose.position, message.pose.orientation)


def _image_pairs(cameras: CameraTopics, stamps_ns: Mapping[str, Sequence[int]], sync: SyncConfig) -> _Pairs:
    """Return the stamps of the images of each pair; a joint image is a pair."""
    if cameras.layout:
        (joint,) = cameras.images
        return {stamp_ns: {joint.name: stamp_ns} for stamp_ns in stamps_ns[joint.name]}
    left, right = cameras.images
    where = f"bag '{cameras.bag.path}', '{cameras.task.rig}'"
    matched = stereo_pairs(stamps_ns[left.name], stamps_ns[right.name], sync, where)
    return {left_ns: {left.name: left_ns, right.name: right_ns} for left_ns, right_ns in matched.items()}


def _matching_poses(bag: Bag, pairs_ns: Sequence[int], poses_ns: Collection[int], sync: SyncConfig) -> dict[int, int]:
    """Return the stamp of the pose of each pair that has one; InputError if no pair has a pose."""
    pose_of_pair = match_stamps(pairs_ns, sorted(poses_ns), sync.stamp_tolerance_ns)
    without = [stamp_ns for stamp_ns in pairs_ns if stamp_ns not in pose_of_pair]
    if not without:
        return pose_of_pair
    text = (
        f"bag '{bag.path}': no message on '{NAV_POSE}' for {len(without)} of {len(pairs_ns)} mapping pairs, the first "
        f"with stamp {without[0]}"
    )
    if not pose_of_pair:
        raise InputError(f"{text}:", "record a pose with the stamp of each pair")
    _log.warning(f"{text}: these pairs are skipped")
    return pose_of_pair
