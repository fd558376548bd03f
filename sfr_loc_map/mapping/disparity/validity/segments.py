"""Detection of segments of similar disparity that are noise and not surfaces.

In textureless regions (sky, shadow, a flat wall) the matcher fits noise that is similar in both images by chance, and
its smoothness term spreads such matches over a segment of constant disparity. The residuals of such a segment do not
exceed the noise, and the segment can have the size and the sigma of a stone. However, the images have no common content
there: their grey level gradients are barely correlated over the segment. Segments of noise are small. A large surface
with textureless parts is a single segment and remains valid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage, IntArray, Mask
from sfr_loc_map.jit import jit, jit_inline, jit_rows
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX, DisparityScene

STEPS_PER_PX = F(16.0)
"""Refined disparities of neighbours are compared in steps of 1/16 pixel, which is the resolution of the matcher except
in wide images."""
MAX_SMALL_SEGMENT_PIXELS = 40
"""Segments of up to this many pixels are invalid, because no surrounding pixel agrees with them."""
MAX_MEDIUM_SEGMENT_PIXELS = 2000  #: Larger segments are not noise.
MIN_CORRELATION = 0.7
"""Minimum correlation of the gradients of a segment of medium size. White noise of 0.5 to 5 grey levels reached 0.47,
and noise blurred by one pixel reached 0.64. Surfaces in real and rendered images had 0.77 to 1."""
MIN_GRADIENT_POWER = 1e-12  #: Lower bound of the product of the gradients' sums of squares, a divisor.


class Segments(NamedTuple):
    """Connected regions of similar disparity."""

    label: NDArray[np.int32]  #: `(H, W)`, label of each pixel's segment, from 0; -1 for invalid pixels.
    pixels: IntArray  #: `(S,)`, number of pixels of each segment.


def not_a_surface_mask(scene: DisparityScene) -> Mask:
    """Return the mask of the pixels `(H, W)` that are invalid, or in a segment that is too small or consists of noise.

    Segments consist of valid pixels.
    """
    steps = np.rint(scene.disparity * STEPS_PER_PX).astype(np.int32)
    steps[~scene.valid] = -1
    segments = _find_segments(steps, np.int32(STEPS_PER_PX * SURFACE_JUMP_PX))
    segment_pixels = _segment_pixels(segments)
    kept: Mask = segment_pixels > MAX_MEDIUM_SEGMENT_PIXELS
    flat_indices = np.flatnonzero((segment_pixels > MAX_SMALL_SEGMENT_PIXELS) & ~kept)
    labels = segments.label.flat[flat_indices]
    correlation = _gradient_correlation(scene, flat_indices, labels, len(segments.pixels))
    kept.flat[flat_indices] = correlation >= MIN_CORRELATION
    return ~kept


@jit_inline
def _root(parent: NDArray[np.int32], i: int) -> np.int32:
    """Return the root of the segment of pixel `i`, and shorten the path from the pixel to the root."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return np.int32(i)


@jit_inline
def _same_segment(a: np.int32, b: np.int32, max_difference: np.int32) -> bool:
    """Return whether two neighbours belong to one segment, from their disparities in steps."""
    return bool(a >= 0 and b >= 0 and abs(a - b) <= max_difference)


@jit
def _find_segments(steps: NDArray[np.int32], max_difference: np.int32) -> Segments:
    """Return the segments of disparities in integer steps; negative steps are invalid.

    Pixels that are adjacent in a row or in a column belong to one segment if their disparities differ by at most
    `max_difference` steps. The segments are found by union-find over the rows. The first pixel of each segment is its
    root, and labels are in the order of the roots.
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
            beside = x > 0 and _same_segment(row[x], row[x - 1], max_difference)
            if not beside:
                root = np.int32(i if row[x] >= 0 else -1)
            parent[i] = root
            over = y > 0 and _same_segment(row[x], above[x], max_difference)
            # The pixel is already joined if the previous pixel joined the same segment above.
            if over and not (beside and joined_above and _same_segment(above[x], above[x - 1], max_difference)):
                other = _root(parent, i - cols)
                first = min(root, other)
                parent[max(root, other)] = first
                root = first
                parent[i] = root
            joined_above = over
    label = np.empty_like(parent)
    pixels = np.zeros(len(parent), np.int64)
    count = 0
    for i in range(len(parent)):
        if parent[i] < 0:
            label[i] = -1
            continue
        if parent[i] == i:
            label[i] = count
            count += 1
        else:
            label[i] = label[_root(parent, i)]
        pixels[label[i]] += 1
    return Segments(label.reshape(steps.shape), pixels[:count].copy())


@jit_rows
def _segment_pixels(segments: Segments) -> NDArray[np.int32]:
    """Return the number of pixels of the segment of each pixel `(H, W)`; 0 for invalid pixels."""
    label = segments.label
    rows, cols = label.shape
    out = np.zeros((rows, cols), np.int32)
    for y in prange(rows):
        for x in range(cols):
            if label[y, x] >= 0:
                out[y, x] = segments.pixels[label[y, x]]
    return out


def _gradient_correlation(
    scene: DisparityScene, flat_indices: IntArray, labels: NDArray[np.int32], label_count: int
) -> FloatArray:
    """Return the correlation of the grey level gradients of both images over the segment of each pixel `(N,)`.

    The correlation is `sum g_l . g_r / sqrt(sum |g_l|^2 sum |g_r|^2)` with central differences along both axes. The
    gradient g_r of the right image is evaluated at column `u - d` of each pixel. The matcher selects similar right
    columns, which biases the differences along rows but not those along columns.

    Pixels are given by flat indices and by the labels of their segments, from 0 to `label_count - 1`.
    """
    left = scene.left
    right = scene.right
    rows, cols = left.shape
    y = flat_indices // cols
    x = flat_indices % cols
    column = x.astype(F) - scene.disparity[y, x]
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
    segment = labels[inside]
    common = np.bincount(segment, left_x * right_x + left_y * right_y, label_count)
    power_left = np.bincount(segment, left_x * left_x + left_y * left_y, label_count)
    power_right = np.bincount(segment, right_x * right_x + right_y * right_y, label_count)
    correlation = common / np.sqrt(np.maximum(power_left * power_right, MIN_GRADIENT_POWER))
    return np.asarray(correlation[labels])
