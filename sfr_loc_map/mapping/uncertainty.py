"""Which disparities to trust, and how far."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping import occlusion as visibility
from sfr_loc_map.mapping.filters import box_mean, enlarged, repeated
from sfr_loc_map.mapping.variational_refinement import JUMP_PX, Refined

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
MOVED_PX = 1.5
"""Refinement may move a disparity this far, or five times the usual move if that is more."""
JUMP_RANGE_PX = F(1.5)
"""Disparities of 3 x 3 pixels that span more are a jump; pixels up to `visibility.BESIDE` from it are beside it."""
ALIKE_GREY = 8.0
NEAR_PX = 3.0
WINDOW_RADIUS = 4
"""Neighbours of like grey and near by speak for a pixel: where the weight is 1/e, and how far they are looked at."""
EVIDENCE_PER_SIGMA = F(4.0)
EVIDENCE_OFFSET = F(3.0)
"""Evidence for its own surface against another that a pixel beside a jump needs, in standard deviations of noise: so
much per pixel of its own sigma, less the offset. The weaker a match, the surer it must be of its side."""
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
    alike, or lies beside an edge and agrees better with the surface beyond it, or stands alone.
    """
    disparity = refined.disparity_px
    moved = np.abs(disparity - initial_px)
    usable = np.isfinite(initial_px)
    if not usable.any():
        return usable
    matched = usable.copy()
    usable &= moved <= max(MOVED_PX, 5.0 * 1.4826 * float(np.nanmedian(moved)))
    usable &= ~visibility.hidden_of(disparity, usable, JUMP_PX)
    usable &= _textured(refined) & _alike(left, refined)
    beside = _beside_jump(disparity) & usable
    evidence = visibility.evidence(left, refined.right, disparity, matched, beside, *_weights())
    usable &= evidence > F(refined.noise) * (EVIDENCE_PER_SIGMA * sigma_px - EVIDENCE_OFFSET)
    return _without_specks(disparity, usable)


def _beside_jump(disparity: FloatImage) -> Mask:
    square = np.ones((3, 3), np.uint8)
    jump = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F) > JUMP_RANGE_PX
    wide = np.ones((2 * visibility.BESIDE + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(jump.astype(np.uint8), wide)).astype(np.bool_)


def _weights() -> tuple[FloatImage, FloatImage]:
    """Return the weights of neighbours by difference of grey level and by place."""
    place = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1, dtype=np.float64)
    distance = np.hypot(place[:, None], place[None])
    return np.exp(-np.arange(256.0) / ALIKE_GREY).astype(F), np.exp(-distance / NEAR_PX).astype(F)


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
