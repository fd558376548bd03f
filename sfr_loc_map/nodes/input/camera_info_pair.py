"""The camera_info messages of both cameras of a rig."""

from __future__ import annotations

from sensor_msgs.msg import CameraInfo

from sfr_loc_map.inputs import SIDES, Side


class CameraInfoPair:
    """Joins new camera_info messages of both cameras: when a calibration changes, one side arrives first."""

    def __init__(self) -> None:
        self.last: dict[Side, CameraInfo] = {}  #: Last message of each side.
        self._new_sides: set[Side] = set()

    def add(self, side: Side, message: CameraInfo) -> tuple[CameraInfo, CameraInfo] | None:
        """Add a message; return the left and right messages once both are new, None before."""
        self.last[side] = message
        self._new_sides.add(side)
        if len(self._new_sides) < len(SIDES):
            return None
        self._new_sides.clear()
        return self.last["left"], self.last["right"]

    def clear(self) -> None:
        """Forget all messages."""
        self.last.clear()
        self._new_sides.clear()
