"""How the rover stands: six wheels on the ground hold the body [3.2.1]."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.frames import GROUND_HEIGHT_RB_M
from sfr_loc_map.simulation.terrain import FloatArray, Terrain

WHEELS_RB_M = np.array([(x, y) for x in (0.62, 0.0, -0.62) for y in (0.52, -0.52)])
"""Places of the six wheels in RB, metres (a rover of the size of a fetch rover; the document gives none)."""
WHEEL_RADIUS_M = 0.18
HALF_WIDTH_M = 0.70
_ROLLING = np.linspace(-0.75, 0.75, 7) * WHEEL_RADIUS_M
_SPACING_M = 0.02


def stand(terrain: Terrain, x: FloatArray, y: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height and attitude of RB where the rover stands.

    Each wheel touches where its rim first meets the ground; a rocker-bogie suspension averages the wheels, so the
    body is parallel to the least-squares plane through the six wheel centres.

    Args:
        terrain: The ground.
        x: `(N,)` metres, DS, place of the RB origin.
        y: `(N,)` metres, DS.
        heading: `(N,)` radians, from east to north.

    Returns:
        Origins of RB `(N, 3)`, metres, DS, and rotations `(N, 3, 3)` that take components in RB to DS.
    """
    c, s = np.cos(heading), np.sin(heading)
    wx = x[:, None] + c[:, None] * WHEELS_RB_M[:, 0] - s[:, None] * WHEELS_RB_M[:, 1]
    wy = y[:, None] + s[:, None] * WHEELS_RB_M[:, 0] + c[:, None] * WHEELS_RB_M[:, 1]
    px = (wx[..., None] + c[:, None, None] * _ROLLING).ravel()
    py = (wy[..., None] + s[:, None, None] * _ROLLING).ravel()
    ground = terrain.height(px, py, np.full(len(px), _SPACING_M)).reshape(*wx.shape, len(_ROLLING))
    centres = (ground + np.sqrt(WHEEL_RADIUS_M**2 - _ROLLING**2)).max(axis=2)
    design = np.column_stack((np.ones(len(WHEELS_RB_M)), WHEELS_RB_M))
    plane = centres @ np.linalg.pinv(design).T
    forward = np.stack((c, s, plane[:, 1]), axis=-1)
    left = np.stack((-s, c, plane[:, 2]), axis=-1)
    up = np.cross(forward, left)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    rotation = np.stack((forward, np.cross(up, forward), up), axis=-1)
    # The plane of the wheels' centres passes below the origin along z of RB, not along the plumb line.
    foot = np.stack((x, y, plane[:, 0]), axis=-1)
    height = (-GROUND_HEIGHT_RB_M - WHEEL_RADIUS_M) / up[:, 2]
    return foot + np.stack((np.zeros_like(x), np.zeros_like(x), height), axis=-1), rotation
