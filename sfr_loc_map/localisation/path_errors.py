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


class Origin(NamedTuple):
    """The pose from which the covariance counts: start of the run or of the window, or a pose from outside."""

    start: LocatedCovariance  #: Covariance of that pose.
    #: That pose in the window, if the drift counts from a pose within the window; None: from the start of the window.
    in_window: LocatedCovariance | None = None
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to that pose.


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """What the covariance of the present pose is composed of, accumulated since its origin.

    Two parts come from motions that no image showed, `suspected` and `unseen`:

    | event | `suspected` | `unseen` |
    |---|---|---|
    | accepted pair | of its findings: the next pose no longer contains it | ends |
    | kept pair | stays: the pose is the same | the motion since the accepted pose |
    | adjustment of a keyframe | stays: its images may be partly older | is zero already |
    | new window | ends in the start of the window | ends in the start of the window |
    """

    origin: Origin  #: The pose from which the covariance counts.
    #: What earlier windows, and the motions between the windows, added since the map was placed, at the start of the
    #: window. A pose from outside in the past does not reset it.
    before_window: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)
    in_window: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the present pose in its window.
    #: Covariance of the motion up to the last accepted pose, if its images may partly be older.
    suspected: FloatArray = field(default_factory=lambda: ZERO)
    unseen: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the motion since that pose.
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))  #: Path integrals up to the present pose.
    #: Sum of ambiguous motions and of the bending by the lens since the origin.
    directed: DirectedError = DirectedError(0.0, 0.0)
    #: Covariance of that sum, and where it arose.
    directed_covariance: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)

    @property
    def bias_since_origin(self) -> DisparityBias:
        """Path integrals from the origin to the present pose."""
        before = self.origin.bias
        return DisparityBias(self.bias.total - before.total, self.bias.corrected - before.corrected)

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
            origin=Origin(start, bias=self.bias),
            bias=self.bias,
            directed_covariance=LocatedCovariance(start.position, ZERO),
        )

    def rebased(self, origin: Origin, *, position: FloatArray, directed: DirectedError) -> PathErrors:
        """Return the errors since an external pose with an earlier stamp.

        Args:
            origin: That pose. If it is of an earlier window, its start is that of the present window.
            position: Position of the left camera at that pose.
            directed: Sum of the directed errors up to that pose.
        """
        since = self.directed.since(directed)
        return replace(
            self, origin=origin, directed=since, directed_covariance=LocatedCovariance(position, since.covariance)
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
        start = LocatedCovariance(position, drift + self.unimaged + first_image)
        return replace(
            self,
            origin=self.origin._replace(start=start, in_window=None),
            before_window=LocatedCovariance(position, accumulated + self.unimaged + first_image),
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
