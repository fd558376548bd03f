"""Slopes of single patches in images of a plane, which are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.localisation.frontend.patch import HALF, cut_patches
from sfr_loc_map.localisation.frontend.patch_slopes import refine_slopes

CENTRE = np.array([[40.0, 30.0]])
DISPARITY = 12.3


def texture(u: FloatArray, v: FloatArray) -> FloatImage:
    """Return smooth grey levels with gradients in all directions."""
    waves = np.sin(0.55 * u + 0.2 * v) + np.cos(0.35 * v - 0.15 * u) + np.sin(0.4 * (u + v)) + np.cos(0.6 * v)
    return (120.0 + 25.0 * waves).astype(np.float32)


def images(slope_u: float, slope_v: float) -> tuple[FloatImage, FloatImage]:
    """Return a left and a right image of a plane in disparity: R(u - d(u, v), v) = L(u, v)."""
    y, x = np.mgrid[:60, :80].astype(float)
    u0, v0 = CENTRE[0]
    u = (x + DISPARITY - slope_u * u0 + slope_v * (y - v0)) / (1.0 - slope_u)
    return texture(x, y), texture(u, y)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.08, 0.0), (0.0, 0.08), (-0.1, 0.05), (0.06, -0.09)])
@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_the_slopes_are_those_of_the_plane_whatever_the_contrast(slope: tuple[float, float], gain: float) -> None:
    left, right = images(*slope)
    patches = cut_patches(left, CENTRE, HALF)
    start = np.array([slope]) * 0.3
    found = refine_slopes(gain * right + 10.0, patches, CENTRE - [[DISPARITY - 0.2, 0.0]], start)
    np.testing.assert_allclose(found[0], slope, atol=0.006)


def test_slopes_that_cannot_be_refined_are_kept() -> None:
    left, right = images(0.05, 0.0)
    patches = cut_patches(left, CENTRE, HALF)
    start = np.array([[0.02, 0.01]])
    flat = np.full_like(right, 90.0)
    for image, at in ((flat, CENTRE - [[DISPARITY, 0.0]]), (right, CENTRE * np.nan), (right, np.array([[2.0, 30.0]]))):
        np.testing.assert_array_equal(refine_slopes(image, patches, at, start), start)
