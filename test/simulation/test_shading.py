"""Brightness depends on position alone, and follows the laws of reflection and haze."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.config import GroundConfig, LightConfig, ReliefConfig, SimulationConfig
from sfr_loc_map.simulation.shading import (
    RUN,
    ShadingParameters,
    reflect,
    shade,
    shading_parameters,
    sun_direction,
    surface_brightness,
)
from sfr_loc_map.simulation.terrain import Terrain
from sfr_loc_map.simulation.tracer import GROUND, SKY, Hits

SUN = np.array([0.6, 0.0, 0.8])


def parameters(light: LightConfig | None = None, **ground: float) -> ShadingParameters:
    config = GroundConfig(gravel=0.5, bedrock=0.2, **ground)
    terrain = Terrain.make(7, ReliefConfig(), config)
    return shading_parameters(SimulationConfig(ground=config, light=light or LightConfig()), SUN, terrain)


def brightness(points: np.ndarray, objects: np.ndarray, camera: np.ndarray, **ground: float) -> np.ndarray:
    """Shade points `(N, 3)` with upward normals, viewed from a camera."""
    away = points - camera
    ranges = np.linalg.norm(away, axis=1)
    rays = away / ranges[:, None]
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    out = np.full(len(points), np.nan, np.float32)
    lit = np.ones(len(points), np.float32)
    shade(Hits(points, normals, objects, ranges), rays, lit, 0.0025, parameters(**ground), out)
    return out


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of points in front of a camera, some of them on rocks or in the sky."""
    count = 2 * RUN + 300
    rng = np.random.default_rng(3)
    y = np.linspace(-1.5, 1.5, count)
    points = np.column_stack((1.5 + 0.4 * (np.arange(count) // 500), y, np.zeros(count)))
    objects = rng.choice(np.array([GROUND, GROUND, GROUND, GROUND, SKY, 5], np.int32), count)
    return points, objects, np.array([0.0, 0.0, 1.2])


def test_brightness_does_not_depend_on_the_rest_of_the_batch(scene: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    points, objects, camera = scene
    together = brightness(points, objects, camera)
    assert np.isfinite(together).all()
    assert together[objects == GROUND].std() > 0.02
    order = np.random.default_rng(1).permutation(len(points))
    assert np.array_equal(brightness(points[order], objects[order], camera), together[order])
    for n in range(RUN - 3, RUN + 40):
        assert brightness(points[n : n + 1], objects[n : n + 1], camera)[0] == together[n]


def grey(normal: FloatArray, mu: float = 0.5, distance: float = 1e-3, sun: float = 1.0, sky: float = 0.0) -> float:
    light = parameters(LightConfig(sky=sky), lunar=0.0)
    return surface_brightness(tuple(normal), mu, distance, 1.0, 1.0, sun, light)


def test_lambert_surface_follows_the_cosine_of_incidence() -> None:
    """With no lunar share and no sky the brightness is proportional to the cosine, whatever the view and the length."""
    facing = grey(SUN)
    for angle in (0.2, 0.9, 1.4):
        normal = np.array([0.8, 0.0, -0.6]) * np.sin(angle) + SUN * np.cos(angle)
        assert grey(3.0 * normal) == pytest.approx(facing * np.cos(angle), rel=1e-6)
        assert grey(normal, mu=0.9) == pytest.approx(grey(normal, mu=0.2), rel=1e-12)
    assert grey(-SUN) == pytest.approx(0.0, abs=1e-6)
    assert grey(SUN, sun=0.25) == pytest.approx(0.25 * facing, rel=1e-5)


def test_dust_reflects_by_lommel_and_seeliger() -> None:
    """2 mu0 / (mu0 + mu) is 1 where both cosines are equal, and brighter at grazing views."""
    assert reflect(0.7, 0.7, 1.0) * 0.7 == pytest.approx(1.0, rel=1e-5)
    assert reflect(0.7, 0.2, 1.0) == pytest.approx(2.0 / 0.9, rel=1e-5)
    assert reflect(0.7, 0.2, 0.0) == 1.0
    assert reflect(0.7, 0.2, 0.25) == pytest.approx(0.25 * reflect(0.7, 0.2, 1.0) + 0.75, rel=1e-12)


def test_haze_takes_the_contrast_exponentially() -> None:
    near, far, one = grey(SUN), grey(SUN, distance=1e7), grey(SUN, distance=LightConfig().haze_m)
    assert far == pytest.approx(0.9 * LightConfig().sky_grey, rel=1e-9)
    assert one == pytest.approx(far + (near - far) * np.exp(-1.0), rel=1e-5)


@pytest.mark.parametrize(
    ("elevation_deg", "azimuth_deg", "direction"),
    [
        (90.0, 70.0, (0.0, 0.0, 1.0)),
        (30.0, 0.0, (np.sqrt(0.75), 0.0, 0.5)),  # in the east
        (30.0, 90.0, (0.0, np.sqrt(0.75), 0.5)),  # in the north
        (45.0, 225.0, (-0.5, -0.5, np.sqrt(0.5))),  # in the south-west
    ],
)
def test_the_azimuth_of_the_sun_is_measured_from_east_to_north(
    elevation_deg: float, azimuth_deg: float, direction: tuple[float, float, float]
) -> None:
    light = LightConfig(sun_elevation_deg=elevation_deg, sun_azimuth_deg=azimuth_deg)
    np.testing.assert_allclose(sun_direction(light), direction, atol=1e-12)


@pytest.mark.parametrize("albedo", [0.1, 0.4])
@pytest.mark.parametrize("sky", [0.0, 0.35])
def test_level_sunlit_ground_of_mean_reflectance_has_the_brightness_of_the_target(albedo: float, sky: float) -> None:
    light = parameters(LightConfig(sky=sky, haze_m=1e6), albedo=albedo)
    assert surface_brightness((0.0, 0.0, 1.0), 0.5, 1e-3, albedo, 1.0, 1.0, light) == pytest.approx(1.0, rel=1e-6)
    assert light.target == SimulationConfig().sensor.target_grey


def test_sky_light_decreases_with_the_slope_and_in_the_shadow_of_a_pebble() -> None:
    """Ground in shadow: a vertical wall has 55 % of the light of level ground, the shadow of a pebble 60 %."""
    light = parameters(LightConfig(sky=0.5, haze_m=1e6))

    def shaded(normal: tuple[float, float, float], sunlit: float) -> float:
        return surface_brightness(normal, 0.5, 1e-3, 1.0, sunlit, 0.0, light)

    level = shaded((0.0, 0.0, 1.0), 1.0)
    assert shaded((0.0, 1.0, 0.0), 1.0) == pytest.approx(0.55 * level, rel=1e-4)
    assert shaded((0.0, 0.0, 1.0), 0.0) == pytest.approx(0.6 * level, rel=1e-4)
