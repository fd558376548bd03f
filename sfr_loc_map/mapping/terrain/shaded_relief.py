"""The image of an elevation model: heights as colours, shaded by their slopes."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import ColourImage
from sfr_loc_map.mapping.terrain.elevation import ElevationModel

HEIGHT_QUANTILES = (0.01, 0.99)
"""Quantiles of the heights at the ends of the colour range; heights beyond are clipped."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35  #: Fraction of the light that does not depend on the slope.
BRIDGED_SHARE = 0.1  #: Minimum weighted fraction of neighbours with a height for a gap to be filled in the image.
VOID = (32, 32, 32)  #: Colour of a cell without a height.


def shaded_heights(model: ElevationModel) -> ColourImage:
    """Return heights as colours, shaded by their slopes, with one pixel per cell and y of LM upwards.

    Gaps of one or two cells are filled for display.
    """
    weight = np.isfinite(model.height_m).astype(np.float32)
    weighted = np.where(weight > 0, model.height_m, 0.0)
    total, near_share = (cv2.GaussianBlur(image, (0, 0), 1.0) for image in (weighted, weight))
    near = np.asarray(total / np.maximum(near_share, 1e-6), np.float32)
    near[near_share < BRIDGED_SHARE] = np.nan
    heights = np.where(weight > 0, model.height_m, near)
    known = np.isfinite(heights)
    low, high = np.quantile(heights[known], HEIGHT_QUANTILES) if known.any() else (0.0, 1.0)
    filled = np.where(known, heights, np.float32(np.nanmedian(model.height_m) if known.any() else 0.0))
    slope_y, slope_x = np.gradient(filled.astype(np.float64), model.cell_m) if min(filled.shape) > 1 else (0.0, 0.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    shade = np.asarray(AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, 1.3))
    level = np.rint(255.0 * np.clip((filled - low) / max(high - low, 1e-6), 0.0, 1.0)).astype(np.uint8)
    image = np.where(known[..., None], cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS) * shade[..., None], VOID)
    return np.clip(image, 0.0, 255.0).astype(np.uint8)[::-1]
