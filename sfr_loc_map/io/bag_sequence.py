"""The drive and the mapping pairs of a ROS 2 bag, as sequences.

A first pass reads stamps only and says which pairs are whole; a second one joins what belongs to a stamp as it comes
by. Left and right are joined by equal stamps.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io.bag import CAMERA_INFO, COMPRESSED, IMAGE, POINTS, POSE, Bag, Topic
from sfr_loc_map.io.bag_poses import GROUND_TRUTH, read_extrinsics, read_trajectory
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.folder import check_size
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message
from sfr_loc_map.io.point_image import points_image
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.io.trajectory_file import check_order

LOOK_AHEAD = 32
"""Most stamps whose messages are waited for at a time: bounds the memory whatever the order in the bag."""
RB_FRAME = "rb"
LOCSB_FRAME = "locsb"
Task = Literal["loc", "nav"]
TASKS: tuple[Task, ...] = ("loc", "nav")
RECTIFIED, RAW = "image_rect", "image_raw"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Pairs:
    """What the first pass found: the stamps of whole pairs, and the topics that have a message for each."""

    stamps_ns: tuple[int, ...]
    parts: Mapping[int, int]


class _PairTopics:
    """The topics of one pair of cameras."""

    def __init__(self, bag: Bag, task: Task) -> None:
        self.bag = bag
        self.task = task
        self.is_raw = image_name(bag, task) == RAW
        self.left, self.right = (
            _require(bag, f"{task}/{side}/{RAW if self.is_raw else RECTIFIED}", IMAGE, COMPRESSED) for side in SIDES
        )
        self._rectifier: StereoRectifier | None = None
        self.points = bag.find("ground_truth/points", POINTS) if task == "nav" else None
        self._found: _Pairs | None = None

    @property
    def topics(self) -> list[Topic]:
        return [self.left, self.right] + ([self.points] if self.points else [])

    def rig(self) -> StereoRig:
        """Return the rig of the two camera_info topics."""
        infos = [_require(self.bag, f"{self.task}/{side}/camera_info", CAMERA_INFO) for side in ("left", "right")]
        first = self.bag.first(infos)
        for topic in infos:
            if topic.name not in first:
                raise InputError(f"bag '{self.bag.path}' has no message on '{topic.bag_name}': the rig is not known")
        extrinsics = read_extrinsics(self.bag, RB_FRAME, LOCSB_FRAME) if self.task == "loc" else None
        try:
            messages = first[infos[0].name], first[infos[1].name]
            if not self.is_raw:
                return rig_from_camera_info(*messages, self.task, extrinsics)
            rig, self._rectifier = rectified_rig(messages, self.task, T_rb_sb=extrinsics)
            return rig
        except InputError as error:
            raise InputError(f"bag '{self.bag.path}': {error}") from error

    def found(self) -> _Pairs:
        """Return the whole pairs; reads stamps only, once."""
        if self._found is None:
            self._found = self._scan()
        return self._found

    def joined(self) -> Iterator[tuple[int, dict[str, bytes]]]:
        """Yield the stamp and the raw messages by topic of each whole pair, in the order of stamps."""
        found = self.found()
        waiting: dict[int, dict[str, bytes]] = {}
        order = iter(found.stamps_ns)
        stamp = next(order, None)
        for topic, stamp_ns, raw in self.bag.stream(self.topics):
            if stamp_ns not in found.parts:
                continue
            waiting.setdefault(stamp_ns, {})[topic.name] = raw
            while stamp is not None and len(waiting.get(stamp, ())) == found.parts[stamp]:
                yield stamp, waiting.pop(stamp)
                stamp = next(order, None)
            if len(waiting) > LOOK_AHEAD:
                raise InputError(
                    f"bag '{self.bag.path}': messages of {self.task} stamp {stamp} lie more than {LOOK_AHEAD} pairs "
                    f"apart; sort the bag by time"
                )

    def image(self, topic: Topic, raw: bytes, rig: StereoRig) -> GreyImage:
        """Return the image of a raw message."""
        message = self.bag.deserialise(topic, raw)
        decode = image_from_compressed_message if topic.msgtype == COMPRESSED else image_from_message
        try:
            image = decode(message)
        except InputError as error:
            raise InputError(f"bag '{self.bag.path}', '{topic.bag_name}': {error}") from error
        stamp = int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)
        check_size(image, rig, f"bag '{self.bag.path}', '{topic.bag_name}': image of stamp {stamp}")
        return image

    def pair(self, stamp_ns: int, raw: Mapping[str, bytes], rig: StereoRig) -> StereoPair:
        """Return the decoded pair of a stamp."""
        left, right = (self.image(topic, raw[topic.name], rig) for topic in (self.left, self.right))
        return StereoPair(stamp_ns, *(self._rectifier.rectify(left, right) if self._rectifier else (left, right)))

    def _scan(self) -> _Pairs:
        stamps: dict[str, list[int]] = {topic.name: [] for topic in self.topics}
        for topic, stamp_ns, _ in self.bag.stream(self.topics):
            stamps[topic.name].append(stamp_ns)
        for topic in self.topics:
            check_order(stamps[topic.name], f"bag '{self.bag.path}', '{topic.bag_name}'", strict=True)
        left, right = (set(stamps[topic.name]) for topic in (self.left, self.right))
        whole = sorted(left & right)
        if not whole:
            raise InputError(
                f"bag '{self.bag.path}': none of {len(left)} left and {len(right)} right images of '{self.task}' "
                f"have equal stamps: record both from one trigger"
            )
        single = len(left ^ right)
        if single:
            _log.warning(
                "bag '%s': %d images of '%s' without the other side left out", self.bag.path, single, self.task
            )
        truth = set(stamps[self.points.name]) if self.points else set()
        return _Pairs(tuple(whole), {stamp: 2 + (stamp in truth) for stamp in whole})


class BagLocSequence:
    """The drive of a bag."""

    def __init__(self, bag: Bag) -> None:
        """Find the topics and read the rig.

        Raises:
            InputError: If a topic is missing, or the rig is not rectified.
        """
        self._topics = _PairTopics(bag, "loc")
        self._rig = self._topics.rig()
        self._truth: Trajectory | None = None
        self._truth_read = False

    @property
    def rig(self) -> StereoRig:
        """Rig of the localisation cameras, with its extrinsics in RB where `read_extrinsics` finds them."""
        return self._rig

    @property
    def ground_truth(self) -> Trajectory | None:
        """Poses on `ground_truth/odometry`, or None; read at the first use."""
        if not self._truth_read:
            self._truth, self._truth_read = read_trajectory(self._topics.bag, GROUND_TRUTH), True
        return self._truth

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, in their order (reads all stamps at the first use, decodes nothing)."""
        return self._topics.found().stamps_ns

    def __len__(self) -> int:
        """Return the number of whole pairs (reads all stamps at the first use, decodes nothing)."""
        return len(self._topics.found().stamps_ns)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs in the order of stamps.

        Raises:
            InputError: If the bag or an image is broken or not of the rig's size.
        """
        for stamp_ns, raw in self._topics.joined():
            yield self._topics.pair(stamp_ns, raw, self._rig)


class BagNavSequence:
    """The mapping pairs of a bag."""

    def __init__(self, bag: Bag) -> None:
        """Find the topics and read the rig and the poses.

        Raises:
            InputError: If a topic is missing, the rig is not rectified or a pose not finite.
        """
        self._topics = _PairTopics(bag, "nav")
        self._rig = self._topics.rig()
        self._poses = _load_poses(bag)

    @property
    def rig(self) -> StereoRig:
        """Rig of the navigation cameras."""
        return self._rig

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, in their order (reads all stamps at the first use, decodes nothing)."""
        return self._topics.found().stamps_ns

    def __len__(self) -> int:
        """Return the number of whole pairs."""
        return len(self._topics.found().stamps_ns)

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs in the order of stamps, with truth where `ground_truth/points` has their stamp.

        Raises:
            InputError: If the bag or an image is broken, or a pair has no pose of its stamp.
        """
        topics = self._topics
        for stamp_ns, raw in topics.joined():
            if stamp_ns not in self._poses:
                raise InputError(
                    f"bag '{topics.bag.path}': no message on 'nav/pose' has the stamp {stamp_ns} of a pair"
                )
            truth = None
            if topics.points and topics.points.name in raw:
                size = self._rig.width, self._rig.height
                truth = points_image(topics.bag.deserialise(topics.points, raw[topics.points.name]), size)
            yield PosedStereoPair(topics.pair(stamp_ns, raw, self._rig), self._poses[stamp_ns], truth)


def open_bag(path: Path, remap: Mapping[str, str] | None = None) -> Source:
    """Open a ROS 2 bag as a source.

    Args:
        path: Folder of the bag, or a .mcap or .db3 file.
        remap: New names of topics by the names in the bag.

    Raises:
        InputError: If it is broken, or has the images of neither task.
    """
    bag = Bag(path, remap)
    has = {task: image_name(bag, task) is not None for task in TASKS}
    if not any(has.values()):
        raise InputError(
            f"bag '{path}' has neither loc/left/image_rect nor nav/left/image_rect: it has "
            f"{', '.join(sorted(bag.topics))}; name the topics by --remap old:=new"
        )
    loc: LocSequence | None = BagLocSequence(bag) if has["loc"] else None
    nav: NavSequence | None = BagNavSequence(bag) if has["nav"] else None
    raw = any(image_name(bag, task) == RAW for task in TASKS)
    return Source(path, "bag of raw images" if raw else "bag", loc, nav)


def image_name(bag: Bag, task: Task) -> str | None:
    """Return the last part of the names of a task's images: rectified ones before raw ones, None without any."""
    for name in (RECTIFIED, RAW):
        if any(bag.find(f"{task}/{side}/{name}", IMAGE, COMPRESSED) for side in SIDES):
            return name
    return None


def _require(bag: Bag, name: str, *msgtypes: str) -> Topic:
    topic = bag.find(name, *msgtypes)
    if topic is None:
        raise InputError(
            f"bag '{bag.path}' has no topic '{name}': it has {', '.join(sorted(bag.topics))}; record it, or name it by "
            f"--remap old:=new"
        )
    return topic


def _load_poses(bag: Bag) -> dict[int, Transform]:
    topic = _require(bag, "nav/pose", POSE)
    poses = {}
    for _, stamp_ns, message in bag.messages([topic]):
        position, quat = message.pose.position, message.pose.orientation
        try:
            poses[stamp_ns] = Transform.from_quat(
                (position.x, position.y, position.z), (quat.x, quat.y, quat.z, quat.w)
            )
        except GeometryError as error:
            raise InputError(
                f"bag '{bag.path}', '{topic.bag_name}', stamp {stamp_ns}: {error}; correct or leave out the pair"
            ) from error
    return poses
