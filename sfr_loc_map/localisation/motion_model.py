"""Motion model of the left camera: last pose, last motion and speed, and initial guesses of the next pose."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.localisation.motion_size import MotionSize, Speed
from sfr_loc_map.message_stamps import NS_PER_S

MAX_MISSED_PAIRS = 4
"""Maximum number of missing pairs over which the last motion is repeated. The value is 0.5 s at 10 Hz. If larger,
guesses far from the pose cost the time of an alignment. If smaller, more gaps require relocalisation."""

MAX_UNKNOWN_PERIOD_NS = 500_000_000
"""Maximum time between two consecutive pairs while the period is unknown, ns. The value is the time of
`MAX_MISSED_PAIRS` missing pairs at 10 Hz. If larger, the motion in a gap may be interpolated and its uncertainty
missed. If smaller, an external pose between the first two pairs of a slow drive is less certain."""

MAX_JITTER_NS = 10_000_000
"""Maximum difference, ns, of two stamps that count as the same time, because stamps jitter. The value is a tenth of the
period at 10 Hz. If larger, an unobserved motion between two pairs is not reported. If smaller, a start pose that
another program computed for the first pair degrades the first window. The covariance contains the motion in this time
in any case."""


class Prediction(NamedTuple):
    """Prediction of a pair: initial guesses of the left camera's pose in the world."""

    #: The last pose, moved again by the last motion, however long that motion lasted (`LastPose.motion_ns`).
    repeated_motion: Pose
    standstill: Pose  #: The last pose.
    #: If pairs are missing: the last pose, moved by the last motion once for each interval up to this pair. If given:
    #: the pose by wheel odometry.
    others: tuple[Pose, ...]

    @property
    def guesses(self) -> list[Pose]:
        """All guesses without repetitions. After a lost pair, the repeated motion is a standstill."""
        poses: list[Pose] = []
        for pose in (self.repeated_motion, self.standstill, *self.others):
            if not any(_are_equal(pose, earlier) for earlier in poses):
                poses.append(pose)
        return poses


def _are_equal(first: Pose, second: Pose) -> bool:
    """Return whether two poses are exactly equal."""
    return bool((first.position == second.position).all() and (first.rotation == second.rotation).all())


class LastPose(NamedTuple):
    """The last known pose of the left camera, and the motion that led to it."""

    T_world_left: Transform  #: Last known pose in the present map; an adjustment of the map changes it.
    T_before_last: Transform  #: Last motion, in `motion_ns`; the identity to predict a standstill.
    known_ns: int | None  #: Stamp of the last pose from images or of an external pose; later motion is unobserved.
    #: Stamp of the last pair that was accepted or began a window, from which missing pairs are counted; 0 before a
    #: window has begun.
    accepted_ns: int = 0
    #: Time between the last two such pairs; None before the second pair of a window. After more than
    #: `MAX_MISSED_PAIRS` refused pairs, the time is one period, and `T_before_last` is the mean motion in one period.
    motion_ns: int | None = None
    speed: Speed = Speed(0.0, 0.0)  #: Last speed.

    def unobserved_s(self, stamp_ns: int) -> float:
        """Return the time between the last known pose and a stamp, s; 0 before the first pair."""
        return 0.0 if self.known_ns is None else abs(stamp_ns - self.known_ns) / NS_PER_S

    def missing_pairs(self, stamp_ns: int) -> int | None:
        """Return the number of pairs that are missing between the last accepted pair and a stamp.

        The number is unknown (None) before the second pair of a window. The number is also unknown if the time since
        that pair is shorter than half of `motion_ns`, because pairs were then missing during the last motion.
        """
        if self.motion_ns is None:
            return None
        periods = round((stamp_ns - self.accepted_ns) / self.motion_ns)
        return periods - 1 if periods > 0 else None

    def is_followed_by(self, stamp_ns: int) -> bool:
        """Return whether no pair is missing between the last accepted pair and a stamp."""
        missing = self.missing_pairs(stamp_ns)
        if missing is None:
            return stamp_ns - self.accepted_ns <= MAX_UNKNOWN_PERIOD_NS
        return missing == 0

    def has_gap(self, stamp_ns: int) -> bool:
        """Return whether the motion from the last known pose to a pair that begins a window is unobserved.

        There is no gap before the first pair, or if the stamps are equal up to jitter (`MAX_JITTER_NS`). A start pose
        with a later stamp causes no gap either, because images show the motion up to this stamp.
        """
        return self.known_ns is not None and stamp_ns - self.known_ns > MAX_JITTER_NS

    def predict(self, stamp_ns: int, odometry: Transform | None, T_rb_left: Transform) -> Prediction:
        """Return the prediction of the next pair.

        The odometry is the motion `T_before_now` of RB since the last known pose (`known_ns`), from another source.
        """
        last = self.T_world_left
        repeated = last @ self.T_before_last
        others = []
        missed = self.missing_pairs(stamp_ns)
        if missed is not None and 0 < missed <= MAX_MISSED_PAIRS:
            further = repeated
            for _ in range(missed):
                further = further @ self.T_before_last
            others.append(further)
        if odometry is not None:
            others.append(last @ T_rb_left.inverse() @ odometry @ T_rb_left)
        return Prediction(Pose.of(repeated), Pose.of(last), tuple(map(Pose.of, others)))

    def accepted(
        self,
        stamp_ns: int,
        T_world_left: Transform,
        T_before_last: Transform,
        moved: MotionSize,
        *,
        period_ns: int,
        was_known: bool,
    ) -> LastPose:
        """Return the pose of an accepted pair. The speed is updated only if the previous pose was known.

        Args:
            stamp_ns: Stamp of the pair.
            T_world_left: Pose of the pair.
            T_before_last: Motion from the last known pose to this pose.
            moved: Size of this motion.
            period_ns: Time between the pair and the previous pair, whether that was refused or not.
            was_known: Whether the previous pose was known.
        """
        speed = self.speed
        if was_known:
            seconds = self.unobserved_s(stamp_ns)
            speed = Speed(moved.metres / seconds, moved.radians / seconds) if seconds > 0.0 else Speed(0.0, 0.0)
        motion_ns = stamp_ns - self.accepted_ns
        # the next pair cannot repeat the motion over a long gap
        if round(motion_ns / period_ns) - 1 > MAX_MISSED_PAIRS:
            T_before_last = interpolated(Transform.identity(), T_before_last, period_ns / motion_ns)
            motion_ns = period_ns
        return LastPose(T_world_left, T_before_last, stamp_ns, stamp_ns, motion_ns, speed)

    def at_stamp(self, stamp_ns: int | None) -> LastPose:
        """Return the pose with another stamp `known_ns`, because an external pose is valid at this stamp.

        The speed is kept, because the rover may have continued at this speed while its motion was unobserved.
        """
        return self._replace(known_ns=stamp_ns)

    def adjusted(self, T_world_left: Transform) -> LastPose:
        """Return the pose after an adjustment of the map moved it."""
        return self._replace(T_world_left=T_world_left)

    def lost(self) -> LastPose:
        """Return the pose after a lost pair. The next pose is predicted at this pose, and the speed is kept."""
        return self._replace(T_before_last=Transform.identity())

    def window_begun(self, stamp_ns: int) -> LastPose:
        """Return the pose after a new window began at this pose. A standstill is predicted, and the speed is kept."""
        return LastPose(self.T_world_left, Transform.identity(), stamp_ns, stamp_ns, None, self.speed)
