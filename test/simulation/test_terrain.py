"""The shape of the ground: slopes, craters and ripples."""

from itertools import pairwise

import numpy as np
import pytest

from sfr_loc_map.simulation.config import MAX_CRATER_DENSITY, GroundConfig, ReliefConfig
from sfr_loc_map.simulation.terrain import Terrain


def flat(**changes: float) -> Terrain:
    level = {"relief_m": 0.0, "hills_m": 0.0, "ripple_height_m": 0.0, "crater_density": 0.0}
    return Terrain.make(3, ReliefConfig(**(level | changes)), GroundConfig(gravel=0.0, bedrock=0.0))


def heights(terrain: Terrain, x: np.ndarray, y: np.ndarray, spacing: float = 0.02) -> np.ndarray:
    return terrain.height(x.astype(float).copy(), y.astype(float).copy(), np.full(len(x), spacing))


def test_the_density_of_craters_has_an_effect_over_its_whole_range() -> None:
    x, y = np.random.default_rng(0).uniform(-200, 200, (2, 4000))
    densities = np.linspace(0.0, MAX_CRATER_DENSITY, 8)
    surfaces = [heights(flat(crater_density=density), x, y) for density in densities]
    assert all((surface != following).any() for surface, following in pairwise(surfaces))


@pytest.mark.clause("3.2.7.1")
def test_slope_is_a_plane_that_rises_to_the_east() -> None:
    x, y = np.random.default_rng(0).uniform(-50, 50, (2, 200))
    assert np.allclose(heights(flat(slope_deg=10.0), x, y), np.tan(np.radians(10.0)) * x, atol=1e-12)


def test_large_crater_is_a_bowl_with_a_rim_around_its_centre() -> None:
    """Floor 0.24 radii deep at the centre, rim 0.07 radii high at the radius, level beyond 2.2 radii."""
    radius, x0, y0 = 10.0, 4.0, -3.0
    crater = flat(rim_radius_m=radius, rim_x_m=x0, rim_y_m=y0)
    angle = np.linspace(0, 2 * np.pi, 9)
    for r, height in ((0.0, -0.24), (1.02, 0.07), (2.3, 0.0)):
        z = heights(crater, x0 + r * radius * np.cos(angle), y0 + r * radius * np.sin(angle))
        assert np.allclose(z, height * radius, atol=0.012 * radius)
        assert np.ptp(z) < 1e-9


def test_ripples_are_omitted_where_the_spacing_does_not_resolve_them() -> None:
    x, y = np.random.default_rng(0).uniform(-20, 20, (2, 200))
    for length_m in (0.5, 5.0, 50.0):
        ripples = flat(ripple_height_m=1.0, ripple_length_m=length_m)
        fine = heights(ripples, x, y)
        assert np.ptp(fine) > 0.3
        assert (heights(ripples, x, y, spacing=0.3 * length_m) == fine).all()
        assert (heights(ripples, x, y, spacing=0.5 * length_m) == 0.0).all()
