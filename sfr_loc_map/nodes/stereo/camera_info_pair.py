"""The camera_info messages of both cameras of a rig."""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import CameraInfo

from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.suite_names import Side


class CameraInfoPair:
    """Combines new camera_info messages of the left and right camera into pairs from one calibration of the rig.

    When the calibration changes, the message of one side arrives first, and that of the other side may be lost. A
    waiting message with the previous calibration is therefore discarded when the calibration of the other side has
    changed, unless both messages have the same stamp. Repeated messages are allowed.
    """

    def __init__(self) -> None:
        self.last: dict[Side, CameraInfo] = {}  #: Last message of each side.
        self._waiting: dict[Side, CameraInfo] = {}  # new messages since the last pair
        self._paired: dict[Side, CameraInfo] = {}  # the last pair

    def add(self, side: Side, message: CameraInfo) -> tuple[CameraInfo, CameraInfo] | None:
        """Add a message; return the left and right messages once both are new, None before."""
        self.last[side] = message
        self._waiting[side] = message
        if self._has_changed(side):
            other: Side = "right" if side == "left" else "left"
            if other in self._waiting and not self._has_changed(other) and not self._have_same_stamp():
                del self._waiting[other]
        if len(self._waiting) < 2:
            return None
        self._paired = self._waiting.copy()
        self._waiting.clear()
        return self._paired["left"], self._paired["right"]

    def clear(self) -> None:
        """Forget all messages."""
        self.last.clear()
        self._waiting.clear()
        self._paired.clear()

    def _has_changed(self, side: Side) -> bool:
        """Return whether the calibration of a waiting message differs from that of the last pair."""
        return side in self._paired and _calibration(self._waiting[side]) != _calibration(self._paired[side])

    def _have_same_stamp(self) -> bool:
        """Return whether the waiting messages of both sides have the same known stamp; 0 is an unknown stamp."""
        left_ns, right_ns = (stamp_of(message) for message in self._waiting.values())
        return left_ns == right_ns != 0


def _calibration(message: CameraInfo) -> tuple[Any, ...]:
    """Return the content of a message without its header."""
    numbers = (*message.d, *message.k, *message.r, *message.p)
    size = (message.width, message.height, message.binning_x, message.binning_y)
    return message.distortion_model, message.roi, size, numbers
