"""A bag as a source: its drive and its mapping pairs.

What is read of a bag, and when; each line opens its files again:

    Bag                       topics and numbers of messages                      when the source is opened
    calibrated_cameras        first camera_info, or first image, of each task     when the source is opened
    mount_of                  /tf_static, or the configuration of a node          when the source is opened
    _own_extrinsics           the same, if sfr.yaml has the extrinsics            when the source is opened
    index_of_drive, _mapping  stamps, camera_info and poses of all messages       once, on first use
    head_poses                frames or joints of a head, without nav/pose        once, on first use
    truth_of_bag              true poses                                          once, on first use
    _messages_of_pairs        images and true points                              in each pass over the pairs
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.errors import InputError, SfrError, naming
from sfr_loc_map.geometry.extrinsics import RigInBody
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.poses import read_extrinsics
from sfr_loc_map.io.clouds.point_image import points_image
from sfr_loc_map.io.image_codec import SampleDepth
from sfr_loc_map.io.layouts.bag_cameras import BagCameras, CameraTopics, calibrated_cameras, image_name, mount_of
from sfr_loc_map.io.layouts.bag_index import BagIndex, MappingTopics, index_of_drive, index_of_mapping
from sfr_loc_map.io.layouts.image_files import check_size
from sfr_loc_map.io.sequence import RecordedBag, Source
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, CalibrationConfig, SourceConfig
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH, TruthConfig
from sfr_loc_map.io.truth.read import truth_of_bag
from sfr_loc_map.message_types import COMPRESSED, IMAGE
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import NAV_POSE, RAW, TRUE_POSES

LOOK_AHEAD = 32
"""Maximum number of incomplete pairs at a time, which limits the memory for any order of messages in the bag."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class _BagPairs:
    """The pairs of a task in a bag."""

    topics: CameraTopics
    cameras: BagCameras
    read_index: Callable[[], BagIndex]  #: Reads the index from the bag in one pass.

    @cached_property
    def index(self) -> BagIndex:
        """The stamps of the messages of each pair, which are read on first use."""
        return self.read_index()

    @property
    def rig(self) -> StereoRig:
        """Rig of the rectified images; for the drive with its pose on the rover, if known."""
        return self.cameras.rig

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs in ascending order; the stamp of a pair is that of its left image."""
        return tuple(self.index.pairs)

    def __len__(self) -> int:
        return len(self.index.pairs)

    @property
    def missing_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs that are skipped (`BagIndex.missing_ns`)."""
        return self.index.missing_ns

    def _with_messages(self, *others: Topic) -> Iterator[tuple[StereoPair, Mapping[str, bytes]]]:
        """Yield each pair and its raw messages of images and `others` by topic, in the order of stamps."""
        depth = SampleDepth(_log.warning, f"{self.topics.bag.path}, {self.topics.task.rig}")
        for pair_ns, messages in self._messages_of_pairs([*self.topics.images, *others]):
            yield self._decoded(pair_ns, messages, depth), messages

    def _messages_of_pairs(self, topics: Sequence[Topic]) -> Iterator[tuple[int, Mapping[str, bytes]]]:
        """Yield the stamp of each pair and its raw messages on `topics`, in the order of stamps.

        Messages that are recorded before those of an earlier pair are kept until the earlier pair is complete. At most
        `LOOK_AHEAD` pairs are kept.
        """
        bag = self.topics.bag
        names = {topic.name for topic in topics}
        pairs = {
            pair_ns: {name: stamp_ns for name, stamp_ns in messages.items() if name in names}
            for pair_ns, messages in self.index.pairs.items()
        }
        pair_of = {message: pair_ns for pair_ns, messages in pairs.items() for message in messages.items()}
        waiting: dict[int, dict[str, bytes]] = {}
        order = iter(pairs)
        next_ns = next(order, None)
        for topic, stamp_ns, raw in bag.stream(topics):
            pair_ns = pair_of.get((topic.name, stamp_ns))
            if pair_ns is None or next_ns is None or pair_ns < next_ns:  # of no pair, or repeated after its pair
                continue
            waiting.setdefault(pair_ns, {}).setdefault(topic.name, raw)
            while next_ns is not None and len(waiting.get(next_ns, ())) == len(pairs[next_ns]):
                yield next_ns, waiting.pop(next_ns)
                next_ns = next(order, None)
            if len(waiting) > LOOK_AHEAD:
                raise InputError(
                    f"bag '{bag.path}': the messages of the {self.topics.task.rig} pair of stamp {next_ns} ns were "
                    f"recorded more than {LOOK_AHEAD} pairs apart:",
                    "record all topics of the pairs with the same delay, "
                    "or write the bag again with the header stamps as times of recording",
                )

    def _decoded(self, stamp_ns: int, raw: Mapping[str, bytes], depth: SampleDepth) -> StereoPair:
        """Return the rectified pair of raw messages."""
        bag, images = self.topics.bag, self.topics.images
        samples = [self.topics.decoded(topic, bag.deserialise(topic, raw[topic.name])) for topic in images]
        left, right = self.topics.left_and_right(depth.grey(*samples))
        for image, topic in ((left, images[0]), (right, images[-1])):
            check_size(image, self.rig, f"bag '{bag.path}', '{topic.bag_name}': image of stamp {stamp_ns}")
        if self.cameras.rectifier is not None:
            left, right = self.cameras.rectifier.rectify(left, right)
        return StereoPair(stamp_ns, left, right)


@dataclass(frozen=True, eq=False, kw_only=True)
class BagLocSequence(_BagPairs):
    """The drive of a bag (`sequence.LocSequence`)."""

    mount: RigInBody | None  #: Pose of the rig on the rover as the bag gives it; None if it is missing or configured.
    truth: TruthConfig

    @cached_property
    def ground_truth(self) -> Truth | None:
        """True poses, from the configured origin or from `ground_truth/odometry`; None without either."""
        bag = self.topics.bag
        has_own = any(bag.counts[topic] for topic in bag.matches(TRUE_POSES))
        return None if self.truth == DEFAULT_TRUTH and not has_own else truth_of_bag(bag, self.truth)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs in the order of stamps."""
        return (pair for pair, _ in self._with_messages())


@dataclass(frozen=True, eq=False, kw_only=True)
class BagNavSequence(_BagPairs):
    """The mapping pairs of a bag (`sequence.NavSequence`)."""

    points: Topic | None  #: True points; None without truth.

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs in the order of stamps, with truth if `ground_truth/points` has their stamp."""
        bag, points = self.topics.bag, self.points
        for pair, raw in self._with_messages(*([points] if points else [])):
            truth = None
            if points is not None and points.name in raw:
                message = bag.deserialise(points, raw[points.name])
                with naming(bag.path):
                    truth = points_image(message, (self.rig.width, self.rig.height))
            yield PosedStereoPair(pair, self.index.T_lm_navsb[pair.stamp_ns], truth)


def open_bag(path: Path, config: SourceConfig = DEFAULT_SOURCE) -> Source:
    """Open a bag (a folder, or a .mcap, .db3 or .bag file) as a source."""
    bag = Bag(path, config.topics, config.sync.stamps)
    kinds = {task: image_name(bag, task.rig) for task in Task}
    if not any(kinds.values()):
        advice = "give a bag with images of both cameras"
        if {IMAGE, COMPRESSED} & {*bag.topics.values()}:
            advice = f"name the topics of the images by --remap FOUND:=EXPECTED, or by sfr info '{path}' --write"
        raise InputError(
            f"bag '{path}' has neither loc/left/image_rect nor nav/left/image_rect: it has "
            f"{', '.join(sorted(bag.topics))};",
            advice,
        )
    if len(namespaces := bag.names.namespaces()) > 1:
        listed = "; ".join(f"/{namespace}: {', '.join(names)}" for namespace, names in namespaces.items())
        _log.warning(
            f"bag '{path}': topics of several namespaces are read: {listed}: name the topics in section 'topics' of "
            "sfr.yaml if the namespaces are those of different rovers"
        )
    loc = _drive(bag, config) if kinds[Task.LOCALISATION] else None
    nav = _mapping_pairs(bag, config) if kinds[Task.MAPPING] else None
    is_raw = RAW in kinds.values()
    has_poses = nav is None or bool(bag.matches(NAV_POSE))
    is_adapted = config.changes_messages or not has_poses
    return Source(
        path,
        "bag of raw images" if is_raw else "bag, as configured" if is_adapted else SourceFormat.BAG,
        loc,
        nav,
        config=config,
        calibration="" if loc is None else loc.cameras.text,
        own_extrinsics=None if loc is None else _own_extrinsics(loc, config),
        recorded=None if is_raw or is_adapted else RecordedBag(path, config.topics),
    )


def _drive(bag: Bag, config: SourceConfig) -> BagLocSequence:
    """Return the drive of a bag. The extrinsics are from the configuration, a calibration file or the bag."""
    topics = CameraTopics.of(bag, Task.LOCALISATION, config.calibration)
    cameras = calibrated_cameras(topics, config.calibration)
    mount = None
    T_rb_sb = config.extrinsics.transform() or cameras.rig.T_rb_sb
    if T_rb_sb is None and (mount := mount_of(bag, cameras, config.frames.base)) is not None:
        T_rb_sb = mount.T_rb_sb
    return BagLocSequence(
        topics=topics,
        cameras=replace(cameras, rig=replace(cameras.rig, T_rb_sb=T_rb_sb)),
        read_index=partial(index_of_drive, topics, config.sync),
        mount=mount,
        truth=config.truth,
    )


def _mapping_pairs(bag: Bag, config: SourceConfig) -> BagNavSequence:
    """Return the mapping pairs of a bag; a configured calibration is that of the drive."""
    calibration = CalibrationConfig()
    topics = MappingTopics.of(CameraTopics.of(bag, Task.MAPPING, calibration))
    cameras = calibrated_cameras(topics.cameras, calibration)
    unused = [name for name in changed(config.frames, "frames.") if name != "frames.base"]
    if topics.poses is not None and unused:
        _log.warning(f"bag '{bag.path}': {', '.join(unused)} ignored: the poses of mapping pairs are on '{NAV_POSE}'")
    return BagNavSequence(
        topics=topics.cameras,
        cameras=cameras,
        read_index=partial(index_of_mapping, topics, cameras, config.sync, config.frames),
        points=topics.points,
    )


def _own_extrinsics(loc: BagLocSequence, config: SourceConfig) -> Transform | None:
    """Return the pose of the rig on the rover that the bag gives, even if the configuration replaces this pose.

    None if the bag gives no valid pose, or if a calibration file replaces the cameras of the bag.
    """
    if config.calibration.file:
        return None
    mount = loc.mount
    if config.extrinsics.transform() is not None:
        with suppress(SfrError):
            mount = read_extrinsics(loc.topics.bag, loc.cameras.frame, loc.cameras.rig.baseline_m, config.frames.base)
    return None if mount is None else mount.T_rb_sb
