"""Sub-pixel disparity by a variational fit of the whole field to both images.

The field minimises, over cells of 2 x 2 pixels (a surface that is smooth over several pixels needs no more),

    sum (r - g s)^2 / variance  +  sum smoothness_weight (second differences of the field)^2

r being the right image warped by the present field minus the left one, g its slope along the row, s the change of the
field. All pixels are solved for at once, tied by the smoothness of the ground instead of by a window that assumes a
plane. Noise and roughness of the ground are measured in the images, so that smoothing adapts; second differences far
beyond the typical size (the edges of rocks) lose their weight. Each iteration warps again and solves on three grids,
coarse to fine, by conjugate gradients.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.filters import (
    box_mean,
    downsample_mean,
    mad_sigma,
    second_differences,
    upsample_bilinear,
)
from sfr_loc_map.mapping.disparity.photometric_residual import (
    NormalEquations,
    cell_means,
    mean_template,
    noise_variance,
    normal_equations,
    overall_noise,
    photometric_residual,
    rounding_noise,
    slopes,
)
from sfr_loc_map.mapping.disparity.right_camera import RectificationCorrection, correct_rectification
from sfr_loc_map.mapping.disparity.smoothness import SmoothnessWeights, conjugate_gradient_step, smoothness_weight

F = np.float32

LEVELS = 3  #: Grids of one iteration: cells of 2, 4 and 8 pixels.
PAD = 2**LEVELS  #: Images are padded to a multiple of this.
WARPS, NOISY_WARPS = 3, 5
"""Iterations; more where noise is large, as the matcher's field is then further from the best one."""
NOISY_PX = 1.2
"""Median standard deviation of the disparity of a cell by its own pixels alone from which noise is large, pixels."""
SOLVER_ITERATIONS = (8, 12, 12)  #: Conjugate gradient steps on each grid, finest first.
JUMP_PX = F(1.0)  #: Neighbouring cells that differ more belong to two surfaces.
START_TOLERANCES_PX = (F(1.5), F(0.7))  #: Neighbours that differ by less are averaged in the matcher's result, twice.
BOX = 9  #: Side in cells over which brightness offset and noise level are averaged.
TAIL = F(1.0 / 25.0)  #: Residuals of five standard deviations have half their weight.
ROUGHNESS_CELLS = 4
"""Spacing of the second differences by which roughness is measured: far enough apart to rise above the noise."""
ROUGHNESS_FACTOR = 10.0 / ROUGHNESS_CELLS**2
GRID_FACTOR = 2.8
"""Growth of second differences with each doubling of the spacing: `2^1.5`, between a fractal and a smooth surface."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedDisparity:
    """A refined field and what is needed to judge it."""

    disparity_px: FloatImage  #: `(H, W)` float32, pixels, without holes.
    cells_px: FloatImage  #: `(H/2, W/2)` float32, pixels, the field on cells, padded.
    information: FloatImage  #: `(H/2, W/2)` float32, 1 / pixels^2 of one cell.
    weights: SmoothnessWeights  #: Of the field's second differences.
    #: `(H, W)` float32, residual over its standard deviation; NaN outside the right image.
    normalised_residual: FloatImage
    noise: float  #: Standard deviation of a residual, grey levels.
    right: FloatImage  #: `(H, W)` float32, the corrected right image.
    correction: RectificationCorrection  #: Of the right image.


def refine(left: FloatImage, right: FloatImage, initial_px: FloatImage) -> RefinedDisparity:
    """Return the disparity field that fits both images `(H, W)` best; the start is right to about a pixel, or NaN."""
    height, width = left.shape
    least_noise = rounding_noise(left)
    left, right = padded(left), padded(right)
    cells = fill_occlusions(cells_from_pixels(padded(initial_px), JUMP_PX))
    for tolerance in START_TOLERANCES_PX:
        cells = edge_preserving_mean(cells, 3, tolerance)
    correction, right = correct_rectification(left, right, pixels_from_cells(cells, JUMP_PX))
    grey = downsample_mean(left, 2)
    order = np.argsort(grey[::4, ::2].ravel(), kind="stable")
    for warp in range(NOISY_WARPS + 1):
        residual, offset, variance, equations = linearise(left, right, grey, order, cells, least_noise)
        precise = warp == WARPS and median(equations.information) > NOISY_PX**-2
        if precise or warp == NOISY_WARPS:
            break
        cells, weights = coarse_to_fine_step(cells, equations.information, equations.information_vector)
    deviation = np.sqrt(variance)
    residual -= offset.repeat(2, axis=0).repeat(2, axis=1)
    residual /= deviation.repeat(2, axis=0).repeat(2, axis=1)
    return RefinedDisparity(
        np.ascontiguousarray(pixels_from_cells(cells, JUMP_PX)[:height, :width]),
        cells,
        equations.information,
        weights,
        residual[:height, :width],
        median(deviation),
        np.ascontiguousarray(right[:height, :width]),
        correction,
    )


def padded(image: FloatImage) -> FloatImage:
    """Return the image with its last rows and columns repeated up to a multiple of `PAD`."""
    below, beside = -image.shape[0] % PAD, -image.shape[1] % PAD
    return np.ascontiguousarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), F)


def linearise(
    left: FloatImage, right: FloatImage, grey: FloatImage, order: IntArray, cells: FloatImage, least_noise: float
) -> tuple[FloatImage, FloatImage, FloatImage, NormalEquations]:
    """Return residuals `(H, W)`, their brightness offset and variance, and the normal equations of each cell.

    Grey and order are of the left image, as `noise_variance` takes them. Where residuals exceed their stated variance,
    the information is reduced by as much.
    """
    residual = photometric_residual(left, right, pixels_from_cells(cells, JUMP_PX))
    noise = overall_noise(residual, least_noise)
    means = cell_means(residual, F(3.0 * noise))
    offset = box_mean(means, BOX)
    variance = noise_variance(grey, order, residual, offset, least_noise)
    blocks = downsample_mean(np.asarray((means - offset) / np.sqrt(variance), F), 2)
    # 1 for white noise; blocks without residuals are 0
    correlation = F(max(16.0 * mad_sigma(blocks[blocks != 0]) ** 2, 1.0))
    template = mean_template(left, residual, offset, F(4.0 * noise))
    found = normal_equations(slopes(template), residual, offset, F(1.0) / variance, TAIL)
    chi2_per_dof = box_mean(found.chi2, BOX) / np.maximum(box_mean(found.weight, BOX), F(0.1))
    excess = np.maximum(chi2_per_dof, correlation)
    scaled = found._replace(
        information=np.asarray(found.information / excess, F),
        information_vector=np.asarray(found.information_vector / excess, F),
    )
    return residual, offset, variance, scaled


def roughness(cells: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the typical size of the field's second differences along rows and columns around each cell, pixels."""
    scale_x, scale_y = (_local_scale(q) for q in second_differences(downsample_mean(cells, ROUGHNESS_CELLS)))
    factor = F(ROUGHNESS_FACTOR)
    return upsample_bilinear(scale_x, cells.shape) * factor, upsample_bilinear(scale_y, cells.shape) * factor


def _local_scale(differences: FloatImage) -> FloatImage:
    """Return the typical size around each cell; single large ones (edges) count little."""
    size = np.abs(differences)
    typical = max(median(size), 1e-3)
    local = np.square(box_mean(np.sqrt(np.minimum(size, F(10.0 * typical))), BOX))
    return box_mean(np.maximum(local, F(0.1 * typical)), 5)


def coarse_to_fine_step(
    cells: FloatImage, information: FloatImage, information_vector: FloatImage
) -> tuple[FloatImage, SmoothnessWeights]:
    """Return the field after one linearised solve on all grids, and the smoothness weights of the finest."""
    scale_x, scale_y = roughness(cells)
    for level in range(LEVELS - 1, 0, -1):
        factor = 2**level
        field, coarse_x, coarse_y = (downsample_mean(image, factor) for image in (cells, scale_x, scale_y))
        sums = [downsample_mean(image, factor) * F(factor * factor) for image in (information, information_vector)]
        weights = smoothness_weight(field, coarse_x, coarse_y, F(GRID_FACTOR**level))
        coarse_step = conjugate_gradient_step(field, sums[0], sums[1], weights, SOLVER_ITERATIONS[level])
        step = upsample_bilinear(coarse_step, cells.shape)
        cells = cells + step
        information_vector = information_vector - information * step
    weights = smoothness_weight(cells, scale_x, scale_y, F(1.0))
    step = conjugate_gradient_step(cells, information, information_vector, weights, SOLVER_ITERATIONS[0])
    return cells + step, weights


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
    return out
