"""Structs of cameras and poses that kernels take; numba compiles and caches them as it does numbers and arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform


class StereoCamera(NamedTuple):
    """Rectified stereo camera; both images have the same camera matrix.

    Attributes:
        fx: Focal length along rows, pixels.
        fy: Focal length along columns, pixels.
        cx: Principal point, pixels.
        cy: Principal point, pixels.
        baseline_m: Distance between the optical centres, metres.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float

    def normalised(self, uv: FloatArray) -> FloatArray:
        """Return the normalised image coordinates `(N, 2)` X / Z, Y / Z of pixels `(N, 2)`."""
        return np.asarray((uv - [self.cx, self.cy]) / [self.fx, self.fy])


class Pose(NamedTuple):
    """Pose of a camera in the world.

    Attributes:
        rotation: `(3, 3)` camera to world.
        position: `(3,)` camera in the world, metres.
    """

    rotation: FloatArray
    position: FloatArray

    @classmethod
    def of(cls, T_world_camera: Transform) -> Pose:
        """Return the pose of a transform."""
        return cls(T_world_camera.rotation, T_world_camera.translation)


class Poses(NamedTuple):
    """Poses of N cameras in the world.

    Attributes:
        rotations: `(N, 3, 3)` cameras to world.
        positions: `(N, 3)` cameras in the world, metres.
    """

    rotations: FloatArray
    positions: FloatArray
