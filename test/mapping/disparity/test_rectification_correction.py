"""Gain, offset and vertical disparity of a made pair are recovered and compensated."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual
from sfr_loc_map.mapping.disparity.rectification_correction import RectificationCorrection, correct_rectification

F = np.float32
ROWS, COLS = 192, 256
DISPARITY = np.full((ROWS, COLS), 10.0, F)
V, U = np.mgrid[:ROWS, :COLS].astype(float)


def pair(textured: Any, vertical: tuple[float, float, float], gain: float = 1.0, offset: float = 0.0) -> Any:
    """Return images of a plane at 10 px, the right one's content lower by a constant and tilts."""
    rng = np.random.default_rng(8)
    lower = vertical[0] + vertical[1] * (2.0 * U / (COLS - 1) - 1.0) + vertical[2] * (2.0 * V / (ROWS - 1) - 1.0)
    left = textured(U, V, 2) + rng.normal(0.0, 1.0, U.shape)
    right = gain * textured(U + 10.0, V - lower, 2) + offset + rng.normal(0.0, 1.0, U.shape)
    return left.astype(F), right.astype(F)


@pytest.mark.parametrize(
    "vertical", [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (-0.8, 0.0, 0.0), (0.2, 0.3, 0.0), (0.1, -0.1, 0.4)]
)
def test_vertical_disparity_is_recovered(textured: Any, vertical: tuple[float, float, float]) -> None:
    left, right = pair(textured, vertical)
    correction, corrected = correct_rectification(left, right, DISPARITY)
    np.testing.assert_allclose(correction.vertical_px, vertical, atol=0.03)
    before, after = (np.nanstd(photometric_residual(left, image, DISPARITY)[4:-4]) for image in (right, corrected))
    assert after < 2.0
    assert after <= before + 0.01


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.7, 30.0), (1.3, -25.0)])
def test_exposure_is_recovered(textured: Any, gain: float, offset: float) -> None:
    left, right = pair(textured, (0.0, 0.0, 0.0), gain, offset)
    correction, corrected = correct_rectification(left, right, DISPARITY)
    assert correction.gain == pytest.approx(gain, rel=0.02)
    assert correction.offset == pytest.approx(offset, abs=3.0)
    residual = photometric_residual(left, corrected, DISPARITY)
    assert abs(np.nanmedian(residual)) < 0.5


def test_a_flat_image_gives_an_offset_and_no_gain() -> None:
    left, right = np.full((ROWS, COLS), 100.0, F), np.full((ROWS, COLS), 112.0, F)
    correction, corrected = correct_rectification(left, right, DISPARITY)
    assert (correction.gain, correction.offset) == (1.0, 12.0)
    assert correction.vertical_px == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(corrected, left)


def test_vertical_stripes_say_nothing_of_rows() -> None:
    left = (100.0 + 40.0 * np.sin(U / 5.0)).astype(F)
    right = (100.0 + 40.0 * np.sin((U + 10.0) / 5.0)).astype(F)
    correction, _ = correct_rectification(left, right, DISPARITY)
    np.testing.assert_allclose(correction.vertical_px, 0.0, atol=1e-6)


def test_the_largest_vertical_disparity_is_at_a_corner() -> None:
    assert RectificationCorrection(1.0, 0.0, (0.1, -0.2, 0.3)).max_vertical_px == pytest.approx(0.6)
