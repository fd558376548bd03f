"""Where the left camera is, since when that is known, where it may be next, and where poses from outside belong."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.covariance_model import CovarianceMark, CovarianceModel, covariance_of_point
from sfr_loc_map.localisation.estimate import StartPose

HISTORY_PAIRS: Final = 1000
"""Pairs back to which a pose from outside can be bound."""
MAX_AHEAD_NS: Final = 10 * NS_PER_S
"""A pose with a stamp farther ahead of the pairs is of another clock: it is taken for the next pair."""
MAX_MISSED_PAIRS: Final = 4
"""Missing pairs over which a constant velocity is still extrapolated."""
CLIMB_SHARE: Final = 0.3
"""Vertical against horizontal speed of an unseen motion."""
TILT_SHARE: Final = 0.2
"""Rates of roll and pitch against that of the heading."""
MAX_ANGLE: Final = np.pi / np.sqrt(3.0)
"""Standard deviation, radians, of a heading of which nothing is known."""
SLACK_M: Final = 1.0
SLACK_RAD: Final = 1.0
"""Motion that is never implausible, whatever the stamps say."""


class TrackedPose(NamedTuple):
    """A pose of the past: stamp, left camera, what its covariance was made of, whether the pair before was tracked."""

    stamp_ns: int
    T_world_left: Transform
    mark: CovarianceMark
    follows: bool


class PoseTrack:
    """The poses so far, and the world's place in DS.

    Attributes:
        T_ds_world: Takes points in the world to DS.
        T_world_left: Left camera at the last stamp at which it is known.
        T_left_rb: Takes points in RB to the left camera.
        known_ns: That stamp; None before the first pair.
        covariance: What is known of the uncertainty.
        before_first_pair: Whether no pair has arrived yet.
        pending: A pose from outside that has not got its place yet.
    """

    def __init__(self, rig: StereoRig, bounds: MotionBounds, start: StartPose) -> None:
        """Start at a pose.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
        """
        self._T_rb_left, self.T_left_rb, self._bounds = rig.T_rb_left, rig.T_rb_left.inverse(), bounds
        self.covariance = CovarianceModel(rig)
        self._history: deque[TrackedPose] = deque(maxlen=HISTORY_PAIRS)
        self.pending: StartPose | None = None
        self.before_first_pair = True
        self.known_ns: int | None = None
        self.T_world_left = self._T_before_last = Transform.identity()
        self._tracked_ns, self._period_ns = 0, 0
        self._place(start, start.stamp_ns)

    # ---- poses from images

    def guesses(self, stamp_ns: int, T_rb_motion: Transform | None) -> list[Pose]:
        """Return initial guesses: constant velocity, standstill, missed pairs, wheel odometry.

        The last is a motion of RB since the last pair, `T_before_now`, by another source.
        """
        last, step = self.T_world_left, self._T_before_last
        guesses = [last @ step, last]
        missed = round((stamp_ns - self._tracked_ns) / self._period_ns) - 1 if self._period_ns > 0 else 0
        if 0 < missed <= MAX_MISSED_PAIRS:
            further = guesses[0]
            for _ in range(missed):
                further = further @ step
            guesses.append(further)
        if T_rb_motion is not None:
            guesses.append(last @ self.T_left_rb @ T_rb_motion @ self._T_rb_left)
        return [Pose(guess.rotation, guess.translation) for guess in guesses]

    def plausible(self, stamp_ns: int, pose: Pose) -> Transform | None:
        """Return a pose of the left camera; None if it is not finite, or if no rover moves like that since the last."""
        if not (np.isfinite(pose.rotation).all() and np.isfinite(pose.position).all()):
            return None
        T_world_left, seconds = Transform(*pose), abs(stamp_ns - (self.known_ns or 0)) / NS_PER_S
        motion = self.T_world_left.inverse() @ T_world_left
        metres, angle = np.linalg.norm(motion.translation), np.linalg.norm(rotvec_from_matrix(motion.rotation))
        most_m, most_rad = self._bounds.max_speed_m_s * seconds, self._bounds.max_turn_rad_s * seconds
        return T_world_left if metres <= SLACK_M + most_m and angle <= SLACK_RAD + most_rad else None

    def moved(self, stamp_ns: int, T_world_left: Transform, mark: CovarianceMark, *, follows: bool) -> None:
        """Take a pose of the left camera that was tracked; `follows` if that of the pair before was, too."""
        motion, seconds = self.T_world_left.inverse() @ T_world_left, abs(stamp_ns - (self.known_ns or 0)) / NS_PER_S
        self._T_before_last = motion
        self._tracked_ns, self._period_ns = stamp_ns, stamp_ns - self._tracked_ns
        if follows:
            angle, metres = np.linalg.norm(rotvec_from_matrix(motion.rotation)), np.linalg.norm(motion.translation)
            self._speed = (float(metres) / seconds, float(angle) / seconds) if seconds > 0.0 else (0.0, 0.0)
        self.T_world_left, self.known_ns = T_world_left, stamp_ns
        self._history.append(TrackedPose(stamp_ns, T_world_left, mark, follows))

    def begin(self, stamp_ns: int, mark: CovarianceMark) -> None:
        """Take the last pose for that of a pair with which a window begins, at rest; the period is unknown."""
        self.stop()
        self._tracked_ns, self._period_ns = stamp_ns, 0
        self.known_ns = stamp_ns
        self._history.append(TrackedPose(stamp_ns, self.T_world_left, mark, follows=False))

    def stop(self) -> None:
        """Assume rest, as after lost tracking."""
        self._T_before_last = Transform.identity()

    # ---- what was not seen

    def unseen_s(self, stamp_ns: int) -> float:
        """Return how long before a stamp, seconds, the pose was known last."""
        return 0.0 if self.known_ns is None else abs(stamp_ns - self.known_ns) / NS_PER_S

    def unseen_of_rb(self, stamp_ns: int) -> FloatArray:
        """Return the covariance `(6, 6)` of the motion since the pose was known last, in RB there."""
        return self._unseen(self.unseen_s(stamp_ns))

    def unseen(self, stamp_ns: int) -> FloatArray:
        """Return the same of the left camera, in the world."""
        to_world = self.T_world_left.rotation @ self._T_rb_left.rotation.T
        return self._of_left(self.unseen_of_rb(stamp_ns), to_world)

    def allow_unseen(self, stamp_ns: int) -> FloatArray:
        """Allow for the motion up to a stamp, which no image may show, until the next pose; return it of RB."""
        self.covariance.unseen = self.unseen(stamp_ns)
        return self.unseen_of_rb(stamp_ns)

    def _unseen(self, seconds: float) -> FloatArray:
        """Return the covariance `(6, 6)` of a motion that nothing showed for so long, in RB where it began.

        A rover may go on as fast as it did.
        """
        metres_s, radians_s = self._speed
        metres = max(self._bounds.unseen_speed_m_s, metres_s) * seconds
        heading = max(self._bounds.unseen_turn_rad_s, radians_s) * seconds
        tilt = min(TILT_SHARE * heading, MAX_ANGLE)
        return np.diag(np.square([metres, metres, CLIMB_SHARE * metres, tilt, tilt, min(heading, MAX_ANGLE)]))

    # ---- poses from outside

    def set_pose(self, pose: StartPose) -> None:
        """Take a pose from outside, which gets its place with the pair at or after its stamp."""
        if self.before_first_pair:
            self._place(pose, pose.stamp_ns)
        else:
            self.pending = pose

    def arrive(self, stamp_ns: int) -> None:
        """Note the first pair: a start pose without a stamp holds there, whatever that shows.

        A start pose of a later stamp is taken for one of the first pair until its own, as badly known as that makes it.
        """
        if stamp_ns < (self.known_ns or 0) <= stamp_ns + MAX_AHEAD_NS:
            self.pending = self._given
        self.before_first_pair = False
        if self.known_ns is None:
            self.known_ns = stamp_ns

    def bind(self, pose: StartPose, stamp_ns: int) -> bool:
        """Give a pending pose its place, after the pair of a stamp.

        Returns:
            Whether the pose is of a stamp since which nothing was seen: what was seen before is to be forgotten.
        """
        given = pose.stamp_ns
        at_ns = stamp_ns if given is None or given > stamp_ns + MAX_AHEAD_NS else given
        if at_ns > stamp_ns:
            return False
        self.pending = None
        if not self._history or at_ns > self._history[-1].stamp_ns:
            self._place(pose, at_ns)
            return True
        self._rebase(pose, at_ns)
        return False

    def _place(self, pose: StartPose, stamp_ns: int | None) -> None:
        """Let the last pose of the camera be this one, known at a stamp."""
        self._given = pose
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ self.T_world_left.inverse()
        self.known_ns, self._speed = stamp_ns, (0.0, 0.0)
        self._history.clear()
        covariance = self._of_left(pose.covariance, self.T_ds_world.rotation.T)
        self.covariance.restart(self.T_world_left.translation, covariance)

    def _rebase(self, pose: StartPose, at_ns: int) -> None:
        """Let the camera have been at this pose at a stamp of the past."""
        past, apart_s = self._past(at_ns)
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ past.T_world_left.inverse()
        unseen = covariance_of_point(self._unseen(apart_s), pose.T_ds_rb.rotation, np.zeros(3))
        covariance = self._of_left(pose.covariance + unseen, self.T_ds_world.rotation.T, past.T_world_left)
        self.covariance.rebase(past.mark, covariance)

    def _past(self, stamp_ns: int) -> tuple[TrackedPose, float]:
        """Return the pose of a stamp that is not after the last one, and how far from it, seconds, it is known."""
        stamps = [pose.stamp_ns for pose in self._history]
        after = bisect_left(stamps, stamp_ns)
        later = self._history[after]
        if later.stamp_ns == stamp_ns:
            return later, 0.0
        if after == 0:
            return later, (later.stamp_ns - stamp_ns) / NS_PER_S
        earlier = self._history[after - 1]
        if later.follows:
            share = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
            between = interpolated(earlier.T_world_left, later.T_world_left, share)
            return TrackedPose(stamp_ns, between, later.mark, follows=True), 0.0
        nearest = min(earlier, later, key=lambda pose: abs(pose.stamp_ns - stamp_ns))
        return nearest, abs(nearest.stamp_ns - stamp_ns) / NS_PER_S

    def _of_left(self, covariance: FloatArray, rotation: FloatArray, at: Transform | None = None) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB; rotation takes its axes there."""
        R_world_left = (at or self.T_world_left).rotation
        lever = R_world_left @ self._T_rb_left.rotation.T @ self._T_rb_left.translation
        return covariance_of_point(covariance, rotation, lever)
