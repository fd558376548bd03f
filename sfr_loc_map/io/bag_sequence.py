"""The drive and mapping pairs of a bag: a first pass reads stamps, a second one joins what has equal ones."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from statistics import median_low

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S, SIDES, Task, refusing
from sfr_loc_map.io.bag import (
    CAMERA_INFO,
    COMPRESSED,
    GROUND_TRUTH,
    IMAGE,
    POINTS,
    POSE,
    Bag,
    Topic,
    pose_of,
    read_extrinsics,
    read_trajectory,
)
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message, points_image
from sfr_loc_map.io.image_files import check_size
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.stamp_pairing import STAMP_TOLERANCE_S, match_stamps
from sfr_loc_map.io.text_table import check_order

LOOK_AHEAD = 32
"""Most stamps whose messages are waited for at a time: bounds the memory whatever the order in the bag."""
RECTIFIED, RAW = "image_rect", "image_raw"
NS_PER_MS = 1_000_000

_log = logging.getLogger(__name__)


class _BagPairs:
    """The pairs of the cameras of a task, and what their topics say of it."""

    task: Task

    def __init__(self, bag: Bag) -> None:
        rig = self.task.rig
        self._bag, self._rig_name = bag, rig
        self._tolerance_ns = round(STAMP_TOLERANCE_S * NS_PER_S)
        kind = _image_name(bag, rig)
        self._sides = [_require(bag, f"{rig}/{side}/{kind}", IMAGE, COMPRESSED) for side in SIDES]
        self._points = bag.find("ground_truth/points", POINTS) if self.task is Task.MAPPING else None
        self._topics = [*self._sides, *([self._points] if self._points else [])]
        self._rectifier: StereoRectifier | None = None
        infos = [_require(bag, f"{rig}/{side}/camera_info", CAMERA_INFO) for side in SIDES]
        first = bag.first(infos)
        for topic in infos:
            if topic.name not in first:
                raise InputError(f"bag '{bag.path}' has no message on '{topic.bag_name}': the rig is not known")
        left, right = (first[topic.name] for topic in infos)
        extrinsics = read_extrinsics(bag) if self.task is Task.LOCALISATION else None
        try:
            if kind == RAW:
                self.rig, self._rectifier = rectified_rig((left, right), rig, T_rb_sb=extrinsics)
            else:
                self.rig = rig_from_camera_info(left, right, rig, extrinsics)
        except InputError as error:
            raise InputError(f"bag '{bag.path}': {error}") from error

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, those of the left images, in their order."""
        return tuple(self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    @cached_property
    def _pairs(self) -> dict[int, dict[str, int]]:
        """The stamp of each whole pair, in order, and those of its messages by topic; reads stamps only."""
        stamps: dict[str, list[int]] = {topic.name: [] for topic in self._topics}
        for topic, stamp_ns, _ in self._bag.stream(self._topics):
            stamps[topic.name].append(stamp_ns)
        for topic in self._topics:
            check_order(stamps[topic.name], f"bag '{self._bag.path}', '{topic.bag_name}'", strict=True)
        (one, left), (other, right) = ((topic.name, stamps[topic.name]) for topic in self._sides)
        where, within = f"bag '{self._bag.path}', '{self._rig_name}'", f"{self._tolerance_ns / NS_PER_MS:g} ms"
        matched = match_stamps(left, right, self._tolerance_ns)
        if not matched:
            raise InputError(
                f"{where}: none of {len(left)} left and {len(right)} right images have stamps within {within}: record "
                f"both from one trigger, or set sync.stamp_tolerance_s"
            )
        if apart := [abs(after - stamp) for stamp, after in matched.items() if after != stamp]:
            typical, largest = (f"{value / NS_PER_MS:.3g}" for value in (median_low(apart), max(apart)))
            _log.warning(
                f"{where}: {len(apart)} of {len(matched)} pairs have stamps that differ, typically by {typical} ms, at "
                f"most by {largest} ms: matched within {within}"
            )
        if single := len(left) + len(right) - 2 * len(matched):
            _log.warning(f"{where}: {single} images without the other side left out")
        pairs = {stamp: {one: stamp, other: after} for stamp, after in matched.items()}
        if self._points:
            for stamp, of_truth in match_stamps(list(pairs), stamps[self._points.name], self._tolerance_ns).items():
                pairs[stamp][self._points.name] = of_truth
        return pairs

    def joined(self) -> Iterator[tuple[StereoPair, Mapping[str, bytes]]]:
        """Yield each whole pair and its raw messages by topic, in the order of stamps."""
        pair_of = {part: stamp for stamp, parts in self._pairs.items() for part in parts.items()}
        order, waiting = iter(self._pairs), dict[int, dict[str, bytes]]()
        stamp = next(order, None)
        for topic, stamp_ns, raw in self._bag.stream(self._topics):
            if (part := pair_of.get((topic.name, stamp_ns))) is None:
                continue
            waiting.setdefault(part, {})[topic.name] = raw
            while stamp is not None and len(waiting.get(stamp, ())) == len(self._pairs[stamp]):
                messages = waiting.pop(stamp)
                yield self._pair(stamp, messages), messages
                stamp = next(order, None)
            if len(waiting) > LOOK_AHEAD:
                raise InputError(
                    f"bag '{self._bag.path}': messages of {self._rig_name} stamp {stamp} lie more than {LOOK_AHEAD} "
                    f"pairs apart; sort the bag by time"
                )

    def _pair(self, stamp_ns: int, raw: Mapping[str, bytes]) -> StereoPair:
        images = []
        for topic in self._sides:
            where = f"bag '{self._bag.path}', '{topic.bag_name}'"
            message = self._bag.deserialise(topic, raw[topic.name])
            decode = image_from_compressed_message if topic.msgtype == COMPRESSED else image_from_message
            try:
                image = decode(message)
            except InputError as error:
                raise InputError(f"{where}: {error}") from error
            check_size(image, self.rig, f"{where}: image of stamp {stamp_ns}")
            images.append(image)
        left, right = images
        return StereoPair(stamp_ns, *(self._rectifier.rectify(left, right) if self._rectifier else (left, right)))


class BagLocSequence(_BagPairs):
    """The drive of a bag."""

    task = Task.LOCALISATION

    @cached_property
    def ground_truth(self) -> Trajectory | None:
        """Poses on `ground_truth/odometry`, or None; read at the first use."""
        return read_trajectory(self._bag, GROUND_TRUTH)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs in the order of stamps."""
        return (pair for pair, _ in self.joined())


class BagNavSequence(_BagPairs):
    """The mapping pairs of a bag."""

    task = Task.MAPPING

    def __init__(self, bag: Bag) -> None:
        """Find the topics and read the rig and the poses."""
        super().__init__(bag)
        self._poses: dict[int, Transform] = {}
        topic = _require(bag, "nav/pose", POSE)
        for _, stamp_ns, message in bag.messages([topic]):
            where = f"bag '{bag.path}', '{topic.bag_name}', stamp {stamp_ns}"
            with refusing(where, "correct or leave out the pair"):
                self._poses[stamp_ns] = pose_of(message.pose.position, message.pose.orientation)

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs in the order of stamps, with truth where `ground_truth/points` has their stamp."""
        pose_of_pair = match_stamps(self.stamps_ns, sorted(self._poses), self._tolerance_ns)
        for pair, raw in self.joined():
            if pair.stamp_ns not in pose_of_pair:
                raise InputError(
                    f"bag '{self._bag.path}': no message on 'nav/pose' has the stamp {pair.stamp_ns} of a pair"
                )
            truth = None
            if self._points and self._points.name in raw:
                message = self._bag.deserialise(self._points, raw[self._points.name])
                truth = points_image(message, (self.rig.width, self.rig.height))
            yield PosedStereoPair(pair, self._poses[pose_of_pair[pair.stamp_ns]], truth)


def open_bag(path: Path, remap: Mapping[str, str] | None = None) -> Source:
    """Open a bag (a folder, or a .mcap, .db3 or .bag file) as a source; `remap` has new names of topics by the old."""
    bag = Bag(path, remap)
    kinds = {task: _image_name(bag, task.rig) for task in Task}
    if not any(kinds.values()):
        raise InputError(
            f"bag '{path}' has neither loc/left/image_rect nor nav/left/image_rect: it has "
            f"{', '.join(sorted(bag.topics))}; name the topics by --remap old:=new"
        )
    loc = BagLocSequence(bag) if kinds[Task.LOCALISATION] else None
    nav = BagNavSequence(bag) if kinds[Task.MAPPING] else None
    return Source(path, "bag of raw images" if RAW in kinds.values() else "bag", loc, nav)


def _image_name(bag: Bag, rig: str) -> str | None:
    """Return the last part of the names of a rig's images: rectified ones before raw ones, None without any."""
    for name in (RECTIFIED, RAW):
        if any(bag.find(f"{rig}/{side}/{name}", IMAGE, COMPRESSED) for side in SIDES):
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
