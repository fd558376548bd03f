"""Initial guesses of the pose at the next pair."""

from __future__ import annotations

from sfr_loc_map.geometry.transform import Transform

MAX_MISSED_PAIRS = 4
"""Missing pairs over which a constant velocity is still extrapolated."""


class MotionModel:
    """Constant velocity: remembers the motion between the last two pairs and the time it took."""

    def __init__(self, T_rb_left: Transform) -> None:
        """Start at rest; the extrinsics take motions of RB, as of wheel odometry, to those of the left camera."""
        self._T_rb_left = T_rb_left
        self._T_before_last = Transform.identity()
        self._stamp_ns, self._period_ns = 0, 0

    def restart(self, stamp_ns: int) -> None:
        """Start at rest at a pair; the period is unknown until the next one."""
        self._T_before_last = Transform.identity()
        self._stamp_ns, self._period_ns = stamp_ns, 0

    def stop(self) -> None:
        """Assume rest, as after lost tracking."""
        self._T_before_last = Transform.identity()

    def update(self, stamp_ns: int, T_before_last: Transform) -> None:
        """Take the motion of the left camera since the last tracked pair."""
        self._T_before_last = T_before_last
        self._stamp_ns, self._period_ns = stamp_ns, stamp_ns - self._stamp_ns

    def predictions(self, T_world_last: Transform, stamp_ns: int, T_rb_motion: Transform | None) -> list[Transform]:
        """Return guesses of the left camera's pose: constant velocity, standstill, missed pairs, wheel odometry.

        Args:
            T_world_last: Left camera at the last tracked pair.
            stamp_ns: Stamp of the pair whose pose is wanted.
            T_rb_motion: Motion of RB since the last pair by another source, `T_before_now`; None without one.
        """
        constant_velocity = T_world_last @ self._T_before_last
        guesses = [constant_velocity, T_world_last]
        missed = self._missed_pairs(stamp_ns)
        if 0 < missed <= MAX_MISSED_PAIRS:
            further = constant_velocity
            for _ in range(missed):
                further = further @ self._T_before_last
            guesses.append(further)
        if T_rb_motion is not None:
            guesses.append(T_world_last @ self._T_rb_left.inverse() @ T_rb_motion @ self._T_rb_left)
        return guesses

    def _missed_pairs(self, stamp_ns: int) -> int:
        """Return how many pairs are missing since the last tracked one, by the stamps; repeated pairs count."""
        return round((stamp_ns - self._stamp_ns) / self._period_ns) - 1 if self._period_ns > 0 else 0
