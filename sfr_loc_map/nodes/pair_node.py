"""The topics of one stereo rig, synchronised to pairs that fit it, and what the nodes that process them share."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, TypeVar

from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import String

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, InputError, SfrError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import NS_PER_S, SIDES, Side, stamp_of
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_message
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.io.stamp_pairing import STAMP_TOLERANCE_S, StampPairing
from sfr_loc_map.localisation.parallel import both
from sfr_loc_map.nodes.diagnostics import Level
from sfr_loc_map.nodes.environment import EXPORT_LINE
from sfr_loc_map.nodes.lifecycle.endpoints import RELIABILITIES, profile
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.parameters import NodeConfig
from sfr_loc_map.nodes.lifecycle.worker import Overload
from sfr_loc_map.nodes.messages import check_image
from sfr_loc_map.pipeline.call_stats import CallRecord, encode_call
from sfr_loc_map.pipeline.reception import MUCH_LOST, TransportGaps, jumped_back, latencies, loss_fix

LOSS_WINDOW = 40  #: Images of which the share lost is taken, at the least.
CALL_DEPTH = 1000  #: Calls that are kept for a slow subscriber.
RECENT = 200  #: Stamps that are kept of each topic, to say why no pair comes of them.
ReceivedImage = tuple[Any, Mapping[str, Any]]
"""sensor_msgs/Image or CompressedImage, and what the middleware tells of it."""
Seen = dict[str, tuple[list[int], tuple[Any, ...]]]
"""Stamps (ns) and some messages that were received of each topic, by the suite's names."""


@dataclass(frozen=True, slots=True)
class StereoInputConfig:
    """How stereo images are received."""

    image_transport: str = param(
        "auto",
        doc="Topics of images: image_rect (raw), image_rect/compressed (compressed), or both (auto); of image_raw "
        "likewise.",
        choices=("raw", "compressed", "auto"),
    )
    rectify: bool = param(
        False,
        doc="Take image_raw instead of image_rect, and rectify it by the D, K, R and P of camera_info: models "
        "plumb_bob, rational_polynomial, equidistant (fisheye).",
    )
    reliability: str = param(
        "best_effort",
        doc="Reliability requested from the publishers of images, camera_info and nav/pose; best_effort matches both "
        "kinds.",
        choices=RELIABILITIES,
    )
    queue_depth: int = param(
        30, unit="images", doc="Most images that wait on each side; older ones are dropped.", low=1, high=1000
    )
    stamp_tolerance_s: float = param(
        STAMP_TOLERANCE_S,
        unit="s",
        doc="Largest difference between the stamps of left and right, always below half a period; 0: equal.",
        low=0.0,
        high=0.5,
    )

    @property
    def stamp_tolerance_ns(self) -> int:
        """The tolerance in nanoseconds."""
        return round(self.stamp_tolerance_s * NS_PER_S)


@dataclass(frozen=True, slots=True)
class ReceivedPair:
    """Two image messages of one moment, not yet decoded."""

    stamp_ns: int  #: Stamp of the left one.
    rig: StereoRig  #: The rig that took them.
    frame_id: str  #: Frame of the left camera by its camera_info.
    images: tuple[ReceivedImage, ReceivedImage]  #: The left and the right one.
    rectifier: StereoRectifier | None = None  #: What rectifies the images, None where they are rectified.

    def decode(self) -> StereoPair:
        """Return the images in grey, rectified."""
        images = both(self._grey, (0,), (1,))
        return StereoPair(self.stamp_ns, *(images if self.rectifier is None else self.rectifier.rectify(*images)))

    def _grey(self, side: int) -> GreyImage:
        message = self.images[side][0]
        try:
            return image_from_message(message)
        except InputError:
            raise
        except Exception as error:  # data from the network: whatever a decoder raises, the node goes on
            raise InputError(f"image of stamp {stamp_of(message)} cannot be read: {error}") from error


class StereoInput:
    """Receives the images of one rig and hands over its pairs, in the executor's thread."""

    def __init__(self, node: PairNode[Any]) -> None:
        self.rig: StereoRig | None = None
        self.dropped = {"rejected": 0, "stale": 0, "without_camera_info": 0}
        self.unprocessed = 0
        self._node, self._name, self._config = node, node.rig_name, node.config.input
        config, self._report = self._config, node.status.error
        stem, transport = "image_raw" if config.rectify else "image_rect", config.image_transport
        kinds = (("compressed", stem, Image), ("raw", f"{stem}/compressed", CompressedImage))
        self._images: dict[str, type[Any]] = {name: kind for other, name, kind in kinds if transport != other}
        self.last_ns: int | None = None
        self._infos: dict[Side, CameraInfo] = {}
        self._fresh_sides: set[Side] = set()
        self._rectifier: StereoRectifier | None = None
        self._pairing: StampPairing[ReceivedImage] = StampPairing(config.stamp_tolerance_ns, config.queue_depth)
        self._without_rig: deque[tuple[ReceivedImage, ReceivedImage]] = deque()
        self._gaps: list[TransportGaps] = []
        self._judged = 0, 0  # images lost and sent when their share was taken last
        self._recent_ns: dict[Side, deque[int]] = {side: deque(maxlen=RECENT) for side in SIDES}
        self._unused: dict[Side, Any] = {}  # the last image of a side, while it makes no pair

    def subscribe(self) -> None:
        """Subscribe to images and camera_info of both cameras; forget those of before."""
        self.restart()
        self.rig = None
        self._infos.clear()
        self._fresh_sides.clear()

        def received(side: Side, gaps: TransportGaps, message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401
            if gaps.add(info) and (share := self.lost_share()) > MUCH_LOST:
                text = f"{share:.0%} of the images of '{self._name}' are lost in transport: {loss_fix(EXPORT_LINE)}"
                self._node.status.warn(text, "transport")
            self._node.status.note_arrival()
            self.add_image(side, (message, info))

        qos, endpoints = profile(self._config.reliability, self._config.queue_depth), self._node.endpoints
        for side in SIDES:
            stem = f"{self._name}/{side}"
            endpoints.add_subscription(CameraInfo, f"{stem}/camera_info", partial(self.add_camera_info, side), qos)
            for name, kind in self._images.items():
                self._gaps.append(TransportGaps())
                endpoints.add_subscription(kind, f"{stem}/{name}", partial(received, side, self._gaps[-1]), qos)

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return {
            "dropped_in_transport": sum(gaps.lost for gaps in self._gaps),
            "dropped_unpaired": self._pairing.unpaired + self._pairing.overflowed,
            "dropped_rejected": self.dropped["rejected"] + self.unprocessed,
            "dropped_stale": self.dropped["stale"],
            "dropped_without_camera_info": self.dropped["without_camera_info"],
        }

    def lost_share(self) -> float:
        """Return the share of the images lost in transport, since there were enough to tell the last time."""
        lost = sum(gaps.lost for gaps in self._gaps)
        sent, (lost_before, sent_before) = lost + sum(gaps.count for gaps in self._gaps), self._judged
        if sent - sent_before < LOSS_WINDOW:
            return 0.0
        self._judged = lost, sent
        return (lost - lost_before) / (sent - sent_before)

    def take_seen(self) -> Seen:
        """Return stamps and a message of each topic, of what has been received since the last time."""
        found: Seen = {}
        for side in SIDES:
            images = [*self._recent_ns[side]], (self._unused[side],) if side in self._unused else ()
            found |= {f"{self._name}/{side}/{name}": images for name in self._images}
            found[f"{self._name}/{side}/camera_info"] = [], (self._infos[side],) if side in self._infos else ()
            self._recent_ns[side].clear()
        return found

    def restart(self) -> None:
        """Forget what waits and which stamp was last."""
        self._pairing.clear()
        self._without_rig.clear()
        self.last_ns = None

    def add_camera_info(self, side: Side, message: CameraInfo) -> None:
        """Take a camera_info; a rig is made of one new one of each side, since on a change one side comes first."""
        self._infos[side] = message
        self._fresh_sides.add(side)
        if len(self._fresh_sides) < 2:
            return
        self._fresh_sides.clear()
        infos = self._infos["left"], self._infos["right"]
        try:
            if self._config.rectify:
                rig, self._rectifier = rectified_rig(infos, self._name, self._rectifier)
            else:
                rig = rig_from_camera_info(*infos, self._name)
        except InputError as error:
            self._report(str(error))
            return
        if self.rig is None or not self.rig.same_cameras(rig):
            self.rig = rig
            self._node._on_rig(rig)
        while self._without_rig:
            self._hand_over(rig, self._without_rig.popleft())

    def add_image(self, side: Side, image: ReceivedImage) -> None:
        """Take an image, and hand over the pair that it completes."""
        self._recent_ns[side].append(stamp_of(image[0]))
        self._unused[side] = image[0]
        add = self._pairing.add_left if side == "left" else self._pairing.add_right
        images = add(stamp_of(image[0]), image)
        if images is None:
            return
        if self.rig is not None:
            self._hand_over(self.rig, images)
            return
        self._without_rig.append(images)
        if len(self._without_rig) > self._config.queue_depth:
            self._without_rig.popleft()
            self.dropped["without_camera_info"] += 1
            self._report(f"images of '{self._name}' come without a usable camera_info of both cameras: dropped")

    def _hand_over(self, rig: StereoRig, images: tuple[ReceivedImage, ReceivedImage]) -> None:
        stamp_ns = stamp_of(images[0][0])
        try:
            for message, _ in images:
                check_image(message, (rig.width, rig.height))
        except InputError as error:
            self.dropped["rejected"] += 1
            self._report(str(error))
            return
        if self.last_ns is not None and stamp_ns <= self.last_ns:
            if not jumped_back(self.last_ns, stamp_ns):
                self.dropped["stale"] += 1
                return
            self._node.restart("stamps have gone back")
        self.last_ns = stamp_ns
        self._unused.clear()
        frame_id = str(self._infos["left"].header.frame_id)
        self._node._on_pair(ReceivedPair(stamp_ns, rig, frame_id, images, self._rectifier))


@dataclass(frozen=True, slots=True)
class PairNodeConfig(NodeConfig):
    """Parameters that each node has that processes stereo pairs."""

    overload: str = param(
        Overload.EVERY_PAIR.value,
        doc="What is processed under overload: every_pair in order, as far as queue_size allows, or newest_first, "
        "which drops all waiting pairs when a newer one comes.",
        choices=tuple(mode.value for mode in Overload),
    )
    queue_size: int = param(
        30, doc="Most pairs that wait to be processed (every_pair); the oldest are dropped.", low=1, high=1000
    )
    frame_prefix: str = param(
        "", doc="Put before the name of each frame, as rover1/: several rovers then share one tree of frames."
    )
    input: StereoInputConfig = field(default_factory=StereoInputConfig)

    def frame(self, name: str) -> str:
        """Return the name that a frame has in messages."""
        return self.frame_prefix + name

    def check_frame(self, what: str, found: str, parameter: str) -> None:
        """Raise an InputError where a message names another frame than a parameter does."""
        wanted = self.frame(getattr(self, parameter))
        if found not in ("", wanted):
            raise InputError(f"{what} is of '{found}', of '{wanted}' (parameter {parameter}) is needed")

    def check_frames(self, *names: str) -> None:
        """Check names of frames that must differ, by the rules of tf2."""
        for name in names:
            full = self.frame(name)
            if not name or full.startswith("/") or full.split() != [full]:
                raise ConfigError(f"'{full}' is no name of a frame: give one without blanks and without / before it")
        if len(set(names)) < len(names):
            raise ConfigError(f"the frames {', '.join(names)} must have different names")

    def queue(self) -> tuple[Overload, int]:
        """Return the limits that the parameters set."""
        return Overload(self.overload), self.queue_size


P = TypeVar("P", bound=PairNodeConfig)


class PairNode(ManagedNode[P]):
    """A managed node whose worker processes the pairs of one rig; its input is handled in the executor's thread."""

    rig_name: ClassVar[str]
    extrinsics_known = True  #: Whether the pose of the rig is known, as far as the node needs it.
    _calls_before = _silent_periods = 0

    @abstractmethod
    def _on_pair(self, pair: ReceivedPair) -> None:
        """Take a pair."""

    @abstractmethod
    def _on_rig(self, rig: StereoRig) -> None:
        """Take the rig of the pairs that follow."""

    def setup(self) -> None:
        """Create the publisher of the calls; the last one is latched, so that the doctor sees whether one was made."""
        self._calls = self.endpoints.add_publisher(String, "~/call", CALL_DEPTH, latched=True)

    def restart(self, reason: str) -> None:
        """Start a new run after the pairs that came before."""
        self._stereo.restart()

    def teardown(self) -> None:
        """Forget everything."""
        self._stereo = StereoInput(self)

    def subscribe(self) -> None:
        """Subscribe to the images of the rig."""
        self._stereo.subscribe()

    @property
    def rig(self) -> StereoRig | None:
        """The rig that was received last, None before."""
        return self._stereo.rig if hasattr(self, "_stereo") else None  # the parameters are declared before

    @contextmanager
    def ignoring_broken(self) -> Iterator[None]:
        """Warn of a message that the `with` block finds broken, or in another frame."""
        try:
            yield
        except InputError as error:
            self.status.warn(f"{error}; ignored")

    def look_around(self) -> None:
        """Log what was dropped, and where no result came meanwhile, what the node waits for, as the doctor finds it."""
        super().look_around()
        calls, before = self.status.calls, self._calls_before
        self._calls_before, seen = calls, self.take_seen()
        silent = not any(stamps_ns for stamps_ns, _ in seen.values())
        self._silent_periods = periods = self._silent_periods + 1 if silent else 0
        if calls > before or not self.worker.is_idle or (silent and not self.expects_input()):
            return
        from sfr_loc_map.nodes.waiting import waits_for

        self.status.meter.mark_idle()  # with the memory of this import
        config = self.config.input
        about = {"stamp_tolerance_ns": config.stamp_tolerance_ns, "rectifies": config.rectify, "task": self.rig_name}
        ended = "the source has ended or is silent: " if silent and calls else ""
        for text in waits_for(self, seen, config.reliability, extrinsics=self.extrinsics_known, **about):
            self.status.note_problem(Level.WARN, f"waits: {ended}{text}")
            if periods & (periods - 1) == 0:  # of silence after 5, 10, 20, 40 s and so on
                self.get_logger().warning(f"waits: {ended}{text}")

    def take_seen(self) -> Seen:
        """Return stamps and a message of each topic, of what has been received since the last time."""
        return self._stereo.take_seen()

    def clock_jumped_back(self) -> None:
        """Start a new run, unless its pairs have come already."""
        last_ns = self._stereo.last_ns
        if last_ns is not None and jumped_back(last_ns, self.get_clock().now().nanoseconds):
            self.restart("the clock has gone back")

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return self._stereo.counts() | super().counts()

    def enqueue_pair(self, work: Callable[[], None]) -> None:
        """Let the worker process a pair; one that cannot be processed is counted and reported."""

        def job() -> None:
            try:
                work()
            except SfrError as error:
                self._stereo.unprocessed += 1
                self.status.error(str(error))

        self.worker.enqueue(job, 0)

    def restart_after_fault(self) -> None:
        """Count the pair that was processed."""
        self._stereo.unprocessed += 1

    def forget_waiting(self) -> None:
        """Drop the pairs that wait."""
        self.worker.clear()
        self._stereo.restart()

    def publish_call(self, call: CallRecord, level: Level) -> None:
        """Publish a call with the counts since the start: for programs on `~/call`, for people on /diagnostics."""
        call = replace(call, counts=self.counts())
        self._calls.publish(String(data=encode_call(call)))
        self.status.call(call, level)

    def times(self, received: ReceivedPair, conversion_s: float) -> dict[str, float]:
        """Return the latencies of a result that was just published, and what decoding took, seconds."""
        now_ns = self.get_clock().now().nanoseconds
        found = latencies([info for _, info in received.images], received.stamp_ns, time.time_ns(), now_ns)
        return found | {"conversion_s": conversion_s}
