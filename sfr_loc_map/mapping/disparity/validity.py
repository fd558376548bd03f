"""Which disparities are valid: visible to both cameras, alike in both images, on the right surface.

Where there is no texture (sky, shadow, a flat wall) the matcher finds noise that happens to be alike in both images,
and its smoothness spreads that over a segment of one disparity. Such a segment passes tests of its residuals, which
are noise as stated, and neither its size nor its stated sigma tell it from a stone. What it lacks is content: the grey
level gradients of both images are barely correlated over it. Segments of noise do not grow large; a large surface that
is textureless in parts is judged as one and stays.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, IntArray, Mask, median
from sfr_loc_map.jit import jit, jit_inline, jit_rows
from sfr_loc_map.mapping.disparity.edge_evidence import ALIKE_PX, NEIGHBOURHOOD, EdgeScene, wrong_surface_log_odds
from sfr_loc_map.mapping.disparity.filters import MAD_TO_SIGMA, box_mean, depth_ratio, within
from sfr_loc_map.mapping.disparity.variational_refinement import JUMP_PX, RefinedDisparity

F = np.float32

MAX_CHI2_PER_DOF = F(4.0)  #: Mean square of normalised residuals in 5 x 5 pixels beyond which a match is doubtful.
MAX_SQUARE = F(36.0)  #: Squares of single normalised residuals are clipped to this, unknown ones take it.
MAX_CONTRAST_SHARE = F(0.7)
"""Share of the image's own variance that a doubtful match's residuals must reach to be wrong; 2 is no correlation."""
MAX_CHANGE_PX = 1.5
"""Refinement may change a disparity by this, or by five times the typical change if that is more."""
MAX_LOG_ODDS = F(3.3)
"""A pixel beside a jump is dropped if its log odds of being on the wrong surface exceed this, less the logarithm of the
squared ratio of its depth to that of the nearest surface around, plus that of the pair's typical sigma in pixels: by so
much its error in metres is larger, and the more exact the others are, the more of the error of a map is one that is
wrong. The log odds are learnt with weights by the size of the error in pixels."""
MAX_SLOPE = F(0.7)
"""Pixels of disparity for each pixel along the row. A ramp of 1 lies on one ray of the right camera: what is steep
joins two surfaces across a part that one of the cameras does not see."""
STEPS = F(16.0)
"""Disparities are compared in whole sixteenths of a pixel; neighbours of a segment differ by at most one pixel."""
MIN_PIXELS = 40  #: Segments of so many pixels or fewer agree with nothing around them.
LARGE_PIXELS = 2000
"""Segments of more pixels are not of noise: in 100 images with a sky of noise the largest had 740."""
MIN_CORRELATION = 0.7
"""Correlation of the gradients of a smaller segment. White noise of 0.5 to 5 grey levels reached 0.47, noise blurred by
one pixel 0.64. Content of twice the noise's power gives 0.67; surfaces in real and rendered images had 0.77 to 1."""


def valid_mask(
    left: FloatImage, refined: RefinedDisparity, initial_px: FloatImage, sigma_px: FloatImage, contrast: FloatImage
) -> Mask:
    """Tell which pixels `(H, W)` have a valid disparity.

    Invalid are pixels that the matcher left out, that refinement moved far, that are occluded in the right image,
    differ between the images, join two surfaces, are likely on the wrong side of an edge (`edge_evidence`), or belong
    to a segment that is small or has no content in common. `contrast` is the `local_variance` of the left image.
    """
    disparity = refined.disparity_px
    valid = locally_valid(refined, initial_px, contrast) & ~steep(disparity)
    valid = valid_segments(left, refined.right, disparity, valid)
    chosen = np.flatnonzero(beside_jump(disparity) & valid)
    if not len(chosen):
        return valid
    scene = EdgeScene(left, refined.right, disparity, np.isfinite(initial_px), valid, sigma_px)
    behind = np.log(depth_ratio(disparity, NEIGHBOURHOOD).flat[chosen])
    log_odds = wrong_surface_log_odds(scene, chosen) + F(2.0) * behind
    valid.flat[chosen[log_odds > MAX_LOG_ODDS + np.log(median(sigma_px[valid][::16]))]] = False
    return valid_segments(left, refined.right, disparity, valid)  # what is left between jumps may be small


def locally_valid(refined: RefinedDisparity, initial_px: FloatImage, contrast: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` pass the tests that need no decision between two surfaces.

    Residuals must be no larger than their noise explains, or small against the image's contrast.
    """
    disparity = refined.disparity_px
    change = np.abs(disparity - initial_px)
    sample = change[::4, ::4]
    valid: Mask = change <= max(MAX_CHANGE_PX, 5.0 * MAD_TO_SIGMA * median(sample[~np.isnan(sample)]))
    if not valid.any():
        return valid
    valid &= ~occlusion_mask(disparity, valid, JUMP_PX)
    squares = np.fmin(np.square(refined.normalised_residual), MAX_SQUARE)
    chi2_per_dof = box_mean(squares, 5)
    valid &= ~(
        (chi2_per_dof > MAX_CHI2_PER_DOF)
        & (chi2_per_dof * F(refined.noise * refined.noise) > MAX_CONTRAST_SHARE * contrast)
    )
    return valid


def steep(disparity: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` are on a ramp that joins two surfaces, or beside it along the row."""
    slope = cv2.filter2D(disparity, -1, np.array([[-0.5, 0.0, 0.5]], F), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.dilate((np.abs(slope) > MAX_SLOPE).astype(np.uint8), np.ones((1, 3), np.uint8))) > 0


@jit_rows
def occlusion_mask(disparity: FloatImage, valid: Mask, jump: np.float32) -> Mask:
    """Tell which pixels `(H, W)` the right camera does not see.

    Their corresponding pixel lies outside the right image or behind a valid surface nearer by more than `jump`.
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
    """Tell which pixels `(H, W)` are at or near a jump of disparity."""
    square = np.ones((3, 3), np.uint8)
    jump = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F) > ALIKE_PX
    return within(jump, NEIGHBOURHOOD)


def valid_segments(left: FloatImage, right: FloatImage, disparity: FloatImage, valid: Mask) -> Mask:
    """Return the valid pixels `(H, W)` without those of segments that are too small or of noise."""
    steps = np.rint(disparity * STEPS).astype(np.int32)
    steps[~valid] = -1
    number, pixels = find_segments(steps, np.int32(STEPS))
    size = np.append(pixels > MIN_PIXELS, np.False_).astype(np.uint8)  # the last: no segment
    size[:-1] += pixels > LARGE_PIXELS
    sizes = size[number]
    kept: Mask = sizes == 2
    chosen = np.flatnonzero(sizes == 1)
    correlation = gradient_correlation(left, right, disparity, chosen, number.flat[chosen], len(size))
    kept.flat[chosen] = correlation >= MIN_CORRELATION
    return kept


@jit_inline
def _root(parent: NDArray[np.int32], i: int) -> np.int32:
    """Return the first pixel of a segment, and shorten the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return np.int32(i)


@jit_inline
def _alike(a: np.int32, b: np.int32, largest: np.int32) -> bool:
    """Tell whether two neighbours belong to one segment."""
    return bool(a >= 0 and b >= 0 and abs(a - b) <= largest)


@jit
def find_segments(steps: NDArray[np.int32], largest: np.int32) -> tuple[NDArray[np.int32], IntArray]:
    """Return the number of each pixel's segment `(H, W)`, -1 for none, and the pixels of each segment `(S,)`.

    By union-find over the rows; the first pixel of each segment is its root, and segments are in the order of these.
    Disparities are in whole steps, negative for none; neighbours above, below or beside that differ by at most
    `largest` belong to one segment.
    """
    rows, cols = steps.shape
    parent = np.empty(rows * cols, np.int32)
    for y in range(rows):
        row, above = steps[y], steps[max(y - 1, 0)]
        root, met = np.int32(-1), False
        for x in range(cols):
            i = y * cols + x
            beside = x > 0 and _alike(row[x], row[x - 1], largest)
            if not beside:
                root = np.int32(i if row[x] >= 0 else -1)
            parent[i] = root
            over = y > 0 and _alike(row[x], above[x], largest)
            # Nothing is new where the pixel before met the same segment above.
            if over and not (beside and met and _alike(above[x], above[x - 1], largest)):
                other = _root(parent, i - cols)
                first, last = min(root, other), max(root, other)
                parent[last] = first
                root = first
                parent[i] = root
            met = over
    number, pixels, count = np.empty_like(parent), np.zeros(len(parent), np.int64), 0
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
    return number.reshape(steps.shape), pixels[:count].copy()


def gradient_correlation(
    left: FloatImage, right: FloatImage, disparity: FloatImage, chosen: IntArray, number: NDArray[np.int32], count: int
) -> FloatArray:
    """Return the correlation of the grey level gradients of both images over the segment of each chosen pixel `(N,)`.

    It is `sum g_l . g_r / sqrt(sum |g_l|^2 sum |g_r|^2)` with central differences along both axes, those of the right
    image at `u - d` of each pixel. The rows count since the matcher chose the columns to be alike.

    Pixels are given by their places in the flat image and by which of so many segments they belong to.
    """
    rows, cols = left.shape
    y, x = chosen // cols, chosen % cols
    column = x.astype(F) - disparity[y, x]
    k = np.floor(column).astype(np.intp)
    inside = (k >= 1) & (k <= cols - 3) & (y > 0) & (y < rows - 1) & (x > 0) & (x < cols - 1)
    y, x, k, t = y[inside], x[inside], k[inside], (column - k.astype(F))[inside]

    def at(y: NDArray[np.intp], k: NDArray[np.intp]) -> FloatImage:
        return np.asarray(right[y, k] + t * (right[y, k + 1] - right[y, k]))

    left_x, left_y = left[y, x + 1] - left[y, x - 1], left[y + 1, x] - left[y - 1, x]
    right_x, right_y = at(y, k + 1) - at(y, k - 1), at(y + 1, k) - at(y - 1, k)
    products = (
        left_x * right_x + left_y * right_y,
        left_x * left_x + left_y * left_y,
        right_x * right_x + right_y * right_y,
    )
    common, of_left, of_right = (np.bincount(number[inside], values, count) for values in products)
    return np.asarray(common / np.sqrt(np.maximum(of_left * of_right, 1e-12)))[number]
