"""The disparity field on a grid of cells, 2 x 2 pixels each.

A surface that is smooth over several pixels needs half the resolution of the image only, at a quarter of the cost.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32


@jit_rows
def cells_from_pixels(disparity: FloatImage, jump: np.float32) -> FloatImage:
    """Return the mean disparity of each cell's nearest surface `(H/2, W/2)`, NaN for a cell without any."""
    rows, cols = disparity.shape[0] // 2, disparity.shape[1] // 2
    cells = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            nearest = F(-1.0)
            for k in range(4):
                nearest = max(nearest, disparity[2 * i + k // 2, 2 * j + k % 2])
            total, count = F(0.0), F(0.0)
            for k in range(4):
                value = disparity[2 * i + k // 2, 2 * j + k % 2]
                if value > nearest - jump:
                    total += value
                    count += F(1.0)
            cells[i, j] = total / count if count > 0 and nearest >= 0 else F(np.nan)
    return cells


@jit_rows
def fill_occlusions(cells: FloatImage) -> FloatImage:
    """Return the cells with each hole given the farther of its two neighbours along the row: holes are occlusions."""
    rows, cols = cells.shape
    out = cells.copy()
    for i in prange(rows):
        last = F(np.nan)
        j = 0
        while j < cols:
            if cells[i, j] == cells[i, j]:
                last = cells[i, j]
                j += 1
                continue
            end = j
            while end < cols and cells[i, end] != cells[i, end]:
                end += 1
            value = last
            if end < cols and not value <= cells[i, end]:
                value = cells[i, end]
            if value != value:
                value = F(0.0)
            for k in range(j, end):
                out[i, k] = value
            j = end
    return out


@jit_rows
def edge_preserving_mean(cells: FloatImage, radius: int, jump: np.float32) -> FloatImage:
    """Return each cell's mean over its neighbours that differ by less than `jump`: noise is averaged, edges stay."""
    rows, cols = cells.shape
    out = np.empty_like(cells)
    for i in prange(rows):
        total, count = np.zeros(cols, F), np.zeros(cols, F)
        for y in range(max(0, i - radius), min(rows, i + radius + 1)):
            for dx in range(-radius, radius + 1):
                # The columns are the innermost loop, over slices that start at 0: they are computed side by side.
                first, last = max(0, -dx), min(cols, cols - dx)
                neighbours, centres = cells[y, first + dx : last + dx], cells[i, first:last]
                totals, counts = total[first:last], count[first:last]
                for j in range(len(centres)):
                    step = neighbours[j] - centres[j]
                    near = F(1.0) if abs(step) < jump else F(0.0)
                    totals[j] += near * step
                    counts[j] += near
        for j in range(cols):
            out[i, j] = cells[i, j] + total[j] / count[j]
    return out


@jit_rows_inline
def _same_surface(value: np.float32, centre: np.float32, jump: np.float32) -> np.float32:
    """Return the value if it belongs to the surface of `centre`, otherwise `centre`."""
    return centre if abs(value - centre) > jump else value


@jit_rows_inline
def _between(
    centre: np.float32, along: np.float32, across: np.float32, corner: np.float32, jump: np.float32
) -> np.float32:
    """Return the field a quarter of a cell from a centre, towards two of its neighbours and the corner between."""
    sides = _same_surface(across, centre, jump) + _same_surface(along, centre, jump)
    return F(0.5625) * centre + F(0.1875) * sides + F(0.0625) * _same_surface(corner, centre, jump)


@jit_rows
def pixels_from_cells(cells: FloatImage, jump: np.float32) -> FloatImage:
    """Return the field at pixels `(2 h, 2 w)`, bilinear between cell centres but never across a jump."""
    rows, cols = cells.shape
    out = np.empty((2 * rows, 2 * cols), F)
    for y in prange(2 * rows):
        i = y // 2
        i2 = min(max(i - 1 + 2 * (y % 2), 0), rows - 1)
        for j in range(cols - 1):
            out[y, 2 * j + 1] = _between(cells[i, j], cells[i2, j], cells[i, j + 1], cells[i2, j + 1], jump)
            out[y, 2 * j + 2] = _between(cells[i, j + 1], cells[i2, j + 1], cells[i, j], cells[i2, j], jump)
        for j in (0, cols - 1):
            edge = _between(cells[i, j], cells[i2, j], cells[i, j], cells[i2, j], jump)
            out[y, 2 * j + (0 if j == 0 else 1)] = edge
        if cols == 1:
            out[y, 1] = out[y, 0]
    return out
