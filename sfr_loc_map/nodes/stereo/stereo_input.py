"""Receive the topics of a stereo rig, and combine the images into stereo pairs by their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.calibration.projections import long_baseline
from sfr_loc_map.io.calibration.rectification import StereoRectifier, rig_of_infos
from sfr_loc_map.io.image_codec import SampleDepth, Samples, samples_of
from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.nodes.lifecycle.diagnostics import StatusReporter
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.stereo.camera_info_pair import CameraInfoPair
from sfr_loc_map.nodes.stereo.image_losses import ImageLosses
from sfr_loc_map.nodes.stereo.missing_input import Input
from sfr_loc_map.parallel import both
from sfr_loc_map.ros.image_messages import check_image
from sfr_loc_map.ros.qos import RELIABILITIES, profile
from sfr_loc_map.ros.transport import TransportGaps
from sfr_loc_map.run_order import RunOrder
from sfr_loc_map.stamp_pairing import MAX_TOLERANCE_S, STAMP_TOLERANCE_S, StampPairing
from sfr_loc_map.suite_names import SIDES, Side
from sfr_loc_map.topics import COMPRESSED_END, RAW, RECTIFIED

TRANSPORTS = {"raw": ("", Image), "compressed": (COMPRESSED_END, CompressedImage)}
"""Ending of the topic and type of its messages, by the transport of the images."""
RECENT = 200  #: Number of stamps kept of each side, to explain why its images form no pair.
ReceivedImage = tuple[Any, Mapping[str, Any]]
"""sensor_msgs/Image or CompressedImage, and the message info of the middleware."""


@dataclass(frozen=True, slots=True)
class StereoInputConfig:
    """How stereo images are received."""

    image_transport: str = param(
        "auto",
        doc="Image topics: image_rect (raw), image_rect/compressed (compressed), or both until a raw image is received "
        "(auto); likewise for image_raw.",
        choices=("raw", "compressed", "auto"),
    )
    rectify: bool = param(
        False,
        doc="Use image_raw instead of image_rect, and rectify the images by D, K, R and P of camera_info. Models: "
        "plumb_bob, rational_polynomial, equidistant (fisheye).",
    )
    sample_bits: int = param(
        0,
        unit="bits",
        doc="Bit depth of 16-bit images (mono16) whose sensor uses only the lower bits, such as 10 or 12. 0: the "
        "smallest of 8, 10, 12, 14 and 16 that holds all samples so far.",
        low=0,
        high=16,
    )
    reliability: str = param(
        "best_effort",
        doc="Reliability requested from the publishers of images, camera_info and nav/pose; best_effort matches both "
        "kinds.",
        choices=RELIABILITIES,
    )
    queue_depth: int = param(
        30, unit="images", doc="Maximum number of waiting images per side; older images are dropped.", low=1, high=1000
    )
    stamp_tolerance_s: float = param(
        STAMP_TOLERANCE_S,
        unit="s",
        doc="Maximum stamp difference of left and right image, always less than half a period. 0: equal stamps.",
        low=0.0,
        high=MAX_TOLERANCE_S,
    )

    @property
    def stamp_tolerance_ns(self) -> int:
        """The tolerance in nanoseconds."""
        return round(self.stamp_tolerance_s * NS_PER_S)


@dataclass(frozen=True, slots=True)
class ReceivedPair:
    """A left and a right image message that were paired by their stamps, not yet decoded."""

    stamp_ns: int  #: Stamp of the left image.
    rig: StereoRig  #: The rig that took the images; a node may add its extrinsics.
    frame_id: str  #: Frame of the left camera according to its camera_info.
    images: tuple[ReceivedImage, ReceivedImage]  #: The left and right image.
    depth: SampleDepth  #: Bit depth of 16-bit samples.
    rectifier: StereoRectifier | None = None  #: Rectifies the images; None if they are rectified already.

    def decode(self) -> StereoPair:
        """Return the rectified grey images."""
        images = self.depth.grey(*both(self._samples, (0,), (1,)))
        return StereoPair(self.stamp_ns, *(images if self.rectifier is None else self.rectifier.rectify(*images)))

    def _samples(self, side: int) -> Samples:
        message = self.images[side][0]
        try:
            return samples_of(message)
        except InputError:
            raise
        except Exception as error:  # Data from the network: the node continues after any exception of a decoder.
            raise InputError(f"image of stamp {stamp_of(message)} cannot be read: {error}") from error


class StereoInput:
    """Receives the images of one rig and passes on its pairs; all methods are called in the executor's thread.

    Only `counts` may be called in any thread.
    """

    def __init__(
        self,
        name: str,
        config: StereoInputConfig,
        status: StatusReporter,
        endpoints: Endpoints,
        *,
        on_pair: Callable[[ReceivedPair], None],
        on_new_run: Callable[[str], None],
        agreeing: int,
    ) -> None:
        """Set the callbacks. No message is received before `subscribe`.

        `on_pair` is called with each pair, and `on_new_run` with the reason why the pairs that follow start a new run.
        After a jump of the stamps, `agreeing` consecutive pairs start a new run.
        """
        self._order: RunOrder[tuple[ReceivedImage, ReceivedImage]] = RunOrder(agreeing)
        self._name, self._config, self._status, self._endpoints = name, config, status, endpoints
        self._on_pair, self._on_new_run = on_pair, on_new_run
        stem = RAW if config.rectify else RECTIFIED
        used = TRANSPORTS if config.image_transport == "auto" else (config.image_transport,)
        # message type of an image by the last part of its topic
        self._images: dict[str, type[Any]] = {f"{stem}{end}": kind for end, kind in (TRANSPORTS[name] for name in used)}
        self._dropped = {"rejected": 0, "unstamped": 0, "without_camera_info": 0}
        self._infos = CameraInfoPair()
        self._latched: set[Side] = set()  # sides with a subscription to a latched camera_info
        self._rectifier: StereoRectifier | None = None
        self._pairing: StampPairing[ReceivedImage] = StampPairing(config.stamp_tolerance_ns, config.queue_depth)
        self._without_rig: deque[tuple[ReceivedImage, ReceivedImage]] = deque()
        self.losses = ImageLosses(name, status, endpoints)
        self._remove_compressed: dict[Side, Callable[[], object]] = {}
        self.reset_received()
        self._forget_cameras()

    def _forget_cameras(self) -> None:
        """Forget the calibration and the bit depth; the rig is unknown until camera_info is received."""
        self.rig: StereoRig | None = None
        self._infos.clear()
        self._latched.clear()
        self._depth = SampleDepth(self._status.info, self._name, self._config.sample_bits)

    def subscribe(self) -> None:
        """Subscribe to images and camera_info of both cameras.

        The cameras may differ from those of the last activation. ConfigError if a topic is that of both cameras.
        """
        self._check_remapping()
        self._forget_cameras()
        add_subscription = self._endpoints.add_subscription
        qos = profile(self._config.reliability, self._config.queue_depth)
        for side in SIDES:
            stem = f"{self._name}/{side}"
            add_subscription(CameraInfo, f"{stem}/camera_info", partial(self._add_camera_info, side), qos)
            for name, kind in self._images.items():
                gaps = self.losses.begin_counting(f"{stem}/{name}")
                remove = add_subscription(kind, f"{stem}/{name}", partial(self._receive_image, side, gaps), qos)
                if kind is CompressedImage:
                    self._remove_compressed[side] = remove

    def _check_remapping(self) -> None:
        for name in ("camera_info", *self._images):
            left, right = (f"{self._name}/{side}/{name}" for side in SIDES)
            topic = self._endpoints.full_name(left)
            if topic == self._endpoints.full_name(right):
                raise ConfigError(f"{left} and {right} are both remapped to {topic}: remap each to its own camera")

    def counts(self) -> dict[str, int]:
        """Return the numbers of dropped images and pairs by cause, since the node was configured."""
        return {
            "dropped_in_transport": self.losses.count,
            "dropped_unpaired": self._pairing.unpaired + self._pairing.overflowed,
            "dropped_rejected": self._dropped["rejected"],
            "dropped_stale": self._order.late,  # not later than a previous pair; `Level.STALE` means silent
            "dropped_stray": self._order.strays + self._dropped["unstamped"],
            "dropped_without_camera_info": self._dropped["without_camera_info"],
        }

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last pair of the run, None before the first."""
        return self._order.last_ns

    def inputs(self) -> list[Input]:
        """Return the inputs, each with its number of messages since `reset_received`."""
        found = []
        for side in SIDES:
            images = {f"{self._name}/{side}/{name}": kind for name, kind in self._images.items()}
            info = {f"{self._name}/{side}/camera_info": CameraInfo}
            reliability = self._config.reliability
            found += [
                Input(images, len(self._recent_ns[side]), reliability),
                Input(info, int(side in self._infos.last), reliability, is_stream=False),
            ]
        return found

    def apart_text(self) -> str:
        """Return why the images received since `reset_received` formed no pair; empty if there was a pair."""
        if self._pairs_received or not all(self._recent_ns.values()):
            return ""
        left, right = (np.array(self._recent_ns[side], np.int64) for side in SIDES)
        apart_ms = float(np.median(np.abs(left[:, None] - right).min(axis=1))) * 1e-6
        allowed_ms = self._config.stamp_tolerance_s * 1e3
        return (
            f"left and right images of '{self._name}' are {apart_ms:.3g} ms apart: at most {allowed_ms:.3g} ms "
            "is allowed (input.stamp_tolerance_s); stamp both images with the time of one trigger"
        )

    def reset_received(self) -> None:
        """Reset the counts of received messages."""
        self._recent_ns: dict[Side, deque[int]] = {side: deque(maxlen=RECENT) for side in SIDES}
        self._pairs_received = 0

    def forget_waiting(self) -> None:
        """Forget the waiting images and the last stamp."""
        self._pairing.clear()
        self._without_rig.clear()
        self._order.restart()

    def clock_jumped_back(self, now_ns: int) -> None:
        """Start a new run if the clock was set back to 1 s or more before the stamp of the last pair."""
        if self._order.restart_if_set_back(now_ns):
            self.forget_waiting()
            self._on_new_run("the clock was set back")

    def _add_camera_info(self, side: Side, message: CameraInfo) -> None:
        """Add a camera_info, and use the rig that it completes."""
        if (infos := self._infos.add(side, message)) is None:
            return
        try:
            is_raw = self._config.rectify
            rig, self._rectifier = rig_of_infos(infos, self._name, raw=is_raw, before=self._rectifier)
        except InputError as error:
            self._status.error(str(error))
            return
        if self.rig is None or not self.rig.same_cameras(rig):
            if self.rig is not None:
                self._status.info(f"camera_info of '{self._name}' has changed")
            if warning := long_baseline(rig.baseline_m, f"cameras '{self._name}'"):
                self._status.warn(warning)
            self.rig = rig
        while self._without_rig:
            self._hand_over(rig, self._without_rig.popleft())

    def _add_image(self, side: Side, image: ReceivedImage) -> None:
        """Add an image, and pass on the pair that it completes."""
        if stamp_of(image[0]) <= 0:
            self._dropped["unstamped"] += 1
            text = f"images of '{self._name}/{side}' have the stamp 0: publish them with the time of the exposure"
            self._status.warn(text, "unstamped")
            return
        self._recent_ns[side].append(stamp_of(image[0]))
        add = self._pairing.add_left if side == "left" else self._pairing.add_right
        images = add(stamp_of(image[0]), image)
        if images is None:
            return
        self._pairs_received += 1
        if self.rig is not None:
            self._hand_over(self.rig, images)
            return
        self._without_rig.append(images)
        self._subscribe_latched()
        if len(self._without_rig) > self._config.queue_depth:
            self._without_rig.popleft()
            self._dropped["without_camera_info"] += 1
            self._status.error(f"images of '{self._name}' dropped: usable camera_info of both cameras is required")

    def _subscribe_latched(self) -> None:
        """Subscribe to latched camera_info, because a volatile subscription misses earlier messages."""
        for side in SIDES:
            topic = f"{self._name}/{side}/camera_info"
            missing = side not in self._infos.last and side not in self._latched
            if missing and any(publisher.is_latched for publisher in self._endpoints.publishers(topic)):
                self._latched.add(side)
                self._endpoints.add_latched(CameraInfo, topic, partial(self._add_camera_info, side))

    def _receive_image(self, side: Side, gaps: TransportGaps, message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401
        if isinstance(message, Image) and side in self._remove_compressed:
            self._remove_compressed.pop(side)()  # raw images arrive, so compressed images are not needed
        if gaps.add(info):
            self.losses.warn_if_many()
        self._status.note_arrival()
        self._add_image(side, (message, info))

    def _hand_over(self, rig: StereoRig, images: tuple[ReceivedImage, ReceivedImage]) -> None:
        stamp_ns = stamp_of(images[0][0])
        try:
            for message, _ in images:
                check_image(message, (rig.width, rig.height))
        except InputError as error:
            self._dropped["rejected"] += 1
            self._status.error(str(error))
            return
        ordered, begins_run = self._order.add(stamp_ns, images)
        if begins_run:
            self._on_new_run("the stamps have jumped")
        frame_id = str(self._infos.last["left"].header.frame_id)
        for pair in ordered:
            self._on_pair(ReceivedPair(stamp_of(pair[0][0]), rig, frame_id, pair, self._depth, self._rectifier))
