"""Which disparities are valid: visible to both cameras, consistent in both images, and on the correct surface.

Where there is no texture (sky, shadow, a flat wall) the matcher fits noise that happens to be similar in both images,
and its smoothness spreads that match over a segment of constant disparity. Such a segment passes tests of its
residuals, which are noise of the stated size, and neither its size nor its stated sigma distinguishes it from a stone.
It has no common content: the grey level gradients of both images are barely correlated over it. Segments of noise are
small. A large surface with textureless parts is judged as one segment and stays valid.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, IntArray, Mask, median
from sfr_loc_map.jit import jit, jit_inline, jit_rows
from sfr_loc_map.mapping.disparity.edge_evidence import SMALL_JUMP_PX, SURFACE_RADIUS, EdgeScene, wrong_surface_log_odds
from sfr_loc_map.mapping.disparity.filters import SURFACE_JUMP_PX, box_mean, depth_ratio, within
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity
from sfr_loc_map.mapping.robust_statistics import mad_sigma

F = np.float32

MAX_CHI2_PER_DOF = F(4.0)  #: Mean squared normalised residual of a window above which a match is suspicious.
CHI2_WINDOW = 5  #: Side of that window, pixels.
MAX_CHI2 = F(36.0)  #: Single squared residuals are clipped to this; unknown ones have this value.
MAX_CONTRAST_RATIO = F(0.7)
"""Squared residuals over the variance of the image above which a suspicious match is invalid; uncorrelated images have
a ratio of 2."""
MAX_CHANGE_PX = 1.5  #: Change by refinement that is always accepted, pixels.
MAX_CHANGE_SIGMAS = 5.0  #: Larger changes are accepted up to this many standard deviations of all changes.
CHANGE_STRIDE = 4  #: Every fourth pixel of every fourth row measures the typical change.
MAX_LOG_ODDS = F(3.3)
"""Log odds of being on the wrong surface above which a pixel beside a jump is invalid. The threshold decreases with the
squared ratio of the pixel's depth to that of the nearest surface around it, because its error in metres is larger by
that ratio. It also decreases with the pair's typical sigma: in precise maps a single outlier dominates the error.
Chosen on rendered ground and two real pairs: docs/decisions/0003."""
SIGMA_STRIDE = 16  #: Every sixteenth valid pixel measures the pair's typical sigma.
MAX_SLOPE = F(0.7)
"""Slope along the row above which a pixel is on a ramp, pixels per pixel. A slope of 1 is parallel to a ray of the
right camera: a steep ramp joins two surfaces across an occluded region."""
STEPS_PER_PX = F(16.0)  #: Disparities of neighbours are compared in whole sixteenths of a pixel.
MIN_SEGMENT_PIXELS = 40  #: Segments of this many pixels or fewer are invalid: nothing around agrees with them.
LARGE_SEGMENT_PIXELS = 2000  #: Larger segments are not noise: the largest one in 100 images of noise had 740 pixels.
MIN_CORRELATION = 0.7
"""Smallest correlation of the gradients of a segment that is not large. White noise of 0.5 to 5 grey levels reached
0.47, noise blurred by one pixel 0.64. Surfaces in real and rendered images had 0.77 to 1."""
MIN_GRADIENT_POWER = 1e-12  #: Smallest product of the gradients' sums of squares, which must not be 0.


class Segments(NamedTuple):
    """Connected regions of similar disparity."""

    number: NDArray[np.int32]  #: `(H, W)`, number of each pixel's segment; -1 for invalid pixels.
    pixels: IntArray  #: `(S,)`, number of pixels of each segment.


def valid_mask(
    left: FloatImage, refined: RefinedDisparity, matched_px: FloatImage, sigma_px: FloatImage, variance: FloatImage
) -> Mask:
    """Return which pixels `(H, W)` have a valid disparity.

    Invalid are pixels that the matcher left unmatched, that refinement changed too much, that are occluded in the right
    image, that differ between the images, that are on a ramp between two surfaces, that are likely on the wrong side of
    an edge, or that belong to a segment that is small or has no common content. `variance` is the `local_variance` of
    the left image.
    """
    disparity = refined.disparity_px
    valid = locally_valid(refined, matched_px, variance) & ~ramp_mask(disparity)
    valid = valid_segments(left, refined.right, disparity, valid)
    scene = EdgeScene(left, refined.right, disparity, np.isfinite(matched_px), valid, sigma_px)
    valid = valid & ~wrong_surface_mask(scene)
    return valid_segments(left, refined.right, disparity, valid)  # the rest of a segment may be small


def locally_valid(refined: RefinedDisparity, matched_px: FloatImage, variance: FloatImage) -> Mask:
    """Return which pixels `(H, W)` pass the tests of change, occlusion and residual."""
    change_px = np.abs(refined.disparity_px - matched_px)
    sample = change_px[::CHANGE_STRIDE, ::CHANGE_STRIDE]
    change_sigma_px = mad_sigma(sample[~np.isnan(sample)])
    valid: Mask = change_px <= max(MAX_CHANGE_PX, MAX_CHANGE_SIGMAS * change_sigma_px)
    if not valid.any():
        return valid
    occluded = occlusion_mask(refined.disparity_px, valid, SURFACE_JUMP_PX)
    return valid & ~occluded & ~mismatch_mask(refined, variance)


def mismatch_mask(refined: RefinedDisparity, variance: FloatImage) -> Mask:
    """Return which pixels `(H, W)` have residuals larger than their noise and similar to the image's contrast."""
    chi2_per_dof = box_mean(np.fmin(np.square(refined.normalised_residual), MAX_CHI2), CHI2_WINDOW)
    squared_residual = chi2_per_dof * F(refined.noise_grey * refined.noise_grey)
    mismatch: Mask = (chi2_per_dof > MAX_CHI2_PER_DOF) & (squared_residual > MAX_CONTRAST_RATIO * variance)
    return mismatch


def ramp_mask(disparity: FloatImage) -> Mask:
    """Return which pixels `(H, W)` are on a ramp that joins two surfaces, or beside one along the row."""
    taps = np.array([[-0.5, 0.0, 0.5]], F)
    slope = cv2.filter2D(disparity, -1, taps, borderType=cv2.BORDER_REPLICATE)
    steep = (np.abs(slope) > MAX_SLOPE).astype(np.uint8)
    return np.asarray(cv2.dilate(steep, np.ones((1, 3), np.uint8))) > 0


def wrong_surface_mask(scene: EdgeScene) -> Mask:
    """Return which valid pixels `(H, W)` beside a jump are likely on the wrong surface."""
    wrong = np.zeros(scene.valid.shape, np.bool_)
    flat_indices = np.flatnonzero(beside_jump(scene.disparity) & scene.valid)
    if not len(flat_indices):
        return wrong
    log_depth_ratio = np.log(depth_ratio(scene.disparity, SURFACE_RADIUS).flat[flat_indices])
    log_odds = wrong_surface_log_odds(scene, flat_indices) + F(2.0) * log_depth_ratio
    typical_sigma_px = median(scene.sigma[scene.valid][::SIGMA_STRIDE])
    wrong.flat[flat_indices] = log_odds > MAX_LOG_ODDS + np.log(typical_sigma_px)
    return wrong


@jit_rows
def occlusion_mask(disparity: FloatImage, valid: Mask, jump: np.float32) -> Mask:
    """Return which pixels `(H, W)` are occluded in the right image.

    Their corresponding pixel is outside the right image, or a valid surface nearer by more than `jump` covers it.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        nearest = np.full(cols, F(-1.0))
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            if valid[y, x] and 0 <= u < cols:
                nearest[u] = max(nearest[u], disparity[y, x])
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            out[y, x] = not (0 <= u < cols) or nearest[u] > disparity[y, x] + jump
    return out


def beside_jump(disparity: FloatImage) -> Mask:
    """Return which pixels `(H, W)` are at or near a jump of disparity."""
    square = np.ones((3, 3), np.uint8)
    jump = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F) > SMALL_JUMP_PX
    return within(jump, SURFACE_RADIUS)


def valid_segments(left: FloatImage, right: FloatImage, disparity: FloatImage, valid: Mask) -> Mask:
    """Return the valid pixels `(H, W)` without segments that are too small or consist of noise."""
    steps = np.rint(disparity * STEPS_PER_PX).astype(np.int32)
    steps[~valid] = -1
    number, pixels = find_segments(steps, np.int32(STEPS_PER_PX * SURFACE_JUMP_PX))
    is_large = np.append(pixels > LARGE_SEGMENT_PIXELS, np.False_)  # the last element is for invalid pixels
    is_medium = np.append((pixels > MIN_SEGMENT_PIXELS) & (pixels <= LARGE_SEGMENT_PIXELS), np.False_)
    kept: Mask = is_large[number]
    flat_indices = np.flatnonzero(is_medium[number])
    correlation = gradient_correlation(left, right, disparity, flat_indices, number.flat[flat_indices], len(pixels))
    kept.flat[flat_indices] = correlation >= MIN_CORRELATION
    return kept


@jit_inline
def _root(parent: NDArray[np.int32], i: int) -> np.int32:
    """Return the first pixel of a segment, and shorten the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return np.int32(i)


@jit_inline
def _same_segment(a: np.int32, b: np.int32, largest: np.int32) -> bool:
    """Return whether two neighbours belong to one segment."""
    return bool(a >= 0 and b >= 0 and abs(a - b) <= largest)


@jit
def find_segments(steps: NDArray[np.int32], largest: np.int32) -> Segments:
    """Return the segments of disparities in whole steps; negative ones are invalid.

    Neighbours above, below or beside that differ by at most `largest` steps belong to one segment. The segments are
    found by union-find over the rows. The first pixel of each segment is its root, and segments are numbered in the
    order of their roots.
    """
    rows, cols = steps.shape
    parent = np.empty(rows * cols, np.int32)
    for y in range(rows):
        row = steps[y]
        above = steps[max(y - 1, 0)]
        root = np.int32(-1)
        joined_above = False
        for x in range(cols):
            i = y * cols + x
            beside = x > 0 and _same_segment(row[x], row[x - 1], largest)
            if not beside:
                root = np.int32(i if row[x] >= 0 else -1)
            parent[i] = root
            over = y > 0 and _same_segment(row[x], above[x], largest)
            # Already joined if the previous pixel joined the same segment above.
            if over and not (beside and joined_above and _same_segment(above[x], above[x - 1], largest)):
                other = _root(parent, i - cols)
                first = min(root, other)
                parent[max(root, other)] = first
                root = first
                parent[i] = root
            joined_above = over
    number = np.empty_like(parent)
    pixels = np.zeros(len(parent), np.int64)
    count = 0
    for i in range(len(parent)):
        if parent[i] < 0:
            number[i] = -1
            continue
        if parent[i] == i:
            number[i] = count
            count += 1
        else:
            number[i] = number[_root(parent, i)]
        pixels[number[i]] += 1
    return Segments(number.reshape(steps.shape), pixels[:count].copy())


def gradient_correlation(
    left: FloatImage,
    right: FloatImage,
    disparity: FloatImage,
    flat_indices: IntArray,
    number: NDArray[np.int32],
    count: int,
) -> FloatArray:
    """Return the correlation of the grey level gradients of both images over the segment of each pixel `(N,)`.

    The correlation is `sum g_l . g_r / sqrt(sum |g_l|^2 sum |g_r|^2)` with central differences along both axes, those
    of the right image at `u - d` of each pixel. The differences along columns are not affected by the matcher, which
    has chosen columns that look similar.

    Pixels are given by indices of the flat image and by the number of their segment out of `count`.
    """
    rows, cols = left.shape
    y = flat_indices // cols
    x = flat_indices % cols
    column = x.astype(F) - disparity[y, x]
    k = np.floor(column).astype(np.intp)
    inside = (k >= 1) & (k <= cols - 3) & (y > 0) & (y < rows - 1) & (x > 0) & (x < cols - 1)
    fraction = (column - k.astype(F))[inside]
    y = y[inside]
    x = x[inside]
    k = k[inside]

    def right_at(y: NDArray[np.intp], k: NDArray[np.intp]) -> FloatImage:
        """Return the right image, interpolated along the row."""
        return np.asarray(right[y, k] + fraction * (right[y, k + 1] - right[y, k]))

    left_x = left[y, x + 1] - left[y, x - 1]
    left_y = left[y + 1, x] - left[y - 1, x]
    right_x = right_at(y, k + 1) - right_at(y, k - 1)
    right_y = right_at(y + 1, k) - right_at(y - 1, k)
    segment = number[inside]
    common = np.bincount(segment, left_x * right_x + left_y * right_y, count)
    power_left = np.bincount(segment, left_x * left_x + left_y * left_y, count)
    power_right = np.bincount(segment, right_x * right_x + right_y * right_y, count)
    correlation = common / np.sqrt(np.maximum(power_left * power_right, MIN_GRADIENT_POWER))
    return np.asarray(correlation[number])
