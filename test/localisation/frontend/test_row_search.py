"""The search along rows against normalised cross-correlations by numpy."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.localisation.frontend.patch import cut_patches
from sfr_loc_map.localisation.frontend.row_search import MIN_PEAK_DISTANCE, SEARCH_HALF, search_row

RIGHT = np.random.default_rng(0).normal(100.0, 20.0, (40, 120)).astype(np.float32)
MAX_DISPARITY = 30


def correlations(patch: FloatImage, u: int, v: int) -> FloatArray:
    """Return the correlations of a patch with the right patches of the disparities from -1 on."""
    scores = []
    for d in range(-1, min(MAX_DISPARITY, u - SEARCH_HALF) + 1):
        columns = slice(u - d - SEARCH_HALF, u - d + SEARCH_HALF + 1)
        right = RIGHT[v - SEARCH_HALF : v + SEARCH_HALF + 1, columns]
        scores.append(np.corrcoef(patch.ravel(), right.ravel())[0, 1])
    return np.array(scores)


@pytest.mark.parametrize(("u", "v", "true_disparity"), [(60, 20, 7), (60, 5, 0), (20, 33, 12), (110, 20, 30)])
@pytest.mark.parametrize("offset_v", [0, 2])
def test_best_second_and_fraction_are_those_of_the_correlations(
    u: int, v: int, true_disparity: int, offset_v: int
) -> None:
    left = np.roll(RIGHT, (true_disparity, -offset_v), axis=(1, 0))
    left = left + 0.5 * np.roll(left, 1, axis=1)  # a peak between two pixels
    patches = cut_patches(left, np.array([[u, v]], float), SEARCH_HALF)[:, 0]
    found = search_row(RIGHT, patches, np.array([[u, v]], float), MAX_DISPARITY, offset_v)[0]
    scores = correlations(patches[0], u, v + offset_v)
    best = int(scores.argmax())
    disparity = float(best - 1)
    if 0 < best < len(scores) - 1:
        before, at, after = scores[best - 1 : best + 2]
        disparity += 0.5 * (before - after) / (before - 2.0 * at + after)
    is_other_peak = np.abs(np.arange(len(scores)) - best) > MIN_PEAK_DISTANCE
    np.testing.assert_allclose(found, [disparity, scores[best], scores[is_other_peak].max()], atol=1e-4)
    assert abs(disparity - true_disparity) < 1.0


@pytest.mark.parametrize(("u", "v"), [(60, SEARCH_HALF - 1), (60, 40 - SEARCH_HALF), (SEARCH_HALF + 1, 20)])
def test_patches_at_the_border_are_not_found(u: int, v: int) -> None:
    patch = RIGHT[10 : 10 + 9, 10 : 10 + 9].reshape(1, -1).copy()
    np.testing.assert_array_equal(search_row(RIGHT, patch, np.array([[u, v]], float), MAX_DISPARITY, 0), 0.0)
