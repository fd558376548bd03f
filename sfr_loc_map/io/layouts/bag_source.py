"""The drive and mapping pairs of a bag: a first pass reads the stamps, a second pass joins the messages of pairs."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.extrinsics import RigInBody
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S, SIDES, Task, refusing
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.poses import pose_of, read_extrinsics
from sfr_loc_map.io.calibration.calibration_file import read_calibration
from sfr_loc_map.io.calibration.camera_info import RectifiedCamera
from sfr_loc_map.io.calibration.rectification import RectifiableCamera, StereoRectifier, rectifiable_cameras
from sfr_loc_map.io.calibration.stereo_calibration import StereoCalibration
from sfr_loc_map.io.clouds.point_image import points_image
from sfr_loc_map.io.images.codec import SampleDepth, Samples, samples_of
from sfr_loc_map.io.images.files import check_size
from sfr_loc_map.io.layouts.head_pose import head_poses
from sfr_loc_map.io.layouts.stamp_pairs import stereo_pairs
from sfr_loc_map.io.sequence import RecordedBag, Source, SourceFormat
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.tables.stamps import check_order
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH
from sfr_loc_map.io.truth.read import truth_of_recording
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE, POINTS, POSE
from sfr_loc_map.stamp_pairing import match_stamps
from sfr_loc_map.topics import NAV_POSE, RAW, RECTIFIED, TRUE_POINTS, TRUE_POSES

LOOK_AHEAD = 32
"""Maximum number of incomplete pairs at a time, which limits the memory for any order of messages in the bag."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class _BagRig:
    """The rig of a task, as the configuration and the bag describe it."""

    rig: StereoRig
    rectifier: StereoRectifier | None  #: None if the images are rectified.
    frame: str  #: Frame of the left camera.
    calibrated_by: str  #: Origin of the calibration.
    mount: RigInBody | None  #: Pose of the rig on the rover, if it is from the bag.


class _BagPairs:
    """The pairs of the cameras of a task, read from the topics of the bag as the configuration requires."""

    task: Task

    def __init__(self, bag: Bag, config: SourceConfig) -> None:
        rig, of_drive = self.task.rig, self.task is Task.LOCALISATION
        self._bag, self._rig_name, self._config = bag, rig, config
        self._tolerance_ns = round(config.sync.stamp_tolerance_s * NS_PER_S)
        self._sync = config.sync if of_drive else replace(config.sync, right_offset_s=0.0)
        calibration = config.calibration if of_drive else CalibrationConfig()
        self._layout = calibration.stereo_layout
        kind = image_name(bag, rig)
        sides = SIDES[:1] if self._layout else SIDES
        self._sides = [_require(bag, f"{rig}/{side}/{kind}", IMAGE, COMPRESSED) for side in sides]
        self._points = bag.find(TRUE_POINTS, POINTS) if self.task is Task.MAPPING else None
        self._topics = [*self._sides, *([self._points] if self._points else [])]
        self._rig = self._rig_of(calibration, is_rectified=kind == RECTIFIED)
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

    def _rig_of(self, config: CalibrationConfig, *, is_rectified: bool) -> _BagRig:
        calibration, frame = self._calibrated(config, is_rectified)
        if config.baseline_m:
            calibration = calibration.with_baseline(config.baseline_m)
        with _naming_bag(self._bag):
            rig, rectifier = calibration.rig(self._rig_name)
        mount = None
        if self.task is Task.LOCALISATION:
            T_rb_sb = self._config.extrinsics.transform() or calibration.T_rb_sb
            if T_rb_sb is None:
                mount = read_extrinsics(self._bag, frame, rig.baseline_m, self._config.frames.base)
                T_rb_sb = None if mount is None else mount.T_rb_sb
            rig = replace(rig, T_rb_sb=T_rb_sb)
        return _BagRig(rig, rectifier, frame, calibration.text, mount)

    def _calibrated(self, config: CalibrationConfig, is_rectified: bool) -> tuple[StereoCalibration, str]:
        if config.file:
            first = next(iter(self._bag.first(self._sides[:1]).values()), None)
            if first is None:
                raise InputError(f"bag '{self._bag.path}' has no message on '{self._sides[0].bag_name}'")
            height, width = self._halves(self._decoded(self._sides[0], first).grey())[0].shape
            return read_calibration(Path(config.file), (width, height)), str(first.header.frame_id)
        topics = [_require(self._bag, f"{self._rig_name}/{side}/camera_info", CAMERA_INFO) for side in SIDES]
        infos = self._bag.first(topics)
        for topic in topics:
            if topic.name not in infos:
                raise InputError(f"bag '{self._bag.path}' has no message on '{topic.bag_name}': the rig is unknown")
        left, right = (infos[topic.name] for topic in topics)
        if is_rectified:
            rectified = (RectifiedCamera.of(info) for info in (left, right))
            first, second = (RectifiableCamera.of_rectified(camera.size, camera.p) for camera in rectified)
        else:
            with _naming_bag(self._bag):
                first, second = rectifiable_cameras((left, right), self._rig_name)
        return StereoCalibration((first, second), is_rectified, None, "camera_info"), str(left.header.frame_id)

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs in ascending order; the stamp of a pair is that of its left image."""
        return tuple(self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    def parts(self) -> dict[int, dict[str, int]]:
        """Return the stamps of the images of each pair by topic."""
        images = {topic.name for topic in self._sides}
        return {
            stamp: {name: of_part for name, of_part in parts.items() if name in images}
            for stamp, parts in self._pairs.items()
        }

    @cached_property
    def _pairs(self) -> dict[int, dict[str, int]]:
        """For the stamp of each complete pair, the stamps of its messages by topic. Only stamps are read."""
        stamps: dict[str, list[int]] = {topic.name: [] for topic in self._topics}
        for topic, stamp_ns, _ in self._bag.stream(self._topics):
            stamps[topic.name].append(stamp_ns)
        for topic in self._topics:
            if len(stamps[topic.name]) > 1 and not any(stamps[topic.name]):
                raise InputError(
                    f"bag '{self._bag.path}', '{topic.bag_name}': all header stamps are 0: set 'sync.stamps: record' "
                    "in sfr.yaml, which uses the recording times"
                )
            check_order(stamps[topic.name], f"bag '{self._bag.path}', '{topic.bag_name}'", strict=True)
        left, right = (stamps[self._sides[at].name] for at in (0, -1))
        if self._layout:
            return {stamp: {self._sides[0].name: stamp} for stamp in left}
        matched = stereo_pairs(left, right, self._sync, f"bag '{self._bag.path}', '{self._rig_name}'")
        one, other = (topic.name for topic in self._sides)
        pairs = {stamp: {one: stamp, other: partner} for stamp, partner in matched.items()}
        if self._points:
            for stamp, of_truth in match_stamps(list(pairs), stamps[self._points.name], self._tolerance_ns).items():
                pairs[stamp][self._points.name] = of_truth
        return pairs

    def joined(self) -> Iterator[tuple[StereoPair, Mapping[str, bytes]]]:
        """Yield each complete pair and its raw messages by topic, in the order of stamps."""
        pair_of = {part: stamp for stamp, parts in self._pairs.items() for part in parts.items()}
        order, waiting = iter(self._pairs), dict[int, dict[str, bytes]]()
        stamp = next(order, None)
        depth = SampleDepth(_log.warning, f"{self._bag.path}, {self._rig_name}")
        for topic, stamp_ns, raw in self._bag.stream(self._topics):
            if (part := pair_of.get((topic.name, stamp_ns))) is None:
                continue
            waiting.setdefault(part, {})[topic.name] = raw
            while stamp is not None and len(waiting.get(stamp, ())) == len(self._pairs[stamp]):
                messages = waiting.pop(stamp)
                yield self._pair(stamp, messages, depth), messages
                stamp = next(order, None)
            if len(waiting) > LOOK_AHEAD:
                raise InputError(
                    f"bag '{self._bag.path}': the messages of the {self._rig_name} pair of stamp {stamp} are more than "
                    f"{LOOK_AHEAD} pairs apart in the bag; sort the bag by time"
                )

    def _pair(self, stamp_ns: int, raw: Mapping[str, bytes], depth: SampleDepth) -> StereoPair:
        samples = [self._decoded(topic, self._bag.deserialise(topic, raw[topic.name])) for topic in self._sides]
        images = depth.grey(*samples)
        left, right = self._halves(images[0]) if self._layout else images
        for image, topic in ((left, self._sides[0]), (right, self._sides[-1])):
            check_size(image, self.rig, f"bag '{self._bag.path}', '{topic.bag_name}': image of stamp {stamp_ns}")
        if self._rig.rectifier is not None:
            left, right = self._rig.rectifier.rectify(left, right)
        return StereoPair(stamp_ns, left, right)

    def _decoded(self, topic: Topic, message: Any) -> Samples:  # noqa: ANN401 - types of rosbags
        try:
            return samples_of(message)
        except InputError as error:
            raise InputError(f"bag '{self._bag.path}', '{topic.bag_name}': {error}") from error

    def _halves(self, image: GreyImage) -> list[GreyImage]:
        """Return the left and right half of a joint image; without a joint layout, the image itself."""
        axis = {"": None, "side_by_side": 1, "top_bottom": 0}[self._layout]
        if axis is None:
            return [image]
        if image.shape[axis] % 2:
            raise InputError(
                f"bag '{self._bag.path}': joint images ({self._layout}) of {image.shape[1]} x {image.shape[0]} "
                "px cannot be divided into equal halves: correct the layout or the images"
            )
        return [np.ascontiguousarray(half) for half in np.split(image, 2, axis)]


class BagLocSequence(_BagPairs):
    """The drive of a bag."""

    task = Task.LOCALISATION

    @cached_property
    def ground_truth(self) -> Trajectory | None:
        """True poses, from the configured origin or from `ground_truth/odometry`; None without either."""
        config = self._config.truth
        has_own = any(self._bag.counts[topic] for topic in self._bag.matches(TRUE_POSES))
        if config == DEFAULT_TRUTH and not has_own:
            return None
        return truth_of_recording(self._bag, config)

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
            stamps = self.stamps_ns
            poses = head_poses(bag, self._rig.frame, self.rig.baseline_m, stamps, config.frames)
            self._poses, self.is_adapted = dict(zip(stamps, poses, strict=True)), True
            return
        topic = _require(bag, NAV_POSE, POSE)
        for _, stamp_ns, message in bag.messages([topic]):
            where = f"bag '{bag.path}', '{topic.bag_name}', stamp {stamp_ns}"
            with refusing(where, "correct or remove the pair"):
                self._poses[stamp_ns] = pose_of(message.pose.position, message.pose.orientation)

    def _poses_of_pairs(self) -> dict[int, int]:
        """Return the stamp of the pose of each pair that has a pose."""
        return match_stamps(self.stamps_ns, sorted(self._poses), self._tolerance_ns)

    def parts(self) -> dict[int, dict[str, int]]:
        """Return the stamps of the images and the pose by topic, for each pair that has a pose.

        `pairs` raises InputError if a pair has no pose.
        """
        pose_of_pair = self._poses_of_pairs()
        return {
            stamp: {**images, NAV_POSE: pose_of_pair[stamp]}
            for stamp, images in super().parts().items()
            if stamp in pose_of_pair
        }

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs in the order of stamps, with truth if `ground_truth/points` has their stamp."""
        pose_of_pair = self._poses_of_pairs()
        for pair, raw in self.joined():
            if pair.stamp_ns not in pose_of_pair:
                raise InputError(
                    f"bag '{self._bag.path}': no message on 'nav/pose' for the pair of stamp {pair.stamp_ns}"
                )
            truth = None
            if self._points and self._points.name in raw:
                message = self._bag.deserialise(self._points, raw[self._points.name])
                with _naming_bag(self._bag):
                    truth = points_image(message, (self.rig.width, self.rig.height))
            yield PosedStereoPair(pair, self._poses[pose_of_pair[pair.stamp_ns]], truth)


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
    loc = BagLocSequence(bag, config) if kinds[Task.LOCALISATION] else None
    nav = BagNavSequence(bag, config) if kinds[Task.MAPPING] else None
    is_adapted = any(part is not None and part.is_adapted for part in (loc, nav)) or config.truth != DEFAULT_TRUTH
    calibration = "" if loc is None else loc.calibrated_by
    if RAW in kinds.values():
        return Source(path, SourceFormat.RAW_BAG, loc, nav, calibration=calibration)
    if is_adapted:
        return Source(path, SourceFormat.CONFIGURED_BAG, loc, nav, calibration=calibration)
    recorded = RecordedBag(path, config.remap)
    return Source(path, SourceFormat.BAG, loc, nav, calibration=calibration, recorded=recorded)


def image_name(bag: Bag, rig: str) -> str | None:
    """Return the last part of the names of a rig's image topics, if possible of rectified images; None without any."""
    for name in (RECTIFIED, RAW):
        if any(bag.find(f"{rig}/{side}/{name}", IMAGE, COMPRESSED) for side in SIDES):
            return name
    return None


@contextmanager
def _naming_bag(bag: Bag) -> Iterator[None]:
    """Add the path of the bag to errors about its calibration."""
    try:
        yield
    except InputError as error:
        raise InputError(f"bag '{bag.path}': {error}") from error


def _require(bag: Bag, name: str, *msgtypes: str) -> Topic:
    topic = bag.find(name, *msgtypes)
    if topic is None:
        raise InputError(
            f"bag '{bag.path}' has no topic '{name}': it has {', '.join(sorted(bag.topics))}; record it, or name it "
            f"with --remap old:=new"
        )
    return topic
