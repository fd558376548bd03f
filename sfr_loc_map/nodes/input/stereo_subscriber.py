"""The stereo pictures and camera_info of one stereo bench, from topics to pairs that fit their rig."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from sfr_loc_map.config import param
from sfr_loc_map.constants import JUMP_BACK_NS, NS_PER_S
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.qos import RELIABILITIES, profile
from sfr_loc_map.nodes.messages.image import check_image, grey_from_image
from sfr_loc_map.pipeline.online.latency import MessageTimes
from sfr_loc_map.pipeline.online.stamp_pairing import StampPairing
from sfr_loc_map.pipeline.online.transport_gaps import TransportGaps

MAX_PIXELS = 8192 * 8192
"""Largest picture that is believed: a header may claim any size, and all that is allocated follows from it."""


@dataclass(frozen=True, slots=True)
class StereoInputConfig:
    """How stereo pictures are received."""

    image_transport: str = param(
        "auto",
        doc="Topics of pictures: image_rect (raw), image_rect/compressed (compressed), or whichever comes (auto).",
        choices=("raw", "compressed", "auto"),
    )
    reliability: str = param(
        "reliable",
        doc="Reliability asked of the publishers of pictures and camera_info; best_effort takes both kinds.",
        choices=RELIABILITIES,
    )
    queue_depth: int = param(
        30, unit="pictures", doc="Most pictures that wait on each side; older ones are dropped.", low=1, high=1000
    )
    stamp_tolerance_s: float = param(
        0.0, unit="s", doc="Largest difference between the stamps of left and right; 0: equal.", low=0.0, high=0.5
    )


@dataclass(slots=True)
class InputCounts:
    """What did not become a result."""

    rejected: int = 0
    broken: int = 0
    stale: int = 0
    without_camera_info: int = 0


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as it came.

    Attributes:
        message: sensor_msgs/Image or CompressedImage.
        receipt: When.
    """

    message: Any
    receipt: MessageTimes


@dataclass(frozen=True, slots=True)
class ReceivedPair:
    """Two pictures of one moment, not yet decoded.

    Attributes:
        stamp_ns: Stamp of the left one.
        rig: The rig that took them.
        frame_id: Frame of the left camera as its camera_info names it.
        left: Left picture.
        right: Right picture.
    """

    stamp_ns: int
    rig: StereoRig
    frame_id: str
    left: Picture
    right: Picture

    @property
    def receipts(self) -> tuple[MessageTimes, MessageTimes]:
        """When they came."""
        return self.left.receipt, self.right.receipt

    def decode(self) -> StereoPair:
        """Return the pictures in grey.

        Raises:
            InputError: If one cannot be read.
        """
        return StereoPair(self.stamp_ns, _grey(self.left.message, self.rig), _grey(self.right.message, self.rig))


class StereoInput:
    """Subscribes to one stereo bench and hands over pairs that fit their rig.

    Attributes:
        rig: The rig, None until camera_info of both cameras has come.
        counts: What was dropped, and why.
        last_ns: Stamp of the last pair, None where a new run begins.
    """

    def __init__(
        self,
        node: ManagedNode,
        bench: str,
        config: StereoInputConfig,
        *,
        on_pair: Callable[[ReceivedPair], None],
        on_rig: Callable[[StereoRig], None],
        on_jump_back: Callable[[], None],
    ) -> None:
        """Subscribe.

        Args:
            node: The node; problems are reported by it.
            bench: First part of the topics, `loc` or `nav`.
            config: How.
            on_pair: Called with each pair, in the order of the stamps.
            on_rig: Called with the rig before the first pair, and when it changes.
            on_jump_back: Called before the first pair of a new run, when stamps have gone back.
        """
        self.rig: StereoRig | None = None
        self.counts = InputCounts()
        self.last_ns: int | None = None
        self._node, self._bench = node, bench
        self._on_pair, self._on_rig, self._on_jump_back = on_pair, on_rig, on_jump_back
        self._infos: dict[str, CameraInfo] = {}
        self._fresh: set[str] = set()
        self._gaps: list[TransportGaps] = []
        self._depth = config.queue_depth
        self._pairing: StampPairing[Picture] = StampPairing(
            round(config.stamp_tolerance_s * NS_PER_S), config.queue_depth
        )
        self._waiting: deque[tuple[Picture, Picture]] = deque()
        self._subscribe(config)

    @property
    def unpaired(self) -> int:
        """Pictures whose partner never came."""
        return self._pairing.unpaired + self._pairing.overflowed

    def restart(self) -> None:
        """Forget what waits and which stamp was last."""
        self._pairing.clear()
        self._waiting.clear()
        self.last_ns = None

    def is_ahead(self) -> bool:
        """Tell whether the last pair lies so far after the node's time that this must have gone back since."""
        now_ns = self._node.get_clock().now().nanoseconds
        return self.last_ns is not None and self.last_ns >= now_ns + JUMP_BACK_NS

    def statistics(self) -> dict[str, int]:
        """Return the counts of what was dropped since the start, by name."""
        return {
            "dropped_in_transport": sum(gaps.lost for gaps in self._gaps),
            "dropped_unpaired": self.unpaired,
            "dropped_rejected": self.counts.rejected + self.counts.broken,
            "dropped_stale": self.counts.stale,
            "dropped_without_camera_info": self.counts.without_camera_info,
        }

    def _subscribe(self, config: StereoInputConfig) -> None:
        qos = profile(config.reliability, config.queue_depth)
        kinds: list[tuple[str, type[Any]]] = []
        if config.image_transport != "compressed":
            kinds.append(("image_rect", Image))
        if config.image_transport != "raw":
            kinds.append(("image_rect/compressed", CompressedImage))
        for side, add in (("left", self._pairing.add_left), ("right", self._pairing.add_right)):
            self._node.listen_to(CameraInfo, f"{self._bench}/{side}/camera_info", self._info_callback(side), qos)
            for name, kind in kinds:
                self._node.listen_to(kind, f"{self._bench}/{side}/{name}", self._image_callback(add), qos)

    def _info_callback(self, side: str) -> Callable[[CameraInfo], None]:
        def received(message: CameraInfo) -> None:
            self._infos[side] = message
            self._fresh.add(side)
            # one of each is judged at a time: while a rig changes, the new one of one side comes first
            if len(self._fresh) == 2:
                self._fresh.clear()
                self._update_rig()

        return received

    def _image_callback(self, add: Callable[[int, Picture], tuple[Picture, Picture] | None]) -> Callable[..., None]:
        gaps = TransportGaps()
        self._gaps.append(gaps)

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - Image or CompressedImage
            gaps.came(info)
            self._node.health.arrived()
            found = add(stamp_of(message), Picture(message, MessageTimes.of(info)))
            if found is not None:
                self._accept(found)

        return received

    def _update_rig(self) -> None:
        left, right = self._infos["left"], self._infos["right"]
        try:
            rig = rig_from_camera_info(left, right, self._bench)
            if rig.width * rig.height > MAX_PIXELS:
                raise InputError(
                    f"camera_info of {self._bench} says {rig.width} x {rig.height}: pictures of up to {MAX_PIXELS} "
                    f"pixels are taken; publish the size that the pictures have"
                )
        except InputError as error:
            self._node.report_problem(str(error))
            return
        if self.rig is None or not self.rig.same_cameras(rig):
            self.rig = rig
            self._on_rig(rig)
        while self._waiting:
            self._hand_over(rig, self._waiting.popleft())

    def _accept(self, pictures: tuple[Picture, Picture]) -> None:
        if self.rig is not None:
            self._hand_over(self.rig, pictures)
            return
        self._waiting.append(pictures)
        if len(self._waiting) > self._depth:
            self._waiting.popleft()
            self.counts.without_camera_info += 1
            self._node.report_problem(
                f"pictures of '{self._bench}' come without a usable camera_info of both cameras: dropped"
            )

    def _hand_over(self, rig: StereoRig, pictures: tuple[Picture, Picture]) -> None:
        stamp_ns = stamp_of(pictures[0].message)
        try:
            for picture in pictures:
                check_image(picture.message, (rig.width, rig.height))
        except InputError as error:
            self.counts.rejected += 1
            self._node.report_problem(str(error))
            return
        if self.last_ns is not None and stamp_ns <= self.last_ns:
            if self.last_ns - stamp_ns < JUMP_BACK_NS:
                self.counts.stale += 1
                return
            self._on_jump_back()
        self.last_ns = stamp_ns
        frame_id = str(self._infos["left"].header.frame_id)
        self._on_pair(ReceivedPair(stamp_ns, rig, frame_id, *pictures))


def _grey(message: Any, rig: StereoRig) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage
    try:
        return grey_from_image(message, (rig.width, rig.height))
    except InputError:
        raise
    except Exception as error:  # data from the network: whatever a decoder says of it, the node goes on
        raise InputError(f"image of stamp {stamp_of(message)} cannot be read: {error}") from error
