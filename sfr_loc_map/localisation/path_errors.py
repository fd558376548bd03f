"""What the covariance of the present pose is composed of, accumulated along the path (formula P of `covariance`).

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is of position and rotation about fixed axes, of the left
camera in the world.
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
        """Return the covariance at another position: a rotation error swings the path."""
        return propagated_covariance(self.covariance, position - self.position)


class DisparityBias(NamedTuple):
    """Path integrals `(3,)` of position over a constant disparity error, m/px."""

    total: FloatArray  #: Of the whole path.
    corrected: FloatArray  #: Times the yaw, px, that was corrected at each step.


class DirectedError(MotionSize):
    """Standard deviations of errors of several steps that have the same direction: they add up."""

    def plus(self, other: DirectedError) -> DirectedError:
        """Return the sum with a further error."""
        return DirectedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: DirectedError) -> DirectedError:
        """Return what was added since an earlier sum."""
        return DirectedError(self.metres - earlier.metres, self.radians - earlier.radians)


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """What the covariance of the present pose is composed of, accumulated since the start pose.

    Two parts come from motions that no image showed, `suspected` and `unseen`:

    | event | `suspected` | `unseen` |
    |---|---|---|
    | accepted pair | of its findings: the next pose no longer contains it | ends |
    | kept pair | stays: the pose is the same | the motion since the accepted pose |
    | adjustment of a keyframe | stays: its images may be partly older | is zero already |
    | new window | ends in the start of the window | ends in the start of the window |
    """

    start: LocatedCovariance  #: Start of the run or of the window, or a pose from outside.
    #: What earlier windows, and the motions between the windows, added since the map was placed, at the start of the
    #: window. A pose from outside in the past does not reset it.
    before_window: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)
    #: Pose in the window from which the drift counts; None: from the start of the window.
    drift_origin: LocatedCovariance | None = None
    in_window: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the present pose in its window.
    #: Covariance of the motion up to the last accepted pose, if its images may partly be older.
    suspected: FloatArray = field(default_factory=lambda: ZERO)
    unseen: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the motion since that pose.
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))
    bias_at_start: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))
    directed: DirectedError = DirectedError(0.0, 0.0)  #: Sum of ambiguous motions and of the bending by the lens.
    #: Covariance of that sum, and where it arose.
    directed_covariance: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)

    @property
    def unimaged(self) -> FloatArray:
        """Covariance `(6, 6)` of the motions that no image showed."""
        return self.suspected + self.unseen

    def with_pose(self, *, in_window: FloatArray, suspected: FloatArray, bias: DisparityBias) -> PathErrors:
        """Return the errors of a new pose that images showed."""
        return replace(self, in_window=in_window, suspected=suspected, unseen=ZERO, bias=bias)

    def placed(self, start: LocatedCovariance) -> PathErrors:
        """Return the errors of a pose from outside at the last pose; only the path integrals continue."""
        return PathErrors(
            start=start,
            bias=self.bias,
            bias_at_start=self.bias,
            directed_covariance=LocatedCovariance(start.position, ZERO),
        )

    def rebased(
        self,
        *,
        start: LocatedCovariance,
        drift_origin: LocatedCovariance | None,
        position: FloatArray,
        bias: DisparityBias,
        directed: DirectedError,
    ) -> PathErrors:
        """Return the errors since an external pose with an earlier stamp.

        Args:
            start: Covariance of that pose, or of the start of the window if that pose is of an earlier one.
            drift_origin: That pose in its window; None if the drift counts from the start of the window.
            position: Position of the left camera at that pose.
            bias: Path integrals up to that pose.
            directed: Sum of the directed errors up to that pose.
        """
        since = self.directed.since(directed)
        return replace(
            self,
            start=start,
            drift_origin=drift_origin,
            bias_at_start=bias,
            directed=since,
            directed_covariance=LocatedCovariance(position, since.covariance),
        )

    def kept(self, unseen: FloatArray) -> PathErrors:
        """Return the errors of a pose that is kept while a motion is unseen."""
        return replace(self, unseen=unseen)

    def adjusted(self, in_window: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, whose covariance in the window is given."""
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
        start = drift + self.unimaged + first_image
        return replace(
            self,
            start=LocatedCovariance(position, start),
            before_window=LocatedCovariance(position, accumulated + self.unimaged + first_image),
            drift_origin=None,
            in_window=in_window,
            suspected=ZERO,
            unseen=ZERO,
        )

    def with_directed(self, error: DirectedError, position: FloatArray) -> PathErrors:
        """Return the errors with a further directed one, which arose at a position."""
        total = self.directed.plus(error)
        growth = total.covariance - self.directed.covariance
        located = LocatedCovariance(position, self.directed_covariance.at(position) + growth)
        return replace(self, directed=total, directed_covariance=located)
