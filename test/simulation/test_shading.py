"""What a place looks like depends on the place, not on what is shaded along with it."""

import numpy as np
import pytest

from sfr_loc_map.simulation.config import GroundConfig, LightConfig, RockConfig
from sfr_loc_map.simulation.shading import GROUND, RUN, SKY, look_values, shade

SUN = np.array([0.6, 0.0, 0.8])
SHARES = np.array([0.5, 0.2])


def brightness(places: np.ndarray, objects: np.ndarray, camera: np.ndarray, **ground: float) -> np.ndarray:
    """Shade places `(N, 3)` with upward normals, seen from a camera."""
    away = places - camera
    ranges = np.linalg.norm(away, axis=1)
    rays = away / ranges[:, None]
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    look = look_values(GroundConfig(**ground), RockConfig(), LightConfig(), SUN)
    out = np.full(len(places), np.nan, np.float32)
    lit = np.ones(len(places), np.float32)
    shade(places, normals, objects, lit, rays, ranges, 0.0025, look, SHARES, np.uint32(7), 0.48, out)
    return out


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of places in front of a camera, some of them on rocks or in the sky."""
    count = 2 * RUN + 300
    rng = np.random.default_rng(3)
    y = np.linspace(-1.5, 1.5, count)
    places = np.column_stack((1.5 + 0.4 * (np.arange(count) // 500), y, np.zeros(count)))
    objects = rng.choice(np.array([GROUND, GROUND, GROUND, GROUND, SKY, 5], np.int32), count)
    return places, objects, np.array([0.0, 0.0, 1.2])


def test_brightness_does_not_depend_on_the_company(scene: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    places, objects, camera = scene
    together = brightness(places, objects, camera)
    assert np.isfinite(together).all()
    assert together[objects == GROUND].std() > 0.02
    order = np.random.default_rng(1).permutation(len(places))
    assert np.array_equal(brightness(places[order], objects[order], camera), together[order])
    some = slice(RUN - 3, RUN + 40)
    for n in range(some.start, some.stop):
        assert brightness(places[n : n + 1], objects[n : n + 1], camera)[0] == together[n]


def test_far_ground_is_smooth_and_near_ground_is_not(scene: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Waves and pebbles finer than a pixel fade out, so that a small step changes little when seen from afar."""
    places, objects, _ = scene
    ground = np.full(len(objects), GROUND, np.int32)
    step = np.array([0.004, 0.0, 0.0])
    change = []
    for height in (1.2, 60.0):
        camera = np.array([0.0, 0.0, height])
        change.append(np.abs(brightness(places + step, ground, camera) - brightness(places, ground, camera)).mean())
    assert change[0] > 20 * change[1]


def test_level_mean_ground_has_the_wanted_grey(scene: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Without contrast, pebbles or fine relief only the law of reflection is left."""
    places, _, camera = scene
    ground = np.full(len(places), GROUND, np.int32)
    flat = brightness(places, ground, camera, contrast=0.0, bump=0.0, pebbles=0.0)
    assert flat.mean() == pytest.approx(0.48, rel=0.05)
    assert flat.std() < 0.05
