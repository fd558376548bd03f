"""The disparity field on cells of 2 x 2 pixels, computed from an initial disparity and interpolated at pixels.

Images are padded, so that their cells can be grouped up to the coarsest grid of the refinement. Fields on cells
`(h, w)` cover the padded image, and disparities `(H, W)` cover the original image.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX

LEVELS = 3  #: Number of grids of the refinement, with cells of 2, 4 and 8 pixels.
WINDOW_CELLS = 9  #: Side of the window over which quantities of cells are averaged, cells.
MEAN_RADIUS_CELLS = 3  #: Half the side of the window of the edge-preserving mean, cells.
MEAN_TOLERANCES_PX = (F(1.5), F(0.7))
"""Tolerances of the first and the second mean, pixels: cells that differ by less are averaged. The second tolerance
preserves edges that the first mean reveals."""
NEAR_TAP = F(0.5625)
"""Bilinear weight `(3/4)^2` of a cell at each of its pixels. Pixels are a quarter of a cell from the cell's centre."""
SIDE_TAP = F(0.1875)  #: Bilinear weight `3/4 1/4` of the neighbours along the row and along the column.
CORNER_TAP = F(0.0625)  #: Bilinear weight `(1/4)^2` of the diagonal neighbour.


def padded(image: FloatImage) -> FloatImage:
    """Return the image with its last rows and columns repeated up to a multiple of the largest cell."""
    height, width = image.shape
    multiple = 2**LEVELS
    below = -height % multiple
    beside = -width % multiple
    return np.ascontiguousarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), F)


def cells_from_disparity(disparity_px: FloatImage) -> FloatImage:
    """Return the initial field on cells, defined everywhere, from a disparity `(H, W)` that is NaN where unmatched.

    Cells without a disparity take the disparity of the farther neighbour along the row. The field is then smoothed, but
    not across edges.
    """
    cells = _extended_from_farther(_cells_from_pixels(padded(disparity_px)))
    for tolerance_px in MEAN_TOLERANCES_PX:
        cells = _edge_preserving_mean(cells, MEAN_RADIUS_CELLS, tolerance_px)
    return cells


def disparity_from_cells(cells: FloatImage, shape: tuple[int, ...]) -> FloatImage:
    """Return the disparity of each pixel of an image `(H, W)`."""
    height, width = shape
    return np.ascontiguousarray(_pixels_from_cells(cells)[:height, :width])


@jit_rows
def _cells_from_pixels(disparity: FloatImage) -> FloatImage:
    """Return the mean disparity `(H/2, W/2)` of the nearest surface in each cell; NaN if all pixels are unknown."""
    rows = disparity.shape[0] // 2
    cols = disparity.shape[1] // 2
    cells = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            nearest = F(-1.0)
            for k in range(4):
                value = disparity[2 * i + k // 2, 2 * j + k % 2]
                if not np.isnan(value):
                    nearest = max(nearest, value)
            total = F(0.0)
            count = F(0.0)
            for k in range(4):
                value = disparity[2 * i + k // 2, 2 * j + k % 2]
                if value > nearest - SURFACE_JUMP_PX:
                    total += value
                    count += F(1.0)
            cells[i, j] = total / count if count > 0 else F(np.nan)
    return cells


@jit_rows
def _extended_from_farther(cells: FloatImage) -> FloatImage:
    """Return the cells with missing disparities taken from the farther neighbour along the row.

    Most cells without a disparity are occluded in the right image, and the occluded surface is the farther one.
    """
    rows, cols = cells.shape
    out = cells.copy()
    for i in prange(rows):
        last = F(np.nan)
        j = 0
        while j < cols:
            if not np.isnan(cells[i, j]):
                last = cells[i, j]
                j += 1
                continue
            end = j
            while end < cols and np.isnan(cells[i, end]):
                end += 1
            value = last
            is_known_left = not np.isnan(last)
            is_known_right = end < cols
            if is_known_right and (not is_known_left or cells[i, end] < last):
                value = cells[i, end]
            if not is_known_left and not is_known_right:
                value = F(0.0)
            for k in range(j, end):
                out[i, k] = value
            j = end
    return out


@jit_rows
def _edge_preserving_mean(cells: FloatImage, radius: int, tolerance: np.float32) -> FloatImage:
    """Return the mean over the neighbours that differ from a cell by less than a tolerance, so that edges stay sharp.

    The window of neighbours extends `radius` cells to each side and includes the cell.
    """
    rows, cols = cells.shape
    out = np.empty_like(cells)
    for i in prange(rows):
        total = np.zeros(cols, F)
        count = np.zeros(cols, F)
        for y in range(max(0, i - radius), min(rows, i + radius + 1)):
            for dx in range(-radius, radius + 1):
                # The innermost loop is over columns of slices that start at 0, so that the compiler vectorises it.
                first = max(0, -dx)
                last = min(cols, cols - dx)
                neighbours = cells[y, first + dx : last + dx]
                centres = cells[i, first:last]
                totals = total[first:last]
                counts = count[first:last]
                for j in range(len(centres)):
                    step = neighbours[j] - centres[j]
                    near = F(1.0) if abs(step) < tolerance else F(0.0)
                    totals[j] += near * step
                    counts[j] += near
        for j in range(cols):
            out[i, j] = cells[i, j] + total[j] / count[j]
    return out


@jit_rows_inline
def _same_surface(value: np.float32, centre: np.float32) -> np.float32:
    """Return the value if it belongs to the surface of `centre`, otherwise `centre`."""
    return centre if abs(value - centre) > SURFACE_JUMP_PX else value


@jit_rows_inline
def _between(centre: np.float32, vertical: np.float32, horizontal: np.float32, corner: np.float32) -> np.float32:
    """Return the field a quarter of a cell from a centre, towards two of its neighbours and the cell between them."""
    sides = _same_surface(horizontal, centre) + _same_surface(vertical, centre)
    return NEAR_TAP * centre + SIDE_TAP * sides + CORNER_TAP * _same_surface(corner, centre)


@jit_rows
def _pixels_from_cells(cells: FloatImage) -> FloatImage:
    """Return the field at pixels `(2 h, 2 w)`, interpolated bilinearly between cell centres, but not across jumps."""
    rows, cols = cells.shape
    out = np.empty((2 * rows, 2 * cols), F)
    for y in prange(2 * rows):
        i = y // 2
        i2 = min(max(i - 1 + 2 * (y % 2), 0), rows - 1)  # row of the nearer vertical neighbours
        for j in range(cols - 1):  # the two pixels between the centres of adjacent cells
            out[y, 2 * j + 1] = _between(cells[i, j], cells[i2, j], cells[i, j + 1], cells[i2, j + 1])
            out[y, 2 * j + 2] = _between(cells[i, j + 1], cells[i2, j + 1], cells[i, j], cells[i2, j])
        for j in (0, cols - 1):  # the first and the last pixel, beyond the outer centres
            edge = _between(cells[i, j], cells[i2, j], cells[i, j], cells[i2, j])
            out[y, 2 * j + (0 if j == 0 else 1)] = edge
    return out
