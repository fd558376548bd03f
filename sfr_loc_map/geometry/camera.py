"""Cameras and poses as named tuples, which numba kernels accept as arguments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform


class StereoCamera(NamedTuple):
    """Rectified stereo camera; both cameras have the same camera matrix, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float

    def normalised(self, uv: FloatArray) -> FloatArray:
        """Return the normalised image coordinates X / Z, Y / Z `(..., 2)` of pixels u, v `(..., 2)`."""
        return np.asarray((uv - [self.cx, self.cy]) / [self.fx, self.fy])


class Pose(NamedTuple):
    """A transform T_a_b for kernels: takes points in b to a."""

    rotation: FloatArray  #: `(3, 3)`, takes directions in b to a.
    position: FloatArray  #: `(3,)`, origin of b in a, metres.

    @classmethod
    def of(cls, T_a_b: Transform) -> Pose:
        """Return the pose of a transform."""
        return cls(T_a_b.rotation, T_a_b.translation)


class Poses(NamedTuple):
    """Poses of N cameras in the world."""

    rotations: FloatArray  #: `(N, 3, 3)` rotations from the cameras to the world.
    positions: FloatArray  #: `(N, 3)` positions of the cameras in the world, metres.

    def take(self, rows: NDArray[np.integer]) -> Poses:
        """Return the poses at the row indices `(M,)`.

        For short rows, `ndarray.take` is up to ten times faster than indexing.
        """
        return Poses(self.rotations.take(rows, axis=0), self.positions.take(rows, axis=0))
