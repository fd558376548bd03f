"""Shadows fall where the sun puts them."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.mesh import Mesh
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.rays import sun_rays
from sfr_loc_map.simulation.renderer import Occluder, Tracer, trace_primary_rays, trace_shadow_rays
from sfr_loc_map.simulation.rover import rover_mesh
from sfr_loc_map.simulation.world import MaskBit, World

pytest.importorskip("embreex")


def floor_with_wall() -> Mesh:
    """A level floor of 20 m and a wall of 1 m height at x = 0."""
    floor = [(-10, -10, 0), (10, -10, 0), (10, 10, 0), (-10, 10, 0)]
    wall = [(0, -10, 0), (0, 10, 0), (0, 10, 1), (0, -10, 1)]
    vertices = np.array(floor + wall, np.float32)
    normals = np.array([(0, 0, 1)] * 4 + [(1, 0, 0)] * 4, np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], np.int32)
    return Mesh(vertices, normals, triangles, np.full(4, -1, np.int32))


def lit_along_x(elevation_deg: float, occluder: Occluder | None = None) -> tuple[np.ndarray, np.ndarray]:
    tracer = Tracer(floor_with_wall())
    x = np.linspace(-8.0, -0.02, 1597)
    rays = np.column_stack((x, np.full(len(x), 0.3), np.full(len(x), -5.0)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = trace_primary_rays(tracer, np.array([0.0, 0.0, 5.0]), rays)
    angle = math.radians(elevation_deg)
    suns = sun_rays(np.array([math.cos(angle), 0.0, math.sin(angle)]), 0.0, len(x), np.uint32(1))
    return hits.points[:, 0], trace_shadow_rays(tracer, hits, suns, occluder)


@pytest.mark.parametrize("elevation", [20.0, 45.0, 70.0])
def test_shadow_of_a_wall_has_the_length_of_its_height_over_the_tangent(elevation: float) -> None:
    x, lit = lit_along_x(elevation)
    floor = x < -0.05
    shadow = -x[floor & (lit == 0)].min()
    assert shadow == pytest.approx(1.0 / math.tan(math.radians(elevation)), abs=0.02)


def test_rover_casts_a_shadow_but_is_not_seen() -> None:
    rover = Occluder(Tracer(rover_mesh()), Transform(np.eye(3), np.array([-4.0, 0.0, 0.54])))
    x, lit = lit_along_x(80.0, rover)
    _, free = lit_along_x(80.0)
    under = (x > -4.5) & (x < -3.7)
    assert (free[under] == 1).all()
    assert (lit[under] == 0).mean() > 0.9
    assert np.array_equal(lit[x > -2.5], free[x > -2.5])


def test_sun_disc_is_evenly_filled_and_repeatable() -> None:
    sun = np.array([0.6, 0.0, 0.8])
    rays = sun_rays(sun, 0.01, 20000, np.uint32(3)).astype(float)
    offset = np.linalg.norm(rays - sun, axis=1)
    assert offset.max() <= 0.0101
    assert (offset < 0.01 * math.sqrt(0.5)).mean() == pytest.approx(0.5, abs=0.02)
    assert np.array_equal(rays, sun_rays(sun, 0.01, 20000, np.uint32(3)).astype(float))


@pytest.mark.slow
def test_low_sun_makes_more_shadow(config: Callable[..., SimulationConfig]) -> None:
    shares = []
    for elevation in (60.0, 8.0):
        changes = {"panorama__enabled": True, "drive__enabled": False, "light__sun_elevation_deg": elevation}
        world = World(Plan.make(config(**changes, terrain__relief_m=0.2)))
        shares.append(float(((world.truth(0)[1] & MaskBit.SHADOW) > 0).mean()))
        assert world.plan.count(Task.MAPPING) == 2
    assert shares[1] > 3 * shares[0] + 0.01
