"""The drive and mapping pairs of a bag: a first pass reads the stamps, a second pass joins the messages of pairs."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.errors import InputError, SfrError, naming
from sfr_loc_map.geometry.extrinsics import RigInBody
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.bag import Bag, restamped
from sfr_loc_map.io.bag.frames import pose_of
from sfr_loc_map.io.bag.poses import read_extrinsics
from sfr_loc_map.io.clouds.point_image import points_image
from sfr_loc_map.io.images.codec import SampleDepth
from sfr_loc_map.io.images.files import check_size
from sfr_loc_map.io.layouts.bag_rig import (
    BagImages,
    camera_info_topics,
    check_one_calibration,
    image_name,
    require_topic,
    rig_of_bag,
)
from sfr_loc_map.io.layouts.head_pose import head_poses
from sfr_loc_map.io.layouts.stamp_pairs import stereo_pairs, without_partner
from sfr_loc_map.io.sequence import RecordedBag, Source, SourceFormat
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.tables.stamps import check_order
from sfr_loc_map.io.tables.text_table import MAX_BROKEN
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH
from sfr_loc_map.io.truth.read import truth_of_bag
from sfr_loc_map.message_types import POINTS, POSE
from sfr_loc_map.stamp_pairing import match_stamps
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import NAV_POSE, RAW, TRUE_POINTS, TRUE_POSES

LOOK_AHEAD = 32
"""Maximum number of incomplete pairs at a time, which limits the memory for any order of messages in the bag."""

_log = logging.getLogger(__name__)


class _BagPairs:
    """The pairs of the cameras of a task, read from the topics of the bag as the configuration requires."""

    task: Task

    def __init__(self, bag: Bag, config: SourceConfig) -> None:
        is_drive = self.task is Task.LOCALISATION
        calibration = config.calibration if is_drive else CalibrationConfig()
        self._bag = bag
        self._config = config
        self._sync = config.sync if is_drive else replace(config.sync, right_offset_s=0.0)
        self._images = BagImages.of(bag, self.task, calibration.stereo_layout)
        self._points = None if is_drive else bag.find(TRUE_POINTS, POINTS)
        self._topics = [*self._images.topics, *([self._points] if self._points else [])]
        self._rig = rig_of_bag(self._images, calibration, config)
        self._infos = [] if calibration.file else camera_info_topics(self._images)
        self.is_adapted = calibration != CalibrationConfig() or config.sync != SyncConfig()

    @property
    def rig(self) -> StereoRig:
        """Rig of the rectified images; for the drive with its pose on the rover, if known."""
        return self._rig.rig

    @property
    def mount(self) -> RigInBody | None:
        """Pose of the rig on the rover in the bag; None if the bag has no such pose, or if another origin has one."""
        return self._rig.mount

    @property
    def calibrated_by(self) -> str:
        """Origin of the calibration."""
        return self._rig.calibrated_by

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs in ascending order; the stamp of a pair is that of its left image."""
        return tuple(self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    def parts(self) -> dict[int, dict[str, int]]:
        """Return the stamps of the images of each pair by topic."""
        images = {topic.name for topic in self._images.topics}
        return {
            stamp: {name: of_part for name, of_part in parts.items() if name in images}
            for stamp, parts in self._pairs.items()
        }

    @property
    def _pairs(self) -> dict[int, dict[str, int]]:
        """For the stamp of each pair that is read, the stamps of its messages by topic."""
        return self._image_pairs

    @cached_property
    def _image_pairs(self) -> dict[int, dict[str, int]]:
        """For the stamp of each complete pair, the stamps of its messages by topic. Only stamps are read."""
        stamps = self._stamps
        left, *right = self._images.topics
        if not right:  # joint images
            return {stamp: {left.name: stamp} for stamp in stamps[left.name]}
        where = f"bag '{self._bag.path}', '{self.task.rig}'"
        matched = stereo_pairs(stamps[left.name], stamps[right[0].name], self._sync, where)
        pairs = {stamp: {left.name: stamp, right[0].name: partner} for stamp, partner in matched.items()}
        if self._points:
            matched = match_stamps(list(pairs), stamps[self._points.name], self._sync.stamp_tolerance_ns)
            for stamp, of_points in matched.items():
                pairs[stamp][self._points.name] = of_points
        return pairs

    @cached_property
    def _stamps(self) -> dict[str, list[int]]:
        """Return the increasing stamps of the messages by topic; InputError if all are 0 or many do not increase."""
        stamps: dict[str, list[int]] = {topic.name: [] for topic in self._topics}
        infos: dict[str, set[bytes]] = {topic.name: set() for topic in self._infos}
        for topic, stamp_ns, raw in self._bag.stream([*self._topics, *self._infos]):
            if topic.name in infos:
                infos[topic.name].add(restamped(raw, 0))
            else:
                stamps[topic.name].append(stamp_ns)
        for topic in self._infos:
            check_one_calibration(self._images, topic, infos[topic.name])
        for topic in self._topics:
            where = f"bag '{self._bag.path}', '{topic.bag_name}'"
            if len(stamps[topic.name]) > 1 and not any(stamps[topic.name]):
                raise InputError(
                    f"{where}: all header stamps are 0: set 'sync.stamps: record' in sfr.yaml, which uses the "
                    "recording times"
                )
            stamps[topic.name] = _increasing(stamps[topic.name], where)
        return stamps

    def joined(self) -> Iterator[tuple[StereoPair, Mapping[str, bytes]]]:
        """Yield each complete pair and its raw messages by topic, in the order of stamps."""
        pairs = self._pairs
        pair_of = {part: stamp for stamp, parts in pairs.items() for part in parts.items()}
        order, waiting = iter(pairs), dict[int, dict[str, bytes]]()
        stamp = next(order, None)
        depth = SampleDepth(_log.warning, f"{self._bag.path}, {self.task.rig}")
        for topic, stamp_ns, raw in self._bag.stream(self._topics):
            part = pair_of.get((topic.name, stamp_ns))
            if part is None or stamp is None or part < stamp:  # of no pair, or repeated after its pair
                continue
            waiting.setdefault(part, {}).setdefault(topic.name, raw)
            while stamp is not None and len(waiting.get(stamp, ())) == len(pairs[stamp]):
                messages = waiting.pop(stamp)
                yield self._pair(stamp, messages, depth), messages
                stamp = next(order, None)
            if len(waiting) > LOOK_AHEAD:
                raise InputError(
                    f"bag '{self._bag.path}': the messages of the {self.task.rig} pair of stamp {stamp} ns were "
                    f"recorded more than {LOOK_AHEAD} pairs apart: record all topics of the pairs with the same "
                    "delay, or write the bag again with the header stamps as times of recording"
                )

    def _pair(self, stamp_ns: int, raw: Mapping[str, bytes], depth: SampleDepth) -> StereoPair:
        images, topics = self._images, self._images.topics
        samples = [images.decoded(topic, self._bag.deserialise(topic, raw[topic.name])) for topic in topics]
        left, right = images.left_and_right(depth.grey(*samples))
        for image, topic in ((left, topics[0]), (right, topics[-1])):
            check_size(image, self.rig, f"bag '{self._bag.path}', '{topic.bag_name}': image of stamp {stamp_ns}")
        if self._rig.rectifier is not None:
            left, right = self._rig.rectifier.rectify(left, right)
        return StereoPair(stamp_ns, left, right)


class BagLocSequence(_BagPairs):
    """The drive of a bag."""

    task = Task.LOCALISATION

    @cached_property
    def ground_truth(self) -> Truth | None:
        """True poses, from the configured origin or from `ground_truth/odometry`; None without either."""
        config = self._config.truth
        has_own = any(self._bag.counts[topic] for topic in self._bag.matches(TRUE_POSES))
        if config == DEFAULT_TRUTH and not has_own:
            return None
        return truth_of_bag(self._bag, config)

    def own_extrinsics(self) -> Transform | None:
        """Return the pose of the rig on the rover in the bag, also if the configuration replaces this pose.

        None if the bag has no valid pose, or if another file has the calibration.
        """
        if self._config.calibration.file:
            return None
        base = self._config.frames.base
        with suppress(SfrError):
            found = self.mount or read_extrinsics(self._bag, self._rig.frame, self.rig.baseline_m, base)
            return None if found is None else found.T_rb_sb
        return None

    def missing_ns(self) -> tuple[int, ...]:
        """Return the stamps of the left images that are skipped because they have no right image."""
        left, *right = self._images.topics
        return without_partner(self._stamps[left.name], self._image_pairs) if right else ()

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs in the order of stamps."""
        return (pair for pair, _ in self.joined())


class BagNavSequence(_BagPairs):
    """The mapping pairs of a bag."""

    task = Task.MAPPING

    def __init__(self, bag: Bag, config: SourceConfig) -> None:
        super().__init__(bag, config)
        self._poses: dict[int, Transform] = {}
        if not bag.matches(NAV_POSE):
            stamps = tuple(self._image_pairs)
            poses = head_poses(bag, self._rig.frame, self.rig.baseline_m, stamps, config.frames)
            self._poses = dict(zip(stamps, poses, strict=True))
            self.is_adapted = True
            return
        if unused := [name for name in changed(config.frames, "frames.") if name != "frames.base"]:
            _log.warning(
                f"bag '{bag.path}': {', '.join(unused)} ignored: the poses of mapping pairs are on '{NAV_POSE}'"
            )
        topic = require_topic(bag, NAV_POSE, POSE)
        repeated = 0
        for _, stamp_ns, message in bag.messages([topic]):
            if stamp_ns in self._poses:
                repeated += 1
                continue
            where = f"bag '{bag.path}', '{topic.bag_name}', stamp {stamp_ns}"
            with refusing(where, "correct or remove the pair"):
                self._poses[stamp_ns] = pose_of(message.pose.position, message.pose.orientation)
        if repeated:
            _log.warning(
                f"bag '{bag.path}', '{topic.bag_name}': {repeated} of {repeated + len(self._poses)} messages ignored: "
                "they have the stamps of earlier ones"
            )

    @cached_property
    def _pose_of_pair(self) -> dict[int, int]:
        """The stamp of the pose of each pair that has a pose; a warning reports the others."""
        stamps = list(self._image_pairs)
        found = match_stamps(stamps, sorted(self._poses), self._sync.stamp_tolerance_ns)
        without = [stamp for stamp in stamps if stamp not in found]
        text = (
            f"bag '{self._bag.path}': no message on 'nav/pose' for {len(without)} of {len(stamps)} mapping pairs, the "
            f"first with stamp {next(iter(without), 0)}"
        )
        if without and not found:
            raise InputError(f"{text}: record a pose with the stamp of each pair")
        if without:
            _log.warning(f"{text}: these pairs are skipped")
        return found

    @property
    def _pairs(self) -> dict[int, dict[str, int]]:
        return {stamp: parts for stamp, parts in self._image_pairs.items() if stamp in self._pose_of_pair}

    def missing_ns(self) -> tuple[int, ...]:
        """Return the stamps of the pairs that are skipped because they have no pose."""
        return tuple(stamp for stamp in self._image_pairs if stamp not in self._pose_of_pair)

    def parts(self) -> dict[int, dict[str, int]]:
        """Return the stamps of the images and the pose of each pair by topic."""
        return {stamp: {**images, NAV_POSE: self._pose_of_pair[stamp]} for stamp, images in super().parts().items()}

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs in the order of stamps, with truth if `ground_truth/points` has their stamp."""
        for pair, raw in self.joined():
            truth = None
            if self._points and self._points.name in raw:
                message = self._bag.deserialise(self._points, raw[self._points.name])
                with naming(self._bag.path):
                    truth = points_image(message, (self.rig.width, self.rig.height))
            yield PosedStereoPair(pair, self._poses[self._pose_of_pair[pair.stamp_ns]], truth)


def _increasing(stamps_ns: Sequence[int], where: str) -> list[int]:
    """Return the stamps that are later than all earlier stamps; InputError if many are not."""
    stamps = np.asarray(stamps_ns, np.int64)
    is_later = np.ones(len(stamps), np.bool_)
    is_later[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
    ignored = int(np.count_nonzero(~is_later))
    if ignored > MAX_BROKEN * len(stamps):
        check_order(stamps, where, strict=True)
    if ignored:
        _log.warning(
            f"{where}: {ignored} of {len(stamps)} messages ignored: their stamps are not later than those before"
        )
    return [int(stamp) for stamp in stamps[is_later]]


def open_bag(path: Path, config: SourceConfig | None = None) -> Source:
    """Open a bag (a folder, or a .mcap, .db3 or .bag file) as a source."""
    config = config or SourceConfig()
    bag = Bag(path, config.remap, config.sync.stamps)
    kinds = {task: image_name(bag, task.rig) for task in Task}
    if not any(kinds.values()):
        raise InputError(
            f"bag '{path}' has neither loc/left/image_rect nor nav/left/image_rect: it has "
            f"{', '.join(sorted(bag.topics))}; sfr info '{path}' --write proposes the topics"
        )
    if len(namespaces := bag.namespaces()) > 1:
        listed = "; ".join(f"/{namespace}: {', '.join(names)}" for namespace, names in namespaces.items())
        _log.warning(
            f"bag '{path}': topics of several namespaces are read: {listed}: name the topics in section 'topics' of "
            "sfr.yaml if the namespaces are those of different rovers"
        )
    loc = BagLocSequence(bag, config) if kinds[Task.LOCALISATION] else None
    nav = BagNavSequence(bag, config) if kinds[Task.MAPPING] else None
    is_adapted = any(part is not None and part.is_adapted for part in (loc, nav)) or config.truth != DEFAULT_TRUTH
    is_raw = RAW in kinds.values()
    return Source(
        path,
        SourceFormat.RAW_BAG if is_raw else SourceFormat.CONFIGURED_BAG if is_adapted else SourceFormat.BAG,
        loc,
        nav,
        find_missing_loc=tuple if loc is None else loc.missing_ns,
        find_missing_nav=tuple if nav is None else nav.missing_ns,
        calibration="" if loc is None else loc.calibrated_by,
        find_own_extrinsics=(lambda: None) if loc is None else loc.own_extrinsics,
        recorded=None if is_raw or is_adapted else RecordedBag(path, config.remap),
    )
