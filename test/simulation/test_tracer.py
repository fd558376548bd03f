"""Rays against analytic planes: hits, normals, occlusion, and shadows in the direction away from the sun."""

from __future__ import annotations

import math

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


def test_occlusion_is_that_of_a_plate_before_a_wall() -> None:
    """A plate at 1 m hides of a wall at 2 m what lies on the lines from the right camera through it."""
    right, down = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    wall = square(np.array([2.0, 0.0, 0.0]), 8.0 * right, -8.0 * down, GROUND)
    plate = square(np.array([1.0, 0.0, 0.0]), 0.1 * right, -4.0 * down, 3)
    tracer = Tracer(Mesh.join([wall, plate]))
    T_ds_sb = Transform(np.eye(3), np.zeros(3))
    T_ds_left = camera_pose(T_ds_sb, RIG, False)
    u = np.arange(64.0)
    hits = trace_primary_rays(tracer, T_ds_left.translation, pixel_rays(RIG, T_ds_left, u, np.full(64, RIG.cy)))
    mask = occlusion_mask(tracer, hits, camera_pose(T_ds_sb, RIG, True), RIG)
    across = hits.points @ right
    on_wall = hits.objects == GROUND
    seen_from_right = RIG.fx * (across - 0.1) / hits.points[:, 0]  # pixels from the image centre
    outside = np.abs(seen_from_right) >= 0.5 * RIG.width
    # the plate spans -0.1 .. 0.1 m at 1 m; from the camera at +0.1 m its shadow on the wall is -0.3 .. 0.1 m
    behind = on_wall & (across > -0.3 + 0.01) & (across < 0.1 - 0.01)
    clear = ~outside & (~on_wall | (across < -0.3 - 0.01) | (across > 0.1 + 0.01))
    assert behind.any()
    assert clear.sum() > 20
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
