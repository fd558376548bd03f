"""Which disparities to trust, and how far."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.mapping import visibility
from sfr_loc_map.mapping.filters import box_mean, enlarged, repeated
from sfr_loc_map.mapping.refinement import JUMP_PX, Refined

FloatImage = NDArray[np.float32]
Mask = NDArray[np.bool_]
F = np.float32

NOISE_INFORMATION = F(0.2026)
"""Information that noise alone feigns in one cell: four times the energy of the slope's taps over four, for the mean of
two pictures has a quarter of the residual's variance."""
LEAST_TEXTURE = F(0.06)
"""Information of a cell beyond that of noise, on the mean, below which a region counts as featureless."""
TEXTURE_CELLS = 13
MISFIT_LIMIT = F(4.0)
"""Mean square of normalised residuals in 5 x 5 pixels beyond which a match is doubtful."""
MISFIT_CONTRAST = F(0.7)
"""Share of the picture's own variance that a doubtful match's residuals must reach to be wrong; 2 is none."""
MOVED_PX = 1.0
"""Refinement may move a disparity this far, or five times the usual move if that is more."""
JUMP_RADIUS = 3
JUMP_RANGE_PX = F(1.5)
BELONG_ODDS = F(0.8)
"""Votes of its own surface over those of the other that a pixel near a jump needs to stay."""
EDGE_RANGE_PX = F(2.0)
EDGE_SIGMA_PX = F(0.7)
"""Beside an edge of that height a larger sigma means that the pixel may be of either surface."""
SPECK_PIXELS = 80
LARGEST_SIGMA_PX = F(2.0)
NOISE_EXCESS = 0.85
"""Found over theoretical standard deviation where nothing bends."""
SHAPE_SHARE = 0.34
"""Error for each pixel of bending and square cell of reach. Both numbers were found on several rendered grounds, lights
and cameras at once; they are the same everywhere."""


def trusted(left: FloatImage, refined: Refined, initial_px: FloatImage, sigma_px: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` have a disparity that is not a guess.

    Left out: what the matcher left out, moved far, is hidden in the right picture, has no texture or does not look
    alike, or lies beside an edge without clearly belonging to its surface, or stands alone.
    """
    disparity = refined.disparity_px
    moved = np.abs(disparity - initial_px)
    usable = np.isfinite(initial_px)
    if not usable.any():
        return usable
    usable &= moved <= max(MOVED_PX, 5.0 * 1.4826 * float(np.nanmedian(moved)))
    usable &= ~visibility.hidden_of(disparity, usable, JUMP_PX)
    usable &= _textured(refined) & _alike(left, refined)
    square = np.ones((2 * JUMP_RADIUS + 1,) * 2, np.uint8)
    spread = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F)
    near_jump = spread > JUMP_RANGE_PX
    usable &= visibility.belongs(left, disparity, usable, near_jump, JUMP_RADIUS, F(8.0), F(3.0), BELONG_ODDS)
    usable &= ~((sigma_px > EDGE_SIGMA_PX) & (spread > EDGE_RANGE_PX))
    return _without_specks(disparity, usable)


def _without_specks(disparity: FloatImage, usable: Mask) -> Mask:
    """Leave out small islands: a few pixels that agree with nothing around them."""
    fixed = np.where(usable, np.rint(disparity * F(16.0)), F(-16.0)).astype(np.int16)
    cv2.filterSpeckles(fixed, -16, SPECK_PIXELS, 16)
    return fixed >= 0


def sigma_of(refined: Refined) -> FloatImage:
    """Return the standard deviation of each disparity `(H, W)` float32, pixels.

    A field measured with information h per cell under a stiffness s against bending has the variance
    `integral d2k / (2 pi)^2 1 / (h + s k^4) = 1 / (8 sqrt(h s))` at each place, for noise that is white. To that comes
    what smoothing takes from the shape, which grows with the bending that is left and with the square of the reach of
    the smoothing, `(s / h)^(1/4)` cells.
    """
    height, width = refined.disparity_px.shape
    information = np.maximum(box_mean(refined.information, 5) - NOISE_INFORMATION, F(1e-3))
    stiff_x, stiff_y = (box_mean(item, 5) for item in refined.stiffness)
    stiffness = np.sqrt(stiff_x * stiff_y)
    noise = F(0.125 * NOISE_EXCESS**2) / np.sqrt(information * stiffness)
    shape = np.square(SHAPE_SHARE * _bending(refined.cells_px)) * (stiffness / information)
    sigma = enlarged(np.sqrt(noise + shape), (2 * noise.shape[0], 2 * noise.shape[1]))[:height, :width]
    return np.asarray(np.minimum(sigma, LARGEST_SIGMA_PX), F)


def _bending(cells: FloatImage) -> FloatImage:
    """Return the mean size of second differences along both axes around each cell, pixels."""
    kernel = np.array([[1.0, -2.0, 1.0]], F)
    along_x = np.abs(np.asarray(cv2.filter2D(cells, -1, kernel, borderType=cv2.BORDER_REPLICATE), F))
    along_y = np.abs(np.asarray(cv2.filter2D(cells, -1, kernel.T, borderType=cv2.BORDER_REPLICATE), F))
    return box_mean(along_x + along_y, 5)


def _textured(refined: Refined) -> Mask:
    height, width = refined.disparity_px.shape
    texture = repeated(box_mean(refined.information, TEXTURE_CELLS))[:height, :width]
    return np.asarray(texture > NOISE_INFORMATION + LEAST_TEXTURE)


def _alike(left: FloatImage, refined: Refined) -> Mask:
    square = np.minimum(refined.misfit * refined.misfit, F(36.0))
    square[np.isnan(square)] = 36.0
    misfit = box_mean(square, 5)
    mean = box_mean(left, 7)
    contrast = box_mean(np.square(left), 7) - np.square(mean)
    doubtful = misfit > MISFIT_LIMIT
    wrong = misfit * F(refined.noise * refined.noise) > MISFIT_CONTRAST * contrast
    return np.asarray(~(doubtful & wrong))
