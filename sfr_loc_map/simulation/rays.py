"""Rays: through the places of a picture, towards the sun, and from where."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.simulation.noise import hash2, mix, unit


def pixel_rays(rig: StereoRig, u: FloatArray, v: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return unit rays `(N, 3)` in DS of pixel places `(N,)`; `rotation` takes the optical frame to DS."""
    out = np.empty((len(u), 3))
    _pixel_rays(u, v, rig.fx, rig.fy, rig.cx, rig.cy, np.ascontiguousarray(rotation), out)
    return out


@jit
def _pixel_rays(
    u: FloatArray, v: FloatArray, fx: float, fy: float, cx: float, cy: float, rotation: FloatArray, out: FloatArray
) -> None:
    for n in range(len(u)):
        x, y = (u[n] - cx) / fx, (v[n] - cy) / fy
        length = 1.0 / np.sqrt(x * x + y * y + 1.0)
        for k in range(3):
            out[n, k] = (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]) * length


def sample_offsets(samples: int) -> FloatArray:
    """Return where in a pixel and when in the exposure each sample lies.

    Returns:
        `(S, 3)`: column and row offset and time, all in [-0.5, 0.5), with mean zero: the additive sequence of the
        plastic number in two dimensions, so that a few samples cover the pixel evenly.
    """
    k = np.arange(samples)
    root = 1.32471795724474602596
    place = np.mod(0.5 + np.outer(k + 1, (1 / root, 1 / root**2)), 1.0)
    table = np.column_stack((place, (k + 0.5) / samples))
    return np.asarray(table - table.mean(axis=0))


def sun_rays(sun: FloatArray, radius_rad: float, count: int, key: np.uint32) -> NDArray[np.float32]:
    """Return directions `(N, 3)` towards points of the sun's disc, evenly spread, the same for the same key."""
    side = np.cross(sun, (0.0, 0.0, 1.0) if abs(sun[2]) < 0.99 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    out = np.empty((count, 3), np.float32)
    _disc(sun, side, np.cross(sun, side), radius_rad, key, out)
    return out


@jit
def _disc(
    sun: FloatArray, side: FloatArray, up: FloatArray, radius: float, key: np.uint32, out: NDArray[np.float32]
) -> None:
    for n in range(len(out)):
        h = hash2(n, 17, key)
        r, angle = radius * np.sqrt(unit(h)), 6.283185307179586 * unit(mix(h))
        a, b = r * np.cos(angle), r * np.sin(angle)
        for k in range(3):
            out[n, k] = sun[k] + a * side[k] + b * up[k]


def camera_pose(T_ds_sb: Transform, rig: StereoRig, right: bool) -> Transform:
    """Return `T_ds_cam` of the left or right optical frame, from the pose of the stereo bench."""
    T_ds_left = T_ds_sb @ rig.T_sb_left
    if not right:
        return T_ds_left
    return T_ds_left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
