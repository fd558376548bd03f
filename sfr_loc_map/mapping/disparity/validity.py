"""Which disparities are valid: visible to both cameras, textured, alike in both images, on the right surface."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.median import finite_median
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.edge_evidence import NEIGHBOURHOOD, Scene, support_weights
from sfr_loc_map.mapping.disparity.edge_network import wrong_surface_log_odds
from sfr_loc_map.mapping.disparity.filters import box_mean, depth_ratio
from sfr_loc_map.mapping.disparity.occlusion import occlusion_mask
from sfr_loc_map.mapping.disparity.segments import valid_segments
from sfr_loc_map.mapping.disparity.uncertainty import NOISE_INFORMATION
from sfr_loc_map.mapping.disparity.variational_refinement import JUMP_PX, RefinedDisparity
from sfr_loc_map.mapping.robust import MAD_TO_SIGMA

F = np.float32

MIN_TEXTURE = F(0.06)
"""Mean information of a cell beyond that of noise below which a region counts as textureless."""
TEXTURE_CELLS = 13
MAX_CHI2_PER_DOF = F(4.0)
"""Mean square of normalised residuals in 5 x 5 pixels beyond which a match is doubtful."""
MAX_SQUARE = F(36.0)
"""Squares of single normalised residuals are clipped to this, unknown ones take it."""
MAX_CONTRAST_SHARE = F(0.7)
"""Share of the image's own variance that a doubtful match's residuals must reach to be wrong; 2 is no correlation."""
MAX_CHANGE_PX = 1.5
"""Refinement may change a disparity by this, or by five times the typical change if that is more."""
JUMP_RANGE_PX = F(1.5)
"""Disparities of 3 x 3 pixels that span more are a jump; pixels up to `NEIGHBOURHOOD` from it are beside it."""
MAX_LOG_ODDS = F(1.5)
"""A pixel beside a jump is dropped if its log odds of being on the wrong surface exceed this, less the logarithm of the
squared ratio of its depth to that of the nearest surface around: by so much its error in metres is larger.
They are learnt with weights by the size of the error in pixels."""
MAX_SLOPE = F(0.7)
"""Pixels of disparity for each pixel along the row. A ramp of 1 lies on one ray of the right camera: what is steep
joins two surfaces across a part that one of the cameras does not see."""


def valid_mask(
    left: FloatImage, refined: RefinedDisparity, initial_px: FloatImage, sigma_px: FloatImage, contrast: FloatImage
) -> Mask:
    """Tell which pixels `(H, W)` have a valid disparity.

    Invalid are pixels that the matcher left out, that refinement moved far, that are occluded in the right image, have
    no texture, differ between the images, are likely on the wrong side of an edge (`edge_network`), or belong to a
    segment that is small or has no content in common (`segments`). `contrast` is the
    `local_variance` of the left image.
    """
    disparity = refined.disparity_px
    valid = locally_valid(refined, initial_px, contrast)
    chosen = np.flatnonzero(beside_jump(disparity) & valid)
    scene = Scene(left, refined.right, disparity, np.isfinite(initial_px), sigma_px, *support_weights())
    behind = np.log(depth_ratio(disparity, NEIGHBOURHOOD).flat[chosen])
    log_odds = wrong_surface_log_odds(scene, chosen) + F(2.0) * behind
    valid.flat[chosen[log_odds > MAX_LOG_ODDS]] = False
    return valid_segments(left, refined.right, disparity, valid)


def locally_valid(refined: RefinedDisparity, initial_px: FloatImage, contrast: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` pass the tests that need no decision between two surfaces."""
    disparity = refined.disparity_px
    valid = changed_little(disparity, initial_px)
    if not valid.any():
        return valid
    occluded = occlusion_mask(disparity, valid, JUMP_PX)
    texture = box_mean(refined.information, TEXTURE_CELLS)
    chi2_per_dof = box_mean(_clipped_squares(refined.normalised_residual), 5)
    alike = Likeness(texture, chi2_per_dof, contrast, F(refined.noise * refined.noise))
    return _passing(disparity, valid, occluded, alike)


def changed_little(disparity: FloatImage, initial_px: FloatImage) -> Mask:
    """Tell which matched pixels `(H, W)` refinement did not move far, measured by the typical change."""
    share = 5.0 * MAD_TO_SIGMA
    valid, counts = _within(disparity, initial_px, F(MAX_CHANGE_PX), F(0.999 * MAX_CHANGE_PX / share))
    if 2 * counts[:, 0].sum() > counts[:, 1].sum():  # the median of the changes is small, and need not be known
        return valid
    change = np.abs(disparity - initial_px)
    return np.asarray(change <= max(MAX_CHANGE_PX, share * finite_median(change)))


@jit_rows
def _within(
    disparity: FloatImage, initial_px: FloatImage, limit: np.float32, small: np.float32
) -> tuple[Mask, NDArray[np.int64]]:
    """Tell which changes `(H, W)` are within a limit; count in each row `(H, 2)` the small ones and those known."""
    rows, cols = disparity.shape
    out, counts = np.empty((rows, cols), np.bool_), np.zeros((rows, 2), np.int64)
    for y in prange(rows):
        few, known = 0, 0
        for x in range(cols):
            change = abs(disparity[y, x] - initial_px[y, x])
            out[y, x] = change <= limit
            few += change <= small
            known += change == change
        counts[y, 0], counts[y, 1] = few, known
    return out, counts


@jit_rows
def _clipped_squares(residual: FloatImage) -> FloatImage:
    """Return the squares of residuals `(H, W)`, at most `MAX_SQUARE`, which unknown ones take."""
    rows, cols = residual.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            square = residual[y, x] * residual[y, x]
            out[y, x] = square if square < MAX_SQUARE else MAX_SQUARE
    return out


class Likeness(NamedTuple):
    """How alike the images are.

    Attributes:
        texture: `(H/2, W/2)`, mean information around each cell.
        chi2_per_dof: `(H, W)`, mean square of the normalised residuals around each pixel.
        contrast: `(H, W)`, variance of the grey levels around each pixel of the left image.
        variance: Of a residual.
    """

    texture: FloatImage
    chi2_per_dof: FloatImage
    contrast: FloatImage
    variance: np.float32


@jit_rows
def _passing(disparity: FloatImage, valid: Mask, occluded: Mask, alike: Likeness) -> Mask:
    """Tell which valid pixels `(H, W)` are not occluded, have texture, are alike in both images and lie on no ramp.

    Residuals must be no larger than their noise explains, or small against the image's contrast.
    """
    rows, cols = disparity.shape
    texture, chi2_per_dof, contrast = alike.texture, alike.chi2_per_dof, alike.contrast
    out = np.empty((rows, cols), np.bool_)
    for y in prange(rows):
        row, steep, informed, kept = disparity[y], np.zeros(cols + 2, np.bool_), texture[y // 2], out[y]
        before, after, inner = row[: cols - 2], row[2:], steep[2:cols]
        for x in range(len(before)):
            inner[x] = abs(F(0.5) * (after[x] - before[x])) > MAX_SLOPE
        steep[1] = abs(F(0.5) * (row[1] - row[0])) > MAX_SLOPE
        steep[cols] = abs(F(0.5) * (row[cols - 1] - row[cols - 2])) > MAX_SLOPE
        square, spread = chi2_per_dof[y], contrast[y]
        for x in range(cols):
            differs = square[x] * alike.variance > MAX_CONTRAST_SHARE * spread[x]
            kept[x] = not ((square[x] > MAX_CHI2_PER_DOF) & differs)
        here, after_here = steep[1:], steep[2:]
        for x in range(cols):
            kept[x] &= valid[y, x] & (not occluded[y, x]) & (not (steep[x] | here[x] | after_here[x]))
        for x in range(cols):
            kept[x] &= informed[x // 2] > NOISE_INFORMATION + MIN_TEXTURE
    return out


def beside_jump(disparity: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` are at or near a jump of disparity."""
    square = np.ones((3, 3), np.uint8)
    jump = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F) > JUMP_RANGE_PX
    wide = np.ones((2 * NEIGHBOURHOOD + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(jump.astype(np.uint8), wide)).astype(np.bool_)
