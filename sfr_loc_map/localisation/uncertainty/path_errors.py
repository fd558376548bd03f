"""Components of the covariance of the present pose, accumulated along the path (formula `pose` of `covariance`).

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is that of position and rotation about fixed axes, for the
left camera in the world.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize
from sfr_loc_map.localisation.symmetric_matrices import positive_part

ZERO = np.zeros((6, 6))  #: No uncertainty; read only.


class LocatedCovariance(NamedTuple):
    """Covariance `(6, 6)` of a pose, and the position `(3,)`, m, where the error arose."""

    position: FloatArray
    covariance: FloatArray

    def at(self, position: FloatArray) -> FloatArray:
        """Return the covariance propagated to another position, which a rotation error displaces."""
        return propagated_covariance(self.covariance, position - self.position)


class DisparityBias(NamedTuple):
    """Position errors `(3,)` that disparity errors cause, integrated along the path."""

    total: FloatArray  #: Sum over the steps of the position error per pixel of a constant disparity error, m/px.
    corrected: FloatArray  #: Sum over the steps of this error times the yaw correction at the step, m.


class DirectedError(MotionSize):
    """Standard deviations of errors that have the same direction in all steps and therefore add up."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the errors; the angle is at most that of an unknown attitude."""
        return MotionSize(self.metres, min(self.radians, MAX_ANGLE_RAD)).covariance

    def plus(self, other: DirectedError) -> DirectedError:
        """Return the sum with a further error."""
        return DirectedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: DirectedError) -> DirectedError:
        """Return what was added since an earlier sum."""
        return DirectedError(self.metres - earlier.metres, self.radians - earlier.radians)


class Origin(NamedTuple):
    """The pose to which the covariance is relative: start of the run or of the window, or an external pose."""

    start: LocatedCovariance  #: Covariance of the origin.
    #: `of_keyframe` of the past pose to which an external pose of this window applies; None if the drift counts from
    #: the start of the window.
    past_of_keyframe: LocatedCovariance | None = None
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to the origin.
    directed: DirectedError = DirectedError(0.0, 0.0)  #: Sum of the directed errors up to the origin.
    followed_px: float = 0.0  #: Sum of the drift corrections up to the origin, px.


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """Components of the covariance of the present pose, accumulated since its origin.

    The table shows how each event changes each component: `=` sets the component, `+` adds to the component, `0` sets
    the component to zero. The names of the values are those of `covariance.pose_covariance`.

    | component | `with_pose` | `kept` | `adjusted` | `restarted` | `placed` | `rebased` |
    |---|---|---|---|---|---|---|
    | `origin.start` | | | | + inflated drift, both unobserved, first image | = external pose | = external pose |
    | `origin.past_of_keyframe` | | | | none | none | = past pose of this window, or none |
    | `before_window` | | | | + inflated `in_window`, both unobserved, first image | 0 | |
    | `of_keyframe` | = keyframe | | = keyframe | = keyframe | 0 | |
    | `given_keyframes` | = given keyframes | | 0 | 0 | 0 | 0 if the past pose is the present pose |
    | `unobserved_to_pose` | = unobserved if the findings require it, or 0 | | | 0 | 0 | like `given_keyframes` |
    | `unobserved_since_pose` | 0 | = unobserved | | 0 | 0 | |
    | `bias` | + step | | | | | |
    | `followed_px` | + drift correction | | | | | |
    | `directed` | + step (`with_directed`) | | | | | |
    | `directed_covariance` | + step (`with_directed`) | | | | 0 | = sum since the external pose |

    `with_pose` belongs to an accepted pair, `kept` to a kept pair, `adjusted` to a keyframe that was adjusted in the
    background, and `restarted` to a pair that begins a window. A lost pair changes no component. `placed` applies an
    external pose to the last pose, and `rebased` to a past pose, whose errors that no other pose shares
    (`PastPose.alone`) are then part of `origin.start`. An adjustment does not change `unobserved_to_pose`, because the
    images of the keyframe may still be partly stale.
    """

    origin: Origin  #: The pose to which the covariance is relative.
    #: Covariance that earlier windows, and the motions between windows, added since the map was placed, at the start of
    #: the window. External poses with past stamps do not reset it.
    before_window: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)
    #: Covariance of the newest keyframe in its window.
    of_keyframe: FloatArray = field(default_factory=lambda: ZERO)
    #: Covariance of the present pose given the keyframes, which no other pose shares.
    given_keyframes: FloatArray = field(default_factory=lambda: ZERO)
    #: Covariance of the motion to the last accepted pose, which counts as unobserved if its images may be partly stale.
    unobserved_to_pose: FloatArray = field(default_factory=lambda: ZERO)
    #: Covariance of the motion since that pose while it is kept.
    unobserved_since_pose: FloatArray = field(default_factory=lambda: ZERO)
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to the present pose.
    #: Sum of the absolute drift corrections of the right camera up to the present pose, px.
    followed_px: float = 0.0
    #: Sum of the directed errors (ambiguous motions, bending by the lens) up to the present pose. The sum is never
    #: reset, because the past poses in the history contain earlier values of the same sum.
    directed: DirectedError = DirectedError(0.0, 0.0)
    #: Covariance of the sum since the origin, at the position where the last error was added.
    directed_covariance: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)

    @property
    def bias_since_origin(self) -> DisparityBias:
        """Path integrals from the origin to the present pose."""
        before = self.origin.bias
        return DisparityBias(self.bias.total - before.total, self.bias.corrected - before.corrected)

    @property
    def followed_since_origin_px(self) -> float:
        """Sum of the absolute drift corrections from the origin to the present pose, px."""
        return self.followed_px - self.origin.followed_px

    @property
    def in_window(self) -> FloatArray:
        """Covariance `(6, 6)` of the present pose in its window."""
        return self.given_keyframes + self.of_keyframe

    @property
    def unobserved(self) -> FloatArray:
        """Covariance `(6, 6)` of the unobserved motions to and since the last accepted pose."""
        return self.unobserved_to_pose + self.unobserved_since_pose

    def with_pose(
        self,
        *,
        of_keyframe: FloatArray,
        given_keyframes: FloatArray,
        unobserved_to_pose: FloatArray,
        bias: DisparityBias,
        followed_px: float,
    ) -> PathErrors:
        """Return the errors of a new pose that was estimated from images."""
        return replace(
            self,
            of_keyframe=of_keyframe,
            given_keyframes=given_keyframes,
            unobserved_to_pose=unobserved_to_pose,
            unobserved_since_pose=ZERO,
            bias=bias,
            followed_px=followed_px,
        )

    def placed(self, start: LocatedCovariance) -> PathErrors:
        """Return the errors after an external pose was applied to the last pose. Only the sums continue."""
        return PathErrors(
            origin=Origin(start, bias=self.bias, directed=self.directed, followed_px=self.followed_px),
            bias=self.bias,
            followed_px=self.followed_px,
            directed=self.directed,
            directed_covariance=LocatedCovariance(start.position, ZERO),
        )

    def rebased(self, origin: Origin, position: FloatArray, *, is_present: bool) -> PathErrors:
        """Return the errors since an external pose with a past stamp.

        Args:
            origin: The external pose; the start of the present window if that pose belongs to an earlier window.
            position: Position of the left camera at the external pose.
            is_present: Whether the past pose is the present pose, whose own errors are then those of the origin.
        """
        since = self.directed.since(origin.directed)
        errors = replace(self, origin=origin, directed_covariance=LocatedCovariance(position, since.covariance))
        if is_present:
            return replace(errors, given_keyframes=ZERO, unobserved_to_pose=ZERO)
        return errors

    def kept(self, unobserved_since_pose: FloatArray) -> PathErrors:
        """Return the errors of a pose that is kept during an unobserved motion."""
        return replace(self, unobserved_since_pose=unobserved_since_pose)

    def adjusted(self, of_keyframe: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, with its new covariance in the window."""
        return replace(self, of_keyframe=of_keyframe, given_keyframes=ZERO)

    def since_origin(self, position: FloatArray, inflation: float) -> FloatArray:
        """Return the sum of the terms `start` and `adjustment_inflation drift` of the pose covariance at a position."""
        drift = self.in_window
        origin = self.origin
        if origin.past_of_keyframe is not None:
            drift = positive_part(self.of_keyframe - origin.past_of_keyframe.at(position)) + self.given_keyframes
        return np.asarray(drift * inflation + origin.start.at(position))

    def since_map_was_placed(self, position: FloatArray, inflation: float) -> FloatArray:
        """Return the covariance that windows, and the motions between windows, added since the map was placed.

        External poses with past stamps do not reset this covariance, and it does not contain the errors that no other
        pose shares. The difference of two such covariances is therefore the uncertainty that arose between the poses.
        """
        drift = self.of_keyframe * inflation
        return np.asarray(self.before_window.at(position) + drift)

    def restarted(
        self, position: FloatArray, *, first_image: FloatArray, of_keyframe: FloatArray, inflation: float
    ) -> PathErrors:
        """Return the errors at the start of a new window.

        Args:
            position: Position of the left camera.
            first_image: `(6, 6)` that the first image adds.
            of_keyframe: `(6, 6)` of the first keyframe in the new window.
            inflation: `ErrorSources.adjustment_inflation`.
        """
        start = self.since_origin(position, inflation) + self.unobserved + first_image
        alone = self.given_keyframes * inflation + self.unobserved + first_image
        before_window = self.since_map_was_placed(position, inflation) + alone
        return replace(
            self,
            origin=self.origin._replace(start=LocatedCovariance(position, start), past_of_keyframe=None),
            before_window=LocatedCovariance(position, before_window),
            of_keyframe=of_keyframe,
            given_keyframes=ZERO,
            unobserved_to_pose=ZERO,
            unobserved_since_pose=ZERO,
        )

    def with_directed(self, error: DirectedError, position: FloatArray) -> PathErrors:
        """Return the errors with a further directed error, which arose at a position."""
        total = self.directed.plus(error)
        before = self.origin.directed
        growth = total.since(before).covariance - self.directed.since(before).covariance
        located = LocatedCovariance(position, self.directed_covariance.at(position) + growth)
        return replace(self, directed=total, directed_covariance=located)
