"""Offset of right image positions that a rotation error of the right camera causes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.jit import jit


class RightOffset(NamedTuple):
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
        return _offsets(self, np.ascontiguousarray(uv), camera)


@jit
def _offsets(offset: RightOffset, uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return `offset.at(uv, camera)`."""
    yaw, pitch, roll = offset.u, offset.v, offset.roll
    out = np.empty((len(uv), 2))
    for n in range(len(uv)):
        x, y = (uv[n, 0] - camera.cx) / camera.fx, (uv[n, 1] - camera.cy) / camera.fy
        out[n, 0] = yaw * (1.0 + x * x) + pitch * x * y - roll * y
        out[n, 1] = pitch * (1.0 + y * y) + yaw * x * y + roll * x
    return out
