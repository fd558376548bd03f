"""Segments of the disparity image, and which of them are of noise."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.segments import (
    LARGE_PIXELS,
    MIN_PIXELS,
    find_segments,
    gradient_correlation,
    valid_segments,
)
from sfr_loc_map.mapping.mapper import Mapper

F = np.float32


def test_segments_are_those_of_a_flood_fill() -> None:
    steps = np.random.default_rng(3).integers(-8, 60, (40, 70)).astype(np.int32)
    steps[10:30, 20:60] //= 8
    segments = find_segments(steps, np.int32(16))
    number = np.full(steps.shape, -1)
    count = 0
    for start in zip(*np.nonzero(steps >= 0), strict=True):
        if number[start] >= 0:
            continue
        waiting = [start]
        number[start] = count
        while waiting:
            y, x = waiting.pop()
            for v, u in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                inside = 0 <= v < steps.shape[0] and 0 <= u < steps.shape[1]
                if inside and steps[v, u] >= 0 > number[v, u] and abs(steps[v, u] - steps[y, x]) <= 16:
                    number[v, u] = count
                    waiting.append((v, u))
        count += 1
    np.testing.assert_array_equal(segments.number, number)
    np.testing.assert_array_equal(segments.pixels, np.bincount(number[number >= 0]))


def seen(image: np.ndarray, shift: float) -> np.ndarray:
    """Return the right image of a surface at one disparity."""
    columns, rows = np.meshgrid(np.arange(image.shape[1], dtype=F) + F(shift), np.arange(image.shape[0], dtype=F))
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), F)


def test_correlation_is_one_for_the_same_content_and_none_for_unrelated_noise() -> None:
    rng = np.random.default_rng(0)
    noise = [cv2.GaussianBlur(rng.normal(128.0, 40.0, (60, 120)).astype(F), (0, 0), 1.5) for _ in range(2)]
    disparity = np.full(noise[0].shape, 7.3, F)
    segments = find_segments(np.full(disparity.shape, 117, np.int32), np.int32(16))
    tested = np.ones(1, np.bool_)
    assert gradient_correlation(noise[0], seen(noise[0], 7.3), disparity, segments, tested)[0] > 0.95
    assert gradient_correlation(noise[0], 3.0 * seen(noise[0], 7.3), disparity, segments, tested)[0] > 0.95
    assert abs(gradient_correlation(noise[0], noise[1], disparity, segments, tested)[0]) < 0.2
    assert gradient_correlation(noise[0], -seen(noise[0], 7.3), disparity, segments, tested)[0] < -0.95
    assert gradient_correlation(noise[0], seen(noise[0], 7.3), disparity, segments, ~tested)[0] == 0.0


@pytest.mark.parametrize("side", [int(np.sqrt(MIN_PIXELS)), 20, int(np.sqrt(LARGE_PIXELS)) + 1])
@pytest.mark.parametrize("alike", [True, False])
def test_small_segments_stay_if_their_content_is_in_both_images(side: int, alike: bool) -> None:
    rng = np.random.default_rng(1)
    left = cv2.GaussianBlur(rng.normal(128.0, 40.0, (90, 140)).astype(F), (0, 0), 1.5)
    right = seen(left, 5.0) if alike else cv2.GaussianBlur(rng.normal(128.0, 40.0, left.shape).astype(F), (0, 0), 1.5)
    valid = np.zeros(left.shape, np.bool_)
    valid[20 : 20 + side, 40 : 40 + side] = True
    kept = valid_segments(left, right, np.full(left.shape, 5.0, F), valid)
    stays = side**2 > MIN_PIXELS and (alike or side**2 > LARGE_PIXELS)
    np.testing.assert_array_equal(kept, valid & stays)


@pytest.mark.parametrize(("noise", "blur"), [(1.2, 0.0), (2.5, 0.6)])
def test_a_sky_of_noise_has_no_points(world: Callable[..., Any], slope_field: Any, noise: float, blur: float) -> None:
    """The ground's residuals are larger than the sky's noise, as where it is textured finely."""
    made = world(slope_field, width=384, height=320, noise=4.0, seed=5)
    rng = np.random.default_rng(11)
    sky = np.s_[:192]
    images = []
    for image in (made.pair.left.copy(), made.pair.right.copy()):
        grain = rng.normal(0.0, 1.0, image[sky].shape)
        if blur:
            grain = cv2.GaussianBlur(grain, (0, 0), blur)
        image[sky] = np.rint(165.0 - 0.05 * np.arange(192)[:, None] + noise / grain.std() * grain)
        images.append(image)
    result = Mapper(made.rig, MappingConfig()).process(StereoPair(0, *images), Transform.identity(), 0)
    assert not np.isfinite(result.disparity_px[:176]).any()
    assert np.isfinite(result.disparity_px[208:-16, 64:-16]).mean() > 0.95
