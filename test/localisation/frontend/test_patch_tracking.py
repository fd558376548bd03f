"""Tracking of patches: a known subpixel shift."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from sfr_loc_map.localisation.frontend.patch import HALF, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.patch_tracking import PatchTracks, TrackingLimits, track_patches

RANDOM = np.random.default_rng(0)
IMAGE = gaussian_filter(RANDOM.normal(128.0, 400.0, (120, 160)), 2.0).astype(np.float32)
UV = RANDOM.integers(25, 95, (30, 2)).astype(float)


def shifted(dx: float, dy: float, gain: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """Return the image with its content moved by (dx, dy)."""
    y, x = np.mgrid[0:120, 0:160].astype(float)
    moved = map_coordinates(IMAGE.astype(float), [y - dy, x - dx], order=5, mode="nearest")
    return (gain * moved + offset).astype(np.float32)


def track(image: np.ndarray) -> PatchTracks:
    templates = templates_of(cut_patches(IMAGE, UV, HALF))
    return track_patches(image, templates, UV, np.tile(np.eye(3), (len(UV), 1, 1)), TrackingLimits(2.5, 20, -1.0))


@pytest.mark.parametrize(("dx", "dy"), [(0.0, 0.0), (0.4, -0.7), (-1.6, 1.2)])
def test_a_subpixel_shift_is_found_whatever_the_contrast(dx: float, dy: float) -> None:
    tracks = track(shifted(dx, dy, gain=0.6, offset=30.0))
    found = np.isfinite(tracks.uv[:, 0])
    assert found.mean() > 0.9
    np.testing.assert_allclose((tracks.uv - UV)[found], np.tile([dx, dy], (found.sum(), 1)), atol=0.05)
    assert tracks.correlation[found].min() > 0.99
