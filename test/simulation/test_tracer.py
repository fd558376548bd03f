"""Rays against analytic planes: hits, normals, occlusion, and shadows in the direction away from the sun."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex")

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.ground_mesh import Mesh
from sfr_loc_map.simulation.tracer import (
    GROUND,
    SKY,
    Tracer,
    camera_pose,
    occlusion_mask,
    pixel_rays,
    sun_rays,
    trace_primary_rays,
    trace_shadow_rays,
)

RIG = StereoRig(64, 48, 50.0, 55.0, 31.5, 23.5, 0.2)


def square(centre: FloatArray, side_x: FloatArray, side_y: FloatArray, number: int) -> Mesh:
    """A flat square of two triangles with the normal `side_x x side_y`."""
    corners = np.array([centre + a * side_x + b * side_y for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    normal = np.cross(side_x, side_y)
    normals = np.tile(normal / np.linalg.norm(normal), (4, 1))
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    return Mesh(corners.astype(np.float32), normals.astype(np.float32), triangles, np.full(2, number, np.int32))


def slope(angle: float) -> tuple[Mesh, FloatArray]:
    """A large ground that rises along x, and its normal."""
    up = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    east = np.array([np.cos(angle), 0.0, np.sin(angle)])
    return square(np.zeros(3), 64.0 * east, np.array([0.0, 64.0, 0.0]), GROUND), up


def downward(count: int = 200) -> FloatArray:
    rays = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, 0.2] - [0.0, 0.0, 1.0]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def sloped() -> tuple[Tracer, FloatArray]:
    mesh, normal = slope(0.35)
    return Tracer(mesh), normal


def test_first_hits_lie_on_an_analytic_slope(sloped: tuple[Tracer, FloatArray]) -> None:
    tracer, normal = sloped
    origin, rays = np.array([0.4, 0.1, 3.0]), downward()
    hits = trace_primary_rays(tracer, origin, rays)
    expected = -(normal @ origin) / (rays @ normal)
    assert (hits.objects == GROUND).all()
    assert np.allclose(hits.ranges, expected, rtol=1e-5)
    assert np.allclose(hits.normals, normal, atol=1e-6)
    up = trace_primary_rays(tracer, origin, -rays)
    assert (up.objects[-rays @ normal > 0.1] == SKY).all()


@pytest.mark.parametrize("centre", [(31.5, 23.5), (12.0, 40.0), (55.25, 3.0)])
def test_occlusion_is_that_of_a_plate_before_a_wall(centre: tuple[float, float]) -> None:
    """A plate at 1 m hides the part of a wall at 2 m that is on the lines from the right camera through the plate."""
    rig = replace(RIG, cx=centre[0], cy=centre[1])
    right, down = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    wall = square(np.array([2.0, 0.0, 0.0]), 8.0 * right, -8.0 * down, GROUND)
    plate = square(np.array([1.0, 0.0, 0.0]), 0.1 * right, -4.0 * down, 3)
    tracer = Tracer(Mesh.join([wall, plate]))
    T_ds_sb = Transform(np.eye(3), np.zeros(3))
    T_ds_left = camera_pose(T_ds_sb, rig, "left")
    u = np.arange(64.0)
    hits = trace_primary_rays(tracer, T_ds_left.translation, pixel_rays(rig, T_ds_left, u, np.full(64, rig.cy)))
    mask = occlusion_mask(tracer, hits, camera_pose(T_ds_sb, rig, "right"), rig)
    across = hits.points @ right
    on_wall = hits.objects == GROUND
    right_column = rig.fx * (across - 0.1) / hits.points[:, 0] + rig.cx
    outside = (right_column <= -0.5) | (right_column >= rig.width - 0.5)
    # the plate spans -0.1 .. 0.1 m at 1 m; from the camera at +0.1 m its shadow on the wall is -0.3 .. 0.1 m
    behind = on_wall & (across > -0.3 + 0.01) & (across < 0.1 - 0.01)
    clear = ~outside & (~on_wall | (across < -0.3 - 0.01) | (across > 0.1 + 0.01))
    assert behind.any()
    assert clear.sum() > 10
    assert outside.any()
    assert mask[behind | outside].all()
    assert not mask[clear].any()


@pytest.mark.parametrize("elevation", [20.0, 45.0, 70.0])
def test_shadow_of_a_wall_has_the_length_of_its_height_over_the_tangent(elevation: float) -> None:
    """On a level floor, beside a wall of 1 m height at x = 0 that lies towards the sun."""
    east, north, up = np.eye(3)
    floor = square(np.zeros(3), 10.0 * east, 10.0 * north, GROUND)
    tracer = Tracer(Mesh.join([floor, square(0.5 * up, 10.0 * north, 0.5 * up, GROUND)]))
    rays = np.column_stack((np.linspace(-8.0, -0.02, 1597), np.full(1597, 0.3), np.full(1597, -5.0)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = trace_primary_rays(tracer, 5.0 * up, rays)
    angle = math.radians(elevation)
    suns = sun_rays(math.cos(angle) * east + math.sin(angle) * up, 0.0, 1597, np.uint32(1))
    x, lit = hits.points[:, 0], trace_shadow_rays(tracer, hits, suns)
    shadow = -x[(x < -0.05) & (lit == 0)].min()
    assert shadow == pytest.approx(1.0 / math.tan(angle), abs=0.02)


def test_an_occluder_casts_its_shadow_from_its_pose() -> None:
    """A plate of 1.6 x 0.4 m after its turn is at (2, 1, 2) m. The sun is at 45 deg in the east: its shadow is 2 m
    west of it."""
    east, north, up = np.eye(3)
    floor = Tracer(square(np.zeros(3), 10.0 * east, 10.0 * north, GROUND))
    plate = Tracer(square(np.zeros(3), 0.2 * east, 0.8 * north, 0))
    turned = Transform(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([2.0, 1.0, 2.0]))
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-3.0, 3.0, 0.05), np.arange(-1.0, 3.0, 0.05)))
    rays = np.column_stack((x, y, np.full(len(x), -5.0)))
    hits = trace_primary_rays(floor, 5.0 * up, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    suns = np.tile((east + up) / math.sqrt(2.0), (len(x), 1)).astype(np.float32)
    lit = trace_shadow_rays(floor, hits, suns, (plate, turned))
    in_shadow = (np.abs(x) < 0.8) & (np.abs(y - 1.0) < 0.2)
    beside = (np.abs(x) > 0.82) | (np.abs(y - 1.0) > 0.22)
    assert (lit[in_shadow & ~beside] == 0.0).all()
    assert (lit[beside] == 1.0).all()
    assert (trace_shadow_rays(floor, hits, suns) == 1.0).all()
