"""The image of an elevation model: heights as colours, shaded by their slopes."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import ColourImage, FloatArray, FloatArray32
from sfr_loc_map.mapping.terrain.elevation import ElevationModel

HEIGHT_QUANTILES = (0.01, 0.99)
"""Quantiles of the heights at the ends of the colour range; heights beyond are clipped."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35  #: Fraction of the light that does not depend on the slope.
MAX_BRIGHTNESS = 1.3  #: Maximum brightness by the light, relative to level ground. Brighter slopes are clipped.
GAP_SIGMA_CELLS = 1.0  #: Standard deviation of the Gaussian that fills gaps, cells.
MIN_FILLED_WEIGHT = 0.1  #: Minimum weighted fraction of neighbours with a height for a gap to be filled.
MIN_DIVISOR = 1e-6  #: Lower bound of the weights and of the range of the heights, m, which are divisors.
VOID = (32, 32, 32)  #: Colour of a cell without a height.


def shaded_heights(model: ElevationModel) -> ColourImage:
    """Return heights as colours, shaded by their slopes, with one pixel per cell and y of LM upwards.

    Gaps of one or two cells are filled for display.
    """
    heights = _with_filled_gaps(model.height_m)
    known = np.isfinite(heights)
    low, high = (0.0, 1.0)
    elsewhere = np.float32(0.0)
    if known.any():
        low, high = np.quantile(heights[known], HEIGHT_QUANTILES)
        elsewhere = np.float32(np.nanmedian(model.height_m))
    complete = np.where(known, heights, elsewhere)
    fraction = np.clip((complete - low) / max(high - low, MIN_DIVISOR), 0.0, 1.0)
    colours = cv2.applyColorMap(np.rint(255.0 * fraction).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    shaded = colours * _brightness(complete, model.cell_m)[..., None]
    image = np.where(known[..., None], shaded, VOID)
    return np.clip(image, 0.0, 255.0).astype(np.uint8)[::-1]


def _with_filled_gaps(height_m: FloatArray32) -> FloatArray32:
    """Return the heights `(R, C)` with small gaps filled by the weighted mean of their neighbours; NaN elsewhere."""
    weight = np.isfinite(height_m).astype(np.float32)
    weighted = np.where(weight > 0, height_m, 0.0)
    total = cv2.GaussianBlur(weighted, (0, 0), GAP_SIGMA_CELLS)
    known_fraction = cv2.GaussianBlur(weight, (0, 0), GAP_SIGMA_CELLS)
    near = np.asarray(total / np.maximum(known_fraction, MIN_DIVISOR), np.float32)
    near[known_fraction < MIN_FILLED_WEIGHT] = np.nan
    return np.where(weight > 0, height_m, near)


def _brightness(height_m: FloatArray32, cell_m: float) -> FloatArray:
    """Return the brightness `(R, C)` of finite heights `(R, C)`, relative to level ground (Lambert's cosine law)."""
    slope_y, slope_x = (0.0, 0.0)
    if min(height_m.shape) > 1:
        slope_y, slope_x = np.gradient(height_m.astype(np.float64), cell_m)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    return np.asarray(AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, MAX_BRIGHTNESS))
