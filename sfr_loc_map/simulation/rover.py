"""The rover: its pose on the terrain, the extrinsics of its cameras, and the boxes that cast its shadow.

RB has x forward, y left and z up [3.2].
"""

from __future__ import annotations

import math

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.extrinsics import MAST_XY_RB_M, TILT_AXIS_Z_RB_M
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.config import CamerasConfig
from sfr_loc_map.simulation.ground_mesh import Mesh
from sfr_loc_map.simulation.terrain import Terrain

GROUND_HEIGHT_RB_M = -0.540  #: Height of the ground plane in RB when deployed on flat ground [3.2.1].
WHEELS_RB_M = np.array([(x, y) for x in (0.62, 0.0, -0.62) for y in (0.52, -0.52)])
"""Positions of the six wheels in RB, metres; assumed, because the source document gives none."""
WHEEL_RADIUS_M = 0.18  #: Radius of the wheels, m; assumed.
WHEEL_CLEARANCE_M = 0.01  #: Height of the boxes of the wheels above the ground, m, so that they do not intersect it.
HALF_WIDTH_M = 0.70  #: Half width of the path that is kept clear of large rocks, m; the wheels are at 0.52 m.
_ROLLING = np.linspace(-0.75, 0.75, 7) * WHEEL_RADIUS_M
"""Offsets of possible contact points of a wheel along its heading, m; the rim is at most 0.06 m high there."""
BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Faces of a box as indices of its corners. Bit k of an index is 1 if the corner is at the high end of axis k."""
SPACING_M = 0.02
"""Sample spacing of the terrain under the wheels, m: the shortest meshed wavelength, even if a preview has larger
triangles (`terrain.coarseness`). A preview therefore has the poses of the final images."""


def settle_on_terrain(
    terrain: Terrain, x: FloatArray, y: FloatArray, heading: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return origins `(N, 3)` and rotations `(N, 3, 3)`, RB to DS, with the wheels on the ground.

    `x` and `y` `(N,)` are the position of the origin in DS, metres; the heading is measured from east to north. Each
    wheel is lowered until its rim touches the ground, which need not happen below the axle. A rocker-bogie suspension
    averages the wheels, so the body is parallel to the least-squares plane through the six wheel centres.
    """
    c = np.cos(heading)
    s = np.sin(heading)
    wx = x[:, None] + c[:, None] * WHEELS_RB_M[:, 0] - s[:, None] * WHEELS_RB_M[:, 1]
    wy = y[:, None] + s[:, None] * WHEELS_RB_M[:, 0] + c[:, None] * WHEELS_RB_M[:, 1]
    px = (wx[..., None] + c[:, None, None] * _ROLLING).ravel()
    py = (wy[..., None] + s[:, None, None] * _ROLLING).ravel()
    ground = terrain.height(px, py, np.full(len(px), SPACING_M)).reshape(*wx.shape, len(_ROLLING))
    centres = (ground + np.sqrt(WHEEL_RADIUS_M**2 - _ROLLING**2)).max(axis=2)
    design = np.column_stack((np.ones(len(WHEELS_RB_M)), WHEELS_RB_M))
    plane = centres @ np.linalg.pinv(design).T
    forward = np.stack((c, s, plane[:, 1]), axis=-1)
    left = np.stack((-s, c, plane[:, 2]), axis=-1)
    up = np.cross(forward, left)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    rotation = np.stack((forward, np.cross(up, forward), up), axis=-1)
    # the plane of the wheel centres is below the origin along z of RB, not along the vertical
    height = plane[:, 0] + (-GROUND_HEIGHT_RB_M - WHEEL_RADIUS_M) / up[:, 2]
    return np.stack((x, y, height), axis=-1), rotation


def rover_mesh() -> Mesh:
    """Return the boxes in RB that cast the rover's shadow: deck, wheels, mast and mast head.

    The position of the mast is that of the source document [3.2.6]; the sizes of the boxes are assumed.
    """
    x, y = MAST_XY_RB_M
    boxes = [
        ((-0.65, -0.45, -0.20), (0.55, 0.45, 0.10)),  # body
        ((-0.75, -0.60, 0.10), (0.45, 0.60, 0.14)),  # deck
        ((x - 0.04, y - 0.04, 0.10), (x + 0.04, y + 0.04, TILT_AXIS_Z_RB_M)),  # mast
        ((x - 0.08, y - 0.18, TILT_AXIS_Z_RB_M), (x + 0.08, y + 0.18, 0.75)),  # mast head
    ]
    low = GROUND_HEIGHT_RB_M + WHEEL_CLEARANCE_M
    high = GROUND_HEIGHT_RB_M + 2 * WHEEL_RADIUS_M
    boxes += [((x - 0.15, y - 0.07, low), (x + 0.15, y + 0.07, high)) for x, y in WHEELS_RB_M]
    return Mesh.join([_box(*ends) for ends in boxes])


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Return a box between two opposite corners, without normals."""
    ends = (low, high)
    corners = np.array([[ends[(k >> axis) & 1][axis] for axis in range(3)] for k in range(8)], np.float32)
    triangles = np.array([t for a, b, c, d in BOX_FACES for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh(corners, np.zeros_like(corners), triangles, np.zeros(len(triangles), np.int32))


def rig_extrinsics(cameras: CamerasConfig) -> Transform:
    """Return the pose of a stereo rig in RB or in the frame of the mast head."""
    about_x = matrix_from_rotvec([math.radians(cameras.roll_deg), 0.0, 0.0])
    about_y = matrix_from_rotvec([0.0, math.radians(cameras.pitch_deg), 0.0])
    about_z = matrix_from_rotvec([0.0, 0.0, math.radians(cameras.yaw_deg)])
    return Transform(about_z @ about_y @ about_x, np.array([cameras.x_m, cameras.y_m, cameras.z_m]))
