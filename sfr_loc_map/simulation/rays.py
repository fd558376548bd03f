"""Rays through the pixels of an image and towards the sun, and what they hit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.simulation.noise import hash2, mix, unit

SKY, GROUND = -2, -1
"""Object that a ray hits, if it is not the rock of that number."""


class Hits(NamedTuple):
    """Hits of N rays.

    Attributes:
        points: `(N, 3)` float64, metres, DS; undefined for the sky.
        normals: `(N, 3)` float64, unit, smooth.
        objects: `(N,)` int32, -2 for the sky, -1 for the ground, else the number of a rock.
        ranges: `(N,)` float64, metres.
    """

    points: FloatArray
    normals: FloatArray
    objects: NDArray[np.int32]
    ranges: FloatArray


class Camera(NamedTuple):
    """A pinhole camera as kernels take it.

    Attributes:
        rotation: `(3, 3)` optical frame to DS.
        centre: `(3,)` metres, DS.
        fx: Focal length along rows, pixels.
        fy: Focal length along columns, pixels.
        cx: Principal point, pixels.
        cy: Principal point, pixels.
    """

    rotation: FloatArray
    centre: FloatArray
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of(cls, rig: StereoRig, T_ds_cam: Transform) -> Camera:
        """Return a camera of a rig at a pose of its optical frame."""
        rotation, centre = np.ascontiguousarray(T_ds_cam.rotation), np.ascontiguousarray(T_ds_cam.translation)
        return cls(rotation, centre, float(rig.fx), float(rig.fy), float(rig.cx), float(rig.cy))


@jit
def pixel_rays(camera: Camera, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return unit rays `(N, 3)` in DS through pixels `(N,)`."""
    out = np.empty((len(u), 3))
    rotation = camera.rotation
    for n in range(len(u)):
        x, y = (u[n] - camera.cx) / camera.fx, (v[n] - camera.cy) / camera.fy
        length = 1.0 / np.sqrt(x * x + y * y + 1.0)
        for k in range(3):
            out[n, k] = (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]) * length
    return out


def sample_offsets(samples: int) -> FloatArray:
    """Return the offsets of samples within a pixel and within the exposure.

    Returns:
        `(S, 3)`: column and row offset and time, all in [-0.5, 0.5), with mean zero: the additive sequence of the
        plastic number in two dimensions, so that a few samples cover the pixel evenly.
    """
    k = np.arange(samples)
    root = 1.32471795724474602596
    offset = np.mod(0.5 + np.outer(k + 1, (1 / root, 1 / root**2)), 1.0)
    table = np.column_stack((offset, (k + 0.5) / samples))
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
    """Return `T_ds_cam` of the left or right optical frame, from the pose of the stereo rig."""
    T_ds_left = T_ds_sb @ rig.T_sb_left
    if not right:
        return T_ds_left
    return T_ds_left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
