"""Segments of the disparity image: which are too small, and which are of noise that is alike by chance.

Where there is no texture (sky, shadow, a flat wall) the matcher finds noise that happens to be alike in both images,
and its smoothness spreads that over a segment of one disparity. Such a segment passes tests of its residuals, which
are noise as stated, and neither its size nor its stated sigma tell it from a stone. What it lacks is content: the grey
level gradients of both images are barely correlated over it. Segments of noise do not grow large; a large surface that
is textureless in parts is judged as one and stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, IntArray, Mask
from sfr_loc_map.jit import jit, jit_inline, jit_rows, jit_rows_inline

F = np.float32

STEPS = F(16.0)
"""Disparities are compared in whole sixteenths of a pixel; neighbours of a segment differ by at most one pixel."""
STRIP_ROWS = 64
"""Rows that are searched at once, before strips are joined."""
MIN_PIXELS = 80
"""Segments of so many pixels or fewer agree with nothing around them."""
LARGE_PIXELS = 2000
"""Segments of more pixels are not of noise: in 100 images with a sky of noise the largest had 740."""
MIN_CORRELATION = 0.7
"""Correlation of the gradients of a smaller segment. White noise of 0.5 to 5 grey levels reached 0.47, noise blurred by
one pixel 0.64. Content of twice the noise's power gives 0.67; surfaces in real and rendered images had 0.77 to 1."""


class Segments(NamedTuple):
    """Connected pixels of like disparity.

    Attributes:
        number: `(H, W)` int32 number of each pixel's segment, -1 for none.
        pixels: `(S,)` pixels of each segment.
    """

    number: NDArray[np.int32]
    pixels: IntArray


def valid_segments(left: FloatImage, right: FloatImage, disparity: FloatImage, valid: Mask) -> Mask:
    """Return the valid pixels `(H, W)` without those of segments that are too small or of noise.

    Args:
        left: `(H, W)` grey.
        right: `(H, W)` grey, corrected.
        disparity: `(H, W)`, pixels.
        valid: `(H, W)` pixels that may stay.
    """
    segments = find_segments(_steps(disparity, valid), np.int32(STEPS))
    tested = (segments.pixels > MIN_PIXELS) & (segments.pixels <= LARGE_PIXELS)
    correlation = gradient_correlation(left, right, disparity, segments, tested)
    kept = np.append((segments.pixels > LARGE_PIXELS) | (correlation >= MIN_CORRELATION), np.False_)
    return _of_segments(kept, segments.number)


@jit_rows
def _steps(disparity: FloatImage, valid: Mask) -> NDArray[np.int32]:
    """Return the disparities in whole steps `(H, W)`, negative where not valid."""
    rows, cols = disparity.shape
    out = np.empty((rows, cols), np.int32)
    for y in prange(rows):
        for x in range(cols):
            out[y, x] = np.int32(np.rint(disparity[y, x] * STEPS)) if valid[y, x] else np.int32(-1)
    return out


@jit_rows
def _of_segments(which: Mask, number: NDArray[np.int32]) -> Mask:
    """Return the pixels `(H, W)` of some of the segments `(S + 1,)`, the last of which stands for no segment."""
    rows, cols = number.shape
    out = np.empty((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            out[y, x] = which[number[y, x]]
    return out


@jit_rows_inline
def _root(parent: NDArray[np.int32], i: int) -> int:
    """Return the first pixel of a segment, and shorten the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def _numbered(parent: NDArray[np.int32], shape: tuple[int, int]) -> Segments:
    """Return the segments in the order of their first pixels; `parent` is -1 for no pixel."""
    number, count = np.empty_like(parent), 0
    pixels = np.zeros(len(parent), np.int64)
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
    return Segments(number.reshape(shape), pixels[:count].copy())


@jit_rows_inline
def _alike(a: np.int32, b: np.int32, largest: np.int32) -> bool:
    """Tell whether two neighbours belong to one segment."""
    return bool(a >= 0 and b >= 0 and abs(a - b) <= largest)


@jit_rows_inline
def _joined(parent: NDArray[np.int32], root: np.int32, i: int) -> np.int32:
    """Join the segment of a root with that of pixel i; return the root of both."""
    other = np.int32(_root(parent, i))
    first, last = min(root, other), max(root, other)
    parent[last] = first
    return first


@jit_rows
def _linked(steps: NDArray[np.int32], largest: np.int32) -> NDArray[np.int32]:
    """Return the parent of each pixel `(H W,)` among the segments of each strip of rows alone."""
    rows, cols = steps.shape
    parent = np.empty(rows * cols, np.int32)
    for strip in prange((rows + STRIP_ROWS - 1) // STRIP_ROWS):
        for y in range(STRIP_ROWS * strip, min(STRIP_ROWS * (strip + 1), rows)):
            row, above = steps[y], steps[max(y - 1, STRIP_ROWS * strip)]
            root, met = np.int32(-1), False
            for x in range(cols):
                i = y * cols + x
                beside = x > 0 and _alike(row[x], row[x - 1], largest)
                if not beside:
                    root = np.int32(i if row[x] >= 0 else -1)
                parent[i] = root
                over = y > STRIP_ROWS * strip and _alike(row[x], above[x], largest)
                # Nothing is new where the pixel before met the same segment above.
                if over and not (beside and met and _alike(above[x], above[x - 1], largest)):
                    root = _joined(parent, root, i - cols)
                    parent[i] = root
                met = over
    return parent


@jit
def _join_strips(steps: NDArray[np.int32], parent: NDArray[np.int32], largest: np.int32) -> None:
    """Join the segments of strips that touch."""
    rows, cols = steps.shape
    for y in range(STRIP_ROWS, rows, STRIP_ROWS):
        for x in range(cols):
            if _alike(steps[y, x], steps[y - 1, x], largest):
                i = y * cols + x
                _joined(parent, np.int32(_root(parent, i)), i - cols)


def find_segments(steps: NDArray[np.int32], largest: np.int32) -> Segments:
    """Return the segments, by union-find over the rows; the first pixel of each is the root.

    Args:
        steps: `(H, W)` disparity in whole steps, negative for none.
        largest: Difference of neighbours, above, below or beside, that belong to one segment.
    """
    parent = _linked(steps, largest)
    _join_strips(steps, parent, largest)
    return _numbered(parent, steps.shape)


@jit_inline
def _at(image: FloatImage, y: int, k: int, t: np.float32) -> np.float32:
    """Return the grey level of row y at the share t between columns k and k + 1."""
    value: np.float32 = image[y, k] + t * (image[y, k + 1] - image[y, k])
    return value


@jit
def gradient_correlation(
    left: FloatImage, right: FloatImage, disparity: FloatImage, segments: Segments, tested: Mask
) -> FloatArray:
    """Return the correlation of the grey level gradients of both images over each segment `(S,)`; 0 if not tested.

    It is `sum g_l . g_r / sqrt(sum |g_l|^2 sum |g_r|^2)` with central differences along both axes, those of the right
    image at `u - d` of each pixel. The rows count since the matcher chose the columns to be alike.

    Args:
        left: `(H, W)` grey.
        right: `(H, W)` grey, corrected.
        disparity: `(H, W)`, pixels.
        segments: Of that disparity.
        tested: `(S,)` which segments.
    """
    rows, cols = left.shape
    common, of_left, of_right = np.zeros(len(tested)), np.zeros(len(tested)), np.zeros(len(tested))
    for y in range(1, rows - 1):
        for x in range(1, cols - 1):
            n = segments.number[y, x]
            if n < 0 or not tested[n]:
                continue
            u = F(x) - disparity[y, x]
            k = int(np.floor(u))
            if k < 1 or k > cols - 3:
                continue
            t = u - F(k)
            left_x, left_y = left[y, x + 1] - left[y, x - 1], left[y + 1, x] - left[y - 1, x]
            right_x = _at(right, y, k + 1, t) - _at(right, y, k - 1, t)
            right_y = _at(right, y + 1, k, t) - _at(right, y - 1, k, t)
            common[n] += left_x * right_x + left_y * right_y
            of_left[n] += left_x * left_x + left_y * left_y
            of_right[n] += right_x * right_x + right_y * right_y
    return common / np.sqrt(np.maximum(of_left * of_right, 1e-12))
