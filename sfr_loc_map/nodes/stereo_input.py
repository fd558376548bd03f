"""The stereo pictures and camera_info of one stereo bench, from topics to checked pairs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from sfr_loc_map.config import param
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import GreyImage, StereoPair, StereoRig
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.conversions import NS, grey_from_image
from sfr_loc_map.nodes.pairing import StampPairing

JUMP_BACK_NS = 1 * NS
"""A stamp this far behind the last one is a new run (a bag that loops), not a late picture."""
WARN_EVERY_S = 5.0


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
        choices=("reliable", "best_effort"),
    )
    queue_depth: int = param(
        30, unit="pictures", doc="Most pictures that wait on each side; older ones are dropped.", low=1, high=1000
    )
    stamp_tolerance_s: float = param(
        0.0, unit="s", doc="Largest difference between the stamps of left and right; 0: equal.", low=0.0, high=0.5
    )


@dataclass(slots=True)
class InputCounts:
    """What did not become a pair."""

    transport: int = 0
    rejected: int = 0
    stale: int = 0
    without_camera_info: int = 0


class StereoInput:
    """Subscribes to one stereo bench and hands over pairs that fit their rig.

    Attributes:
        rig: The rig, None until camera_info of both cameras has come.
        counts: What was dropped, and why.
    """

    def __init__(
        self,
        node: Node,
        bench: str,
        config: StereoInputConfig,
        *,
        on_pair: Callable[[StereoPair], None],
        on_rig: Callable[[StereoRig], None],
        on_jump_back: Callable[[], None],
        on_problem: Callable[[str], None],
    ) -> None:
        """Subscribe.

        Args:
            node: The node.
            bench: First part of the topics, `loc` or `nav`.
            config: How.
            on_pair: Called with each pair, in the order of the stamps.
            on_rig: Called with the rig before the first pair, and when it changes.
            on_jump_back: Called before the first pair of a new run, when stamps have gone back.
            on_problem: Called with what is wrong when messages cannot be used.
        """
        self.rig: StereoRig | None = None
        self.counts = InputCounts()
        self._node, self._bench = node, bench
        self._on_pair, self._on_rig = on_pair, on_rig
        self._on_jump_back, self._on_problem = on_jump_back, on_problem
        self._infos: dict[str, CameraInfo] = {}
        self._pairing: StampPairing[Any] = StampPairing(round(config.stamp_tolerance_s * NS), config.queue_depth)
        self._waiting: deque[tuple[Any, Any]] = deque()
        self._depth = config.queue_depth
        self._last_ns: int | None = None
        self.topics = self._subscribe(config)

    @property
    def unpaired(self) -> int:
        """Pictures whose partner never came."""
        return self._pairing.unpaired + self._pairing.overflowed

    @property
    def frame_id(self) -> str:
        """Frame of the left camera as its camera_info names it."""
        info = self._infos.get("left")
        return str(info.header.frame_id) if info is not None else ""

    def restart(self) -> None:
        """Forget what waits and which stamp was last."""
        self._pairing.clear()
        self._waiting.clear()
        self._last_ns = None

    def statistics(self) -> dict[str, int]:
        """Return the counts of what was dropped since the start, by name."""
        return {
            "dropped_in_transport": self.counts.transport,
            "dropped_unpaired": self.unpaired,
            "dropped_rejected": self.counts.rejected,
            "dropped_stale": self.counts.stale,
            "dropped_without_camera_info": self.counts.without_camera_info,
        }

    def _subscribe(self, config: StereoInputConfig) -> list[str]:
        reliable = config.reliability == "reliable"
        policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=config.queue_depth, reliability=policy)
        kinds: list[tuple[str, type[Any]]] = []
        if config.image_transport != "compressed":
            kinds.append(("image_rect", Image))
        if config.image_transport != "raw":
            kinds.append(("image_rect/compressed", CompressedImage))
        topics = []
        for side, add in (("left", self._pairing.add_left), ("right", self._pairing.add_right)):
            topic = f"{self._bench}/{side}/camera_info"
            received = self._info_callback(side)
            topics.append(self._node.create_subscription(CameraInfo, topic, received, qos).topic_name)
            for name, kind in kinds:
                topic = f"{self._bench}/{side}/{name}"
                topics.append(self._node.create_subscription(kind, topic, self._image_callback(add), qos).topic_name)
        return topics

    def _info_callback(self, side: str) -> Callable[[CameraInfo], None]:
        def received(message: CameraInfo) -> None:
            self._infos[side] = message
            if len(self._infos) == 2:
                self._update_rig()

        return received

    def _image_callback(self, add: Callable[[int, Any], tuple[Any, Any] | None]) -> Callable[..., None]:
        last = 0

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - Image or CompressedImage
            # The publisher numbers its messages; one that begins anew counts from 1 again.
            nonlocal last
            number = info.get("publication_sequence_number") or 0
            if last and number > last:
                self.counts.transport += number - last - 1
            last = number
            found = add(stamp_of(message), message)
            if found is not None:
                self._accept(found)

        return received

    def _update_rig(self) -> None:
        try:
            rig = rig_from_camera_info(self._infos["left"], self._infos["right"], self._bench)
        except InputError as error:
            self._on_problem(str(error))
            return
        if self.rig is None or not self.rig.same_cameras(rig):
            self.rig = rig
            self._on_rig(rig)
        while self._waiting:
            self._hand_over(rig, self._waiting.popleft())

    def _accept(self, messages: tuple[Any, Any]) -> None:
        if self.rig is not None:
            self._hand_over(self.rig, messages)
            return
        self._waiting.append(messages)
        if len(self._waiting) > self._depth:
            self._waiting.popleft()
            self.counts.without_camera_info += 1
            self._on_problem(f"pictures of '{self._bench}' come without a usable camera_info of both cameras: dropped")

    def _hand_over(self, rig: StereoRig, messages: tuple[Any, Any]) -> None:
        stamp_ns = stamp_of(messages[0])
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            if self._last_ns - stamp_ns < JUMP_BACK_NS:
                self.counts.stale += 1
                return
            self._on_jump_back()
        try:
            left, right = (_grey(message, rig) for message in messages)
        except InputError as error:
            self.counts.rejected += 1
            self._on_problem(str(error))
            return
        self._last_ns = stamp_ns
        self._on_pair(StereoPair(stamp_ns, left, right))


def _grey(message: Any, rig: StereoRig) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage
    try:
        return grey_from_image(message, (rig.width, rig.height))
    except InputError:
        raise
    except Exception as error:  # data from the network: whatever a decoder says of it, the node goes on
        raise InputError(f"image of stamp {stamp_of(message)} cannot be read: {error}") from error
