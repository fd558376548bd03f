"""Where the left camera is, since when that is known, and where poses from outside belong."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.covariance_model import CovarianceMark, CovarianceModel, covariance_of_point
from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.localisation.unseen_motion import Speed, is_plausible, unseen_covariance

HISTORY_PAIRS: Final = 1000
"""Pairs back to which a pose from outside can be bound."""
MAX_AHEAD_NS: Final = 10 * NS_PER_S
"""A pose with a stamp farther ahead of the pairs is of another clock: it is taken for the next pair."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPose:
    """A pose of the past.

    Attributes:
        stamp_ns: Its stamp.
        T_world_left: Left camera in the world.
        mark: What its covariance was made of.
        follows: Whether the pair before it was tracked too.
    """

    stamp_ns: int
    T_world_left: Transform
    mark: CovarianceMark
    follows: bool


class PoseTrack:
    """The poses so far, and the world's place in DS.

    Attributes:
        T_ds_world: Takes points in the world to DS.
        T_world_left: Left camera at the last stamp at which it is known.
        known_ns: That stamp; None before the first pair.
        covariance: What is known of the uncertainty.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig, start: StartPose) -> None:
        """Start at a pose.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
        """
        self._T_rb_left, self._T_left_rb, self._bounds = rig.T_rb_left, rig.T_rb_left.inverse(), config.motion
        self.covariance = CovarianceModel(rig, config)
        self._history: deque[TrackedPose] = deque(maxlen=HISTORY_PAIRS)
        self._pending: StartPose | None = None
        self._before_first_pair = True
        self.known_ns: int | None = None
        self.T_world_left = Transform.identity()
        self._place(start, start.stamp_ns)

    @property
    def T_ds_left(self) -> Transform:
        """Left camera in DS."""
        return self.T_ds_world @ self.T_world_left

    @property
    def T_ds_rb(self) -> Transform:
        """RB in DS."""
        return self.T_ds_left @ self._T_left_rb

    def set_pose(self, pose: StartPose) -> None:
        """Take a pose from outside, which gets its place with the pair at or after its stamp."""
        if self._before_first_pair:
            self._place(pose, pose.stamp_ns)
        else:
            self._pending = pose

    def covariance_of_rb(self, depth_m: float, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(6, 6)` of RB in DS.

        Args:
            depth_m: Median depth of the landmarks.
            calibration: What is known of the right camera.
        """
        of_left = self.covariance.of_left(self.T_world_left.translation, depth_m, calibration)
        T_ds_left = self.T_ds_left
        lever = (T_ds_left @ self._T_left_rb).translation - T_ds_left.translation
        return covariance_of_point(of_left, self.T_ds_world.rotation, lever)

    def plausible(self, stamp_ns: int, T_world_left: Transform) -> bool:
        """Tell whether the camera can have moved like that since its pose was known last."""
        return is_plausible(self.T_world_left.inverse() @ T_world_left, self.unseen_s(stamp_ns), self._bounds)

    def arrive(self, stamp_ns: int) -> None:
        """Note a pair: a start pose without a stamp holds at the first one, whatever that shows.

        A start pose of a later stamp is taken for one of the first pair until its own, as badly known as that makes it.
        """
        if self._before_first_pair and stamp_ns < (self.known_ns or 0) <= stamp_ns + MAX_AHEAD_NS:
            self._pending = self._given
        self._before_first_pair = False
        if self.known_ns is None:
            self.known_ns = stamp_ns

    def unseen_s(self, stamp_ns: int) -> float:
        """Return how long before a stamp, seconds, the pose was known last."""
        return 0.0 if self.known_ns is None else abs(stamp_ns - self.known_ns) / NS_PER_S

    def unseen_of_rb(self, stamp_ns: int) -> FloatArray:
        """Return the covariance `(6, 6)` of the motion since the pose was known last, in RB there."""
        return unseen_covariance(self.unseen_s(stamp_ns), self._speed, self._bounds)

    def unseen(self, stamp_ns: int) -> FloatArray:
        """Return the same of the left camera, in the world."""
        covariance = self.unseen_of_rb(stamp_ns)
        return self._of_left(covariance, self.T_world_left.rotation @ self._T_rb_left.rotation.T)

    def allow_unseen(self, stamp_ns: int) -> FloatArray:
        """Allow for the motion up to a stamp, which no image may show, until the next pose; return it of RB."""
        self.covariance.allow_unseen(self.unseen(stamp_ns))
        return self.unseen_of_rb(stamp_ns)

    def moved(self, stamp_ns: int, T_world_left: Transform, motion: Transform | None) -> None:
        """Take a pose that was tracked.

        Args:
            stamp_ns: Its stamp.
            T_world_left: Left camera.
            motion: Of the left camera since the pair before; None if that was not tracked.
        """
        if motion is not None:
            self._speed = Speed.of(motion, self.unseen_s(stamp_ns))
        self.T_world_left, self.known_ns = T_world_left, stamp_ns
        mark = self.covariance.mark(T_world_left)
        self._history.append(TrackedPose(stamp_ns, T_world_left, mark, follows=motion is not None))

    def bind(self, stamp_ns: int) -> bool:
        """Give a pose from outside its place, after the pair of a stamp.

        Returns:
            Whether the pose is of a stamp since which nothing was seen: what was seen before is to be forgotten.
        """
        pose = self._pending
        if pose is None:
            return False
        given = pose.stamp_ns
        at_ns = stamp_ns if given is None or given > stamp_ns + MAX_AHEAD_NS else given
        if at_ns > stamp_ns:
            return False
        self._pending = None
        if not self._history or at_ns > self._history[-1].stamp_ns:
            self._place(pose, at_ns)
            return True
        self._rebase(pose, at_ns)
        return False

    def _place(self, pose: StartPose, stamp_ns: int | None) -> None:
        """Let the last pose of the camera be this one, known at a stamp."""
        self._given = pose
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ self.T_world_left.inverse()
        self.known_ns, self._speed = stamp_ns, Speed()
        self._history.clear()
        covariance = self._of_left(pose.covariance, self.T_ds_world.rotation.T)
        self.covariance.restart(self.T_world_left.translation, covariance)

    def _rebase(self, pose: StartPose, at_ns: int) -> None:
        """Let the camera have been at this pose at a stamp of the past."""
        past, apart_s = self._past(at_ns)
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ past.T_world_left.inverse()
        R_ds_rb = pose.T_ds_rb.rotation
        unseen = unseen_covariance(apart_s, self._speed, self._bounds)
        covariance = pose.covariance + covariance_of_point(unseen, R_ds_rb, np.zeros(3))
        self.covariance.rebase(past.mark, self._of_left(covariance, self.T_ds_world.rotation.T, past.T_world_left))

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
