"""Where the document fixes parts of the rover (RB: x forward, y left, z up), and its pose on the ground [3.2]."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.mesh import Mesh
from sfr_loc_map.simulation.terrain import Terrain

GROUND_HEIGHT_RB_M = -0.540
"""Height of the ground plane in RB when deployed on flat ground [3.2.1]."""
MAST_XY_RB_M = (0.451, 0.317)
"""Base of the mast (DMA) and the pan axis in RB [3.2.2, 3.2.6]."""
TILT_AXIS_Z_RB_M = 0.594
"""Height of the tilt axis in RB [3.2.6]."""
TILT_AXIS_X_RB_M = 0.451
"""Place of the tilt axis along RB x at pan 0 [3.2.6]."""
WHEELS_RB_M = np.array([(x, y) for x in (0.62, 0.0, -0.62) for y in (0.52, -0.52)])
"""Positions of the six wheels in RB, metres (size of a fetch rover; the document gives none)."""
WHEEL_RADIUS_M = 0.18
HALF_WIDTH_M = 0.70
_ROLLING = np.linspace(-0.75, 0.75, 7) * WHEEL_RADIUS_M
_SPACING_M = 0.02


def mast_head_in_rb(pan_rad: float, tilt_rad: float) -> Transform:
    """Return `T_rb_head`: the mast head, origin where the tilt axis meets the pan axis' x-z plane [3.2.6].

    Args:
        pan_rad: About z of RB, positive to the left; carries the tilt axis.
        tilt_rad: About the tilt axis (y of RB at pan 0); positive turns the view down, as a right-handed turn about
            +y does.
    """
    pan: FloatArray = matrix_from_rotvec([0.0, 0.0, pan_rad])
    tilt: FloatArray = matrix_from_rotvec([0.0, tilt_rad, 0.0])
    return Transform(pan @ tilt, np.array([TILT_AXIS_X_RB_M, MAST_XY_RB_M[1], TILT_AXIS_Z_RB_M]))


def settle_on_terrain(
    terrain: Terrain, x: FloatArray, y: FloatArray, heading: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return position and attitude of RB with all wheels on the ground.

    Each wheel touches where its rim first meets the ground; a rocker-bogie suspension averages the wheels, so the
    body is parallel to the least-squares plane through the six wheel centres.

    Args:
        terrain: The ground.
        x: `(N,)` metres, DS, of the RB origin.
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


def rover_mesh() -> Mesh:
    """Return a rover of boxes in RB that casts the shadow: deck, wheels, mast and mast head."""
    mast_x, mast_y = MAST_XY_RB_M
    boxes = [((-0.65, -0.45, -0.20), (0.55, 0.45, 0.10)), ((-0.75, -0.60, 0.10), (0.45, 0.60, 0.14))]
    boxes.append(((mast_x - 0.04, mast_y - 0.04, 0.10), (mast_x + 0.04, mast_y + 0.04, TILT_AXIS_Z_RB_M)))
    boxes.append(((mast_x - 0.08, mast_y - 0.18, TILT_AXIS_Z_RB_M), (mast_x + 0.08, mast_y + 0.18, 0.75)))
    low, high = GROUND_HEIGHT_RB_M, GROUND_HEIGHT_RB_M + 2 * WHEEL_RADIUS_M
    for x, y in WHEELS_RB_M:
        boxes.append(((x - 0.15, y - 0.07, low + 0.01), (x + 0.15, y + 0.07, high)))
    return Mesh.join([_box(np.array(a), np.array(b)) for a, b in boxes])


def _box(low: FloatArray, high: FloatArray) -> Mesh:
    corners = np.array([[(low, high)[(k >> a) & 1][a] for a in range(3)] for k in range(8)], np.float32)
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh(corners, np.zeros_like(corners), triangles, np.zeros(len(triangles), np.int32))
