"""Offset of right image positions that a rotation error of the right camera causes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import StereoCamera


@dataclass(frozen=True, slots=True)
class RightOffset:
    """Extrinsic rotation error of the right camera, as the pixels by which it moves right image positions.

    Attributes:
        u: Offset along the row at the image centre (yaw), pixels, positive to the right.
        v: Offset along the column at the image centre (pitch), pixels, positive downwards.
        roll: Rotation about the optical axis, pixels at a distance of the focal length.
    """

    u: float = 0.0
    v: float = 0.0
    roll: float = 0.0

    def at(self, uv: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return the offsets `(N, 2)`, pixels: the flow field of a small rotation.

        Args:
            uv: `(N, 2)` pixels of the right image.
            camera: Camera of the rig.
        """
        x, y = camera.normalised(uv).T
        along_u = self.u * (1.0 + x * x) + self.v * x * y - self.roll * y
        along_v = self.v * (1.0 + y * y) + self.u * x * y + self.roll * x
        return np.column_stack((along_u, along_v))
