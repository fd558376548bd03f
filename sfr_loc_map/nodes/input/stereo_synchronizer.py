"""Stereo images and camera_info of one rig, synchronised to pairs that fit their rig."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sensor_msgs.msg import CameraInfo

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import Side
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.nodes.input.config import StereoInputConfig
from sfr_loc_map.nodes.input.received_pair import ReceivedImage, ReceivedPair
from sfr_loc_map.nodes.messages.image import check_image
from sfr_loc_map.pipeline.reception import StampPairing, jumped_back


@dataclass(slots=True)
class DropCounts:
    """Pairs that did not become a result, by cause."""

    rejected: int = 0
    stale: int = 0
    without_camera_info: int = 0


@dataclass(frozen=True, slots=True)
class PairHandlers:
    """What is called with the input of one rig.

    Attributes:
        on_pair: With each pair, in the order of the stamps.
        on_rig: With the rig before the first pair, and when it changes.
        on_jump_back: Before the first pair of a new run, when stamps have jumped back.
    """

    on_pair: Callable[[ReceivedPair], None]
    on_rig: Callable[[StereoRig], None]
    on_jump_back: Callable[[], None]


class StereoSynchronizer:
    """Hands over the pairs of one rig.

    Attributes:
        rig: The rig, None until camera_info of both cameras was received.
        dropped: What was dropped, and why.
    """

    def __init__(
        self, name: str, config: StereoInputConfig, handlers: PairHandlers, report: Callable[[str], None]
    ) -> None:
        """Start empty.

        Args:
            name: Of the rig: `loc` or `nav`.
            config: Tolerance and depth.
            handlers: What is called.
            report: Called with what is wrong with the input.
        """
        self.rig: StereoRig | None = None
        self.dropped = DropCounts()
        self._name, self._handlers, self._report = name, handlers, report
        self._last_ns: int | None = None
        self._infos: dict[Side, CameraInfo] = {}
        self._fresh_sides: set[Side] = set()
        self._depth = config.queue_depth
        self._rectify = config.rectify
        self._rectifier: StereoRectifier | None = None
        self._pairing: StampPairing[ReceivedImage] = StampPairing(config.stamp_tolerance_ns, config.queue_depth)
        self._without_rig: deque[tuple[ReceivedImage, ReceivedImage]] = deque()

    @property
    def unpaired(self) -> int:
        """Images whose partner was not received."""
        return self._pairing.unpaired + self._pairing.overflowed

    def restart(self) -> None:
        """Forget what waits and which stamp was last."""
        self._pairing.clear()
        self._without_rig.clear()
        self._last_ns = None

    def is_ahead_of(self, now_ns: int) -> bool:
        """Tell whether the last pair lies so far after a moment that the clock must have jumped back since."""
        return self._last_ns is not None and jumped_back(self._last_ns, now_ns)

    def add_camera_info(self, side: Side, message: CameraInfo) -> None:
        """Take a camera_info; a rig is made of one new one of each side, since on a change one side comes first."""
        self._infos[side] = message
        self._fresh_sides.add(side)
        if len(self._fresh_sides) == 2:
            self._fresh_sides.clear()
            self._update_rig()

    def add_image(self, side: Side, image: ReceivedImage) -> None:
        """Take an image, and hand over the pair that it completes."""
        add = self._pairing.add_left if side == "left" else self._pairing.add_right
        images = add(stamp_of(image.message), image)
        if images is None:
            return
        if self.rig is not None:
            self._hand_over(self.rig, images)
            return
        self._without_rig.append(images)
        if len(self._without_rig) > self._depth:
            self._without_rig.popleft()
            self.dropped.without_camera_info += 1
            self._report(f"images of '{self._name}' come without a usable camera_info of both cameras: dropped")

    def _update_rig(self) -> None:
        try:
            rig = self._new_rig()
        except InputError as error:
            self._report(str(error))
            return
        if self.rig is None or not self.rig.same_cameras(rig):
            self.rig = rig
            self._handlers.on_rig(rig)
        while self._without_rig:
            self._hand_over(rig, self._without_rig.popleft())

    def _new_rig(self) -> StereoRig:
        """Return the rig of the last camera_info, and make what rectifies its images.

        Raises:
            InputError: If they are not those of a rig.
        """
        infos = self._infos["left"], self._infos["right"]
        if not self._rectify:
            return rig_from_camera_info(*infos, self._name)
        rig, self._rectifier = rectified_rig(infos, self._name, self._rectifier)
        return rig

    def _hand_over(self, rig: StereoRig, images: tuple[ReceivedImage, ReceivedImage]) -> None:
        stamp_ns = stamp_of(images[0].message)
        try:
            for image in images:
                check_image(image.message, (rig.width, rig.height))
        except InputError as error:
            self.dropped.rejected += 1
            self._report(str(error))
            return
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            if not jumped_back(self._last_ns, stamp_ns):
                self.dropped.stale += 1
                return
            self._handlers.on_jump_back()
        self._last_ns = stamp_ns
        frame_id = str(self._infos["left"].header.frame_id)
        self._handlers.on_pair(ReceivedPair(stamp_ns, rig, frame_id, *images, self._rectifier))
