"""Motion model: where the left camera is, how it moves, and where it may be next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.uncertainty import RoverModel

MAX_MISSED_PAIRS = 4  #: Number of missing pairs over which a constant velocity is still extrapolated.
SLACK_M = 1.0  #: Motion, m, that is plausible whatever the stamps are.
SLACK_RAD = 1.0  #: Rotation, rad, that is plausible whatever the stamps are.


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The last known pose of the left camera, and the motion that led to it."""

    T_world_left: Transform  #: Last known pose.
    T_before_last: Transform  #: Motion between the two pairs tracked last; the identity at rest.
    known_ns: int | None  #: Stamp of the last known pose; None before the first pair.
    tracked_ns: int = 0  #: Stamp of the pair tracked last.
    period_ns: int = 0  #: Time between the two pairs tracked last; 0 if unknown.
    speed: tuple[float, float] = (0.0, 0.0)  #: Last speed, m/s and rad/s.

    def unobserved_s(self, stamp_ns: int) -> float:
        """Return the time between the last known pose and a stamp, s."""
        return 0.0 if self.known_ns is None else abs(stamp_ns - self.known_ns) / NS_PER_S

    def predict(self, stamp_ns: int, odometry: Transform | None, model: RoverModel) -> list[Pose]:
        """Return the initial guesses of the next pose: constant velocity, standstill, missed pairs, wheel odometry.

        The odometry is a motion of RB since the last pair, `T_before_now`, from another source.
        """
        last = self.T_world_left
        guesses = [last @ self.T_before_last, last]
        missed = round((stamp_ns - self.tracked_ns) / self.period_ns) - 1 if self.period_ns > 0 else 0
        if 0 < missed <= MAX_MISSED_PAIRS:
            further = guesses[0]
            for _ in range(missed):
                further = further @ self.T_before_last
            guesses.append(further)
        if odometry is not None:
            guesses.append(last @ model.T_left_rb @ odometry @ model.T_rb_left)
        return [Pose.of(guess) for guess in guesses]

    def tracked(self, stamp_ns: int, T_world_left: Transform, *, has_predecessor: bool) -> Motion:
        """Return the motion after a tracked pair. The speed is updated only if the pair before was tracked, too."""
        motion = self.T_world_left.inverse() @ T_world_left
        speed = self.speed
        if has_predecessor:
            seconds = abs(stamp_ns - (self.known_ns or 0)) / NS_PER_S
            metres, radians = size_of(motion)
            speed = (metres / seconds, radians / seconds) if seconds > 0.0 else (0.0, 0.0)
        return Motion(T_world_left, motion, stamp_ns, stamp_ns, stamp_ns - self.tracked_ns, speed)

    def at_rest(self) -> Motion:
        """Return the motion after tracking was lost: the rover is assumed to stand still."""
        return replace(self, T_before_last=Transform.identity())

    def restarted(self, stamp_ns: int) -> Motion:
        """Return the motion after a new window began at the last pose, at rest; the period is unknown."""
        return Motion(self.T_world_left, Transform.identity(), stamp_ns, stamp_ns, 0, self.speed)


def size_of(motion: Transform) -> tuple[float, float]:
    """Return the length, m, and the angle, rad, of a motion."""
    return float(np.linalg.norm(motion.translation)), float(np.linalg.norm(rotvec_from_matrix(motion.rotation)))


def is_plausible(motion: Motion, stamp_ns: int, T_world_left: Transform, bounds: MotionBounds) -> bool:
    """Return whether a rover can have moved to a pose since the last known one. NaN is not plausible."""
    seconds = abs(stamp_ns - (motion.known_ns or 0)) / NS_PER_S
    metres, radians = size_of(motion.T_world_left.inverse() @ T_world_left)
    max_m = SLACK_M + bounds.max_speed_m_s * seconds
    max_rad = SLACK_RAD + bounds.max_turn_rad_s * seconds
    return metres <= max_m and radians <= max_rad
