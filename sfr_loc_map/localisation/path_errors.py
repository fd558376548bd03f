"""Components of the covariance of the present pose, accumulated along the path (formula P of `covariance`).

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is that of position and rotation about fixed axes, for the
left camera in the world.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.localisation.motion_size import MotionSize

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

    total: FloatArray  #: Position error per pixel of a constant disparity error, m/px.
    corrected: FloatArray  #: Position change that the yaw correction at each step causes, m.


class DirectedError(MotionSize):
    """Standard deviations of errors that have the same direction in all steps and therefore add up."""

    def plus(self, other: DirectedError) -> DirectedError:
        """Return the sum with a further error."""
        return DirectedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: DirectedError) -> DirectedError:
        """Return what was added since an earlier sum."""
        return DirectedError(self.metres - earlier.metres, self.radians - earlier.radians)


class Origin(NamedTuple):
    """The pose from which the covariance counts: start of the run or of the window, or an external pose."""

    start: LocatedCovariance  #: Covariance of the origin.
    #: Covariance of the origin within the window; None if the drift counts from the start of the window.
    in_window: LocatedCovariance | None = None
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to the origin.


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """Components of the covariance of the present pose, accumulated since its origin.

    Two components come from unobserved motions. Their pose is the last accepted pose:

    | event | `unobserved_to_pose` | `unobserved_since_pose` |
    |---|---|---|
    | accepted pair | becomes the inflation that the findings of the pair require | becomes zero |
    | kept pair | is unchanged, because the pose is the same | is the motion since the accepted pose |
    | adjustment of a keyframe | is unchanged, because its images may be partly stale | is already zero |
    | new window | is moved to the start of the window | is moved to the start of the window |
    """

    origin: Origin  #: The pose from which the covariance counts.
    #: Covariance that earlier windows, and the motions between windows, added since the map was placed, at the start of
    #: the window. External poses with past stamps do not reset it.
    before_window: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)
    #: W + C: covariance of the present pose in its window.
    in_window: FloatArray = field(default_factory=lambda: ZERO)
    #: M of the motion to the last accepted pose, which counts as unobserved if its images may be partly stale.
    unobserved_to_pose: FloatArray = field(default_factory=lambda: ZERO)
    #: M of the motion since that pose while it is kept.
    unobserved_since_pose: FloatArray = field(default_factory=lambda: ZERO)
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to the present pose.
    #: Sum of the directed errors since the origin (ambiguous motions, bending by the lens).
    directed: DirectedError = DirectedError(0.0, 0.0)
    #: Covariance of that sum, at the position where the last error was added.
    directed_covariance: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)

    @property
    def bias_since_origin(self) -> DisparityBias:
        """Path integrals from the origin to the present pose."""
        before = self.origin.bias
        return DisparityBias(self.bias.total - before.total, self.bias.corrected - before.corrected)

    @property
    def unobserved(self) -> FloatArray:
        """Covariance `(6, 6)` of the unobserved motions to and since the last accepted pose."""
        return self.unobserved_to_pose + self.unobserved_since_pose

    def with_pose(self, *, in_window: FloatArray, unobserved_to_pose: FloatArray, bias: DisparityBias) -> PathErrors:
        """Return the errors of a new pose that was estimated from images."""
        return replace(
            self, in_window=in_window, unobserved_to_pose=unobserved_to_pose, unobserved_since_pose=ZERO, bias=bias
        )

    def placed(self, start: LocatedCovariance) -> PathErrors:
        """Return the errors after an external pose was applied to the last pose. Only the path integrals continue."""
        return PathErrors(
            origin=Origin(start, bias=self.bias),
            bias=self.bias,
            directed_covariance=LocatedCovariance(start.position, ZERO),
        )

    def rebased(self, origin: Origin, *, position: FloatArray, directed: DirectedError) -> PathErrors:
        """Return the errors since an external pose with a past stamp.

        Args:
            origin: The external pose; the start of the present window if that pose belongs to an earlier window.
            position: Position of the left camera at the external pose.
            directed: Sum of the directed errors up to the external pose.
        """
        since = self.directed.since(directed)
        return replace(
            self, origin=origin, directed=since, directed_covariance=LocatedCovariance(position, since.covariance)
        )

    def kept(self, unobserved_since_pose: FloatArray) -> PathErrors:
        """Return the errors of a pose that is kept during an unobserved motion."""
        return replace(self, unobserved_since_pose=unobserved_since_pose)

    def adjusted(self, in_window: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, with its new covariance in the window."""
        return replace(self, in_window=in_window)

    def restarted(
        self,
        position: FloatArray,
        *,
        drift: FloatArray,
        accumulated: FloatArray,
        first_image: FloatArray,
        in_window: FloatArray,
    ) -> PathErrors:
        """Return the errors at the start of a new window.

        Args:
            position: Position of the left camera.
            drift: `(6, 6)` of the start pose and the drift up to here (`start_and_drift`).
            accumulated: `(6, 6)` of all windows up to here (`accumulated_covariance`).
            first_image: `(6, 6)` that the first image adds.
            in_window: `(6, 6)` of the first keyframe in the new window.
        """
        start = LocatedCovariance(position, drift + self.unobserved + first_image)
        return replace(
            self,
            origin=self.origin._replace(start=start, in_window=None),
            before_window=LocatedCovariance(position, accumulated + self.unobserved + first_image),
            in_window=in_window,
            unobserved_to_pose=ZERO,
            unobserved_since_pose=ZERO,
        )

    def with_directed(self, error: DirectedError, position: FloatArray) -> PathErrors:
        """Return the errors with a further directed error, which arose at a position."""
        total = self.directed.plus(error)
        growth = total.covariance - self.directed.covariance
        located = LocatedCovariance(position, self.directed_covariance.at(position) + growth)
        return replace(self, directed=total, directed_covariance=located)
