"""Wheel odometry as an initial guess of the motion, interpolated between messages."""

from __future__ import annotations

from collections import deque
from threading import Condition

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.stamped_poses import pose_at
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import check_given
from sfr_loc_map.run_order import RunOrder

CAPACITY = 5000  #: Number of stored messages: 100 s at 50 Hz.
MAX_GAP_NS = 500_000_000
"""Longest interval between two messages in which poses are interpolated, ns. The motion may change within a longer
interval."""


class OdometryBuffer:
    """Stores the last poses of an external odometry and returns the motion between two stamps.

    One thread may add messages while another reads.
    """

    def __init__(self) -> None:
        self._poses: deque[tuple[int, Transform]] = deque(maxlen=CAPACITY)
        self._order = RunOrder[tuple[int, Transform]]()
        self._changed = Condition()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last stored message; None if the buffer is empty."""
        return self._poses[-1][0] if self._poses else None

    def add(self, stamp_ns: int, T_odom_rb: Transform) -> None:
        """Add a message. Late messages are dropped. A new run clears the buffer, for example if a recording loops."""
        with self._changed:
            accepted, begins_run = self._order.add(stamp_ns, (stamp_ns, T_odom_rb))
            if begins_run:
                self._poses.clear()
            self._poses.extend(accepted)
            self._changed.notify_all()

    def between(self, before_ns: int, now_ns: int, wait_s: float) -> Transform | None:
        """Return `T_before_now` of RB; None if the messages do not cover both stamps, or if the motion is invalid.

        A motion is invalid if a coordinate exceeds `MAX_GIVEN_M`, as after a jump of the odometry. Unless the buffer is
        empty, the call waits up to `wait_s` for a message at or after `now_ns`.
        """
        with self._changed:
            if self._poses:
                self._changed.wait_for(lambda: not self._poses or self._poses[-1][0] >= now_ns, wait_s)
            before, now = (pose_at(self._poses, stamp_ns, MAX_GAP_NS) for stamp_ns in (before_ns, now_ns))
        if before is None or now is None:
            return None
        try:
            T_before_now = before.inverse() @ now
            check_given(T_before_now, "the odometry")
        except GeometryError:
            return None
        return T_before_now
