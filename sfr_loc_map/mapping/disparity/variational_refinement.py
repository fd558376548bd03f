"""Sub-pixel disparity by a variational fit of the whole field to both images (after Horn and Schunck 1981).

The field is represented by cells of 2 x 2 pixels, because a surface is smooth over several pixels. It minimises

    sum (r - g s)^2 / variance  +  sum smoothness_weight (second differences of the field)^2

with r the warped right image minus the left one, g its slope along the row, and s the change of the field. All cells
are solved together, coupled by the smoothness of the ground, instead of in windows that assume a plane. The noise of
the images and the roughness of the ground are measured in each pair, so that the smoothing adapts to both. Second
differences far beyond the typical size, as at the edges of rocks, lose their weight (Cauchy). Each iteration warps the
right image again and solves on three grids, coarse to fine, by conjugate gradients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.filters import (
    SURFACE_JUMP_PX,
    box_mean,
    downsample_mean,
    second_differences,
    upsample_bilinear,
    upsample_nearest,
)
from sfr_loc_map.mapping.disparity.photometric_residual import (
    SAMPLED_CELLS,
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
from sfr_loc_map.mapping.disparity.rectification_correction import RectificationCorrection, correct_rectification
from sfr_loc_map.mapping.disparity.smoothness import SmoothnessWeights, conjugate_gradient_step, smoothness_weight
from sfr_loc_map.mapping.robust_statistics import mad_sigma

F = np.float32

LEVELS = 3  #: Grids of one iteration: cells of 2, 4 and 8 pixels.
PADDED_MULTIPLE = 2**LEVELS  #: Images are padded to a multiple of this size.
WARPS = 3  #: Iterations.
NOISY_WARPS = 5  #: Iterations if noise is large, because the initial field is then farther from the minimum.
NOISY_PX = 1.2  #: Noise is large if the median standard deviation of a cell by its own pixels exceeds this, pixels.
SOLVER_ITERATIONS = (8, 12, 12)  #: Conjugate gradient steps on each grid, finest first.
MEAN_RADIUS_CELLS = 3  #: Half side of the window in which the initial field is averaged, cells.
MEAN_TOLERANCES_PX = (F(1.5), F(0.7))  #: Cells that differ by less are averaged; the initial field is averaged twice.
WINDOW_CELLS = 9  #: Side of the square over which figures of cells are averaged, cells.
ROBUST_FACTOR = F(1.0 / 25.0)  #: Factor of the Cauchy weight: residuals of five standard deviations have half of it.
CLIPPING_SIGMAS = 3.0  #: Residuals are clipped to this many standard deviations in the brightness offset.
TEMPLATE_SIGMAS = 4.0  #: The template is the left image where the residual exceeds this many standard deviations.
MIN_WEIGHT = F(0.1)  #: Smallest mean robust weight by which the squared residuals are normalised.
ROUGHNESS_CELLS = 4  #: Spacing of the second differences that measure roughness: large enough to rise above the noise.
ROUGHNESS_FACTOR = (
    10.0 / ROUGHNESS_CELLS**2
)  #: Typical second difference at a spacing of one cell over the measured one.
EDGE_FACTOR = 10.0  #: Second differences above this multiple of the median are edges, not the shape of the ground.
MIN_ROUGHNESS = 0.1  #: Smallest local roughness, as a multiple of the median.
MIN_TYPICAL_PX = 1e-3  #: Smallest median of the second differences, pixels.
ROUGHNESS_WINDOW = 5  #: Side of the square over which the local roughness is averaged, in units of its spacing.
GRID_FACTOR = 2.8  #: Growth of second differences per doubling of the spacing: `2^1.5`, between fractal and smooth.


@dataclass(frozen=True, slots=True, eq=False)
class RefinedDisparity:
    """A refined field and what its uncertainty and validity are judged by."""

    disparity_px: FloatImage  #: `(H, W)` float32, pixels, without holes.
    cells_px: FloatImage  #: `(H/2, W/2)` float32, pixels, the field on cells, padded.
    information: FloatImage  #: `(H/2, W/2)` float32, 1 / px^2 per cell.
    weights: SmoothnessWeights  #: Weights of the field's second differences.
    #: `(H, W)` float32, residual over its standard deviation; NaN outside the right image.
    normalised_residual: FloatImage
    noise_grey: float  #: Standard deviation of a residual, grey levels.
    right: FloatImage  #: `(H, W)` float32, the corrected right image.
    correction: RectificationCorrection  #: Deviations that were removed from the right image.


class LeftImage(NamedTuple):
    """The left image as the refinement uses it."""

    image: FloatImage  #: `(H, W)`, padded, grey levels.
    cell_grey: FloatImage  #: `(H/2, W/2)`, mean grey level of each cell.
    grey_order: IntArray  #: Indices that sort the sampled cells by their grey level.
    min_noise: float  #: Standard deviation of a residual due to rounding alone, grey levels.


class Linearisation(NamedTuple):
    """The data term at a field."""

    residual: FloatImage  #: `(H, W)`, grey levels; NaN outside the right image.
    offset: FloatImage  #: `(H/2, W/2)`, brightness offset of the residuals, grey levels.
    variance: FloatImage  #: `(H/2, W/2)`, variance of the residuals, grey levels squared.
    equations: NormalEquations  #: Normal equations of a change of the field.


class FieldStep(NamedTuple):
    """Result of one linearised solve."""

    cells: FloatImage  #: `(H/2, W/2)`, the field, pixels.
    weights: SmoothnessWeights  #: Smoothness weights of the finest grid.


class Roughness(NamedTuple):
    """Typical size of the second differences of a field around each cell, pixels."""

    along_x: FloatImage
    along_y: FloatImage


def refine(left: FloatImage, right: FloatImage, initial_px: FloatImage) -> RefinedDisparity:
    """Return the disparity field that fits both images `(H, W)` best.

    The initial disparity is correct to about a pixel, or NaN where it is unknown.
    """
    height, width = left.shape
    scene = prepare_left(left)
    cells = initial_field(initial_px)
    disparity_px = pixels_from_cells(cells, SURFACE_JUMP_PX)
    corrected, correction = correct_rectification(scene.image, padded(right), disparity_px)
    linear = linearise(scene, corrected, cells)
    for warp in range(NOISY_WARPS):
        if warp == WARPS and median(linear.equations.information) > NOISY_PX**-2:
            break
        cells, weights = coarse_to_fine_step(cells, linear.equations)
        linear = linearise(scene, corrected, cells)
    deviation = np.sqrt(linear.variance)
    normalised = (linear.residual - upsample_nearest(linear.offset, 2)) / upsample_nearest(deviation, 2)
    return RefinedDisparity(
        disparity_px=np.ascontiguousarray(pixels_from_cells(cells, SURFACE_JUMP_PX)[:height, :width]),
        cells_px=cells,
        information=linear.equations.information,
        weights=weights,
        normalised_residual=normalised[:height, :width],
        noise_grey=median(deviation),
        right=np.ascontiguousarray(corrected[:height, :width]),
        correction=correction,
    )


def prepare_left(left: FloatImage) -> LeftImage:
    """Return the left image with what all iterations share."""
    image = padded(left)
    cell_grey = downsample_mean(image, 2)
    order = np.argsort(cell_grey[SAMPLED_CELLS].ravel(), kind="stable")
    return LeftImage(image, cell_grey, order, rounding_noise(left))


def initial_field(initial_px: FloatImage) -> FloatImage:
    """Return the field on cells of an initial disparity `(H, W)`, without holes and averaged within surfaces."""
    cells = fill_occlusions(cells_from_pixels(padded(initial_px), SURFACE_JUMP_PX))
    for tolerance_px in MEAN_TOLERANCES_PX:
        cells = edge_preserving_mean(cells, MEAN_RADIUS_CELLS, tolerance_px)
    return cells


def padded(image: FloatImage) -> FloatImage:
    """Return the image with its last rows and columns repeated up to a multiple of `PADDED_MULTIPLE`."""
    height, width = image.shape
    below = -height % PADDED_MULTIPLE
    beside = -width % PADDED_MULTIPLE
    return np.ascontiguousarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), F)


def linearise(left: LeftImage, right: FloatImage, cells: FloatImage) -> Linearisation:
    """Return the data term at a field.

    If residuals exceed their variance, or are correlated between pixels, the information is reduced accordingly.
    """
    residual = photometric_residual(left.image, right, pixels_from_cells(cells, SURFACE_JUMP_PX))
    noise = overall_noise(residual, left.min_noise)
    means = cell_means(residual, F(CLIPPING_SIGMAS * noise))
    offset = box_mean(means, WINDOW_CELLS)
    variance = noise_variance(left.cell_grey, left.grey_order, residual, offset, left.min_noise)
    template = mean_template(left.image, residual, offset, F(TEMPLATE_SIGMAS * noise))
    equations = normal_equations(slopes(template), residual, offset, F(1.0) / variance, ROBUST_FACTOR)
    mean_chi2 = box_mean(equations.chi2, WINDOW_CELLS)
    mean_weight = np.maximum(box_mean(equations.weight, WINDOW_CELLS), MIN_WEIGHT)
    excess = np.maximum(mean_chi2 / mean_weight, noise_correlation(means, offset, variance))
    scaled = equations._replace(
        information=np.asarray(equations.information / excess, F),
        information_vector=np.asarray(equations.information_vector / excess, F),
    )
    return Linearisation(residual, offset, variance, scaled)


def noise_correlation(means: FloatImage, offset: FloatImage, variance: FloatImage) -> np.float32:
    """Return the variance of the mean of 4 x 4 residuals over that of white noise, at least 1.

    Noise that a filter or a compression has left is correlated between pixels.
    """
    blocks = downsample_mean(np.asarray((means - offset) / np.sqrt(variance), F), 2)
    known = blocks[blocks != 0]  # blocks without residuals are 0
    return F(max(16.0 * mad_sigma(known) ** 2, 1.0))


def roughness(cells: FloatImage) -> Roughness:
    """Return the roughness of a field, measured at a spacing of `ROUGHNESS_CELLS`."""
    along_x, along_y = second_differences(downsample_mean(cells, ROUGHNESS_CELLS))
    factor = F(ROUGHNESS_FACTOR)
    return Roughness(
        upsample_bilinear(_local_size(along_x), cells.shape) * factor,
        upsample_bilinear(_local_size(along_y), cells.shape) * factor,
    )


def _local_size(differences: FloatImage) -> FloatImage:
    """Return the typical size of differences around each cell; single large ones, as at edges, count little."""
    size = np.abs(differences)
    typical = max(median(size), MIN_TYPICAL_PX)
    clipped = np.minimum(size, F(EDGE_FACTOR * typical))
    local = np.square(box_mean(np.sqrt(clipped), WINDOW_CELLS))
    return box_mean(np.maximum(local, F(MIN_ROUGHNESS * typical)), ROUGHNESS_WINDOW)


def coarse_to_fine_step(cells: FloatImage, equations: NormalEquations) -> FieldStep:
    """Return the field after one linearised solve on all grids, coarse to fine."""
    rough = roughness(cells)
    information = equations.information
    information_vector = equations.information_vector
    for level in range(LEVELS - 1, 0, -1):
        factor = 2**level
        cells_per_block = F(factor * factor)
        field = downsample_mean(cells, factor)
        weights = smoothness_weight(
            field, downsample_mean(rough.along_x, factor), downsample_mean(rough.along_y, factor), F(GRID_FACTOR**level)
        )
        coarse_step = conjugate_gradient_step(
            field,
            downsample_mean(information, factor) * cells_per_block,
            downsample_mean(information_vector, factor) * cells_per_block,
            weights,
            SOLVER_ITERATIONS[level],
        )
        step = upsample_bilinear(coarse_step, cells.shape)
        cells = cells + step
        information_vector = information_vector - information * step
    weights = smoothness_weight(cells, rough.along_x, rough.along_y, F(1.0))
    step = conjugate_gradient_step(cells, information, information_vector, weights, SOLVER_ITERATIONS[0])
    return FieldStep(cells + step, weights)


@jit_rows
def cells_from_pixels(disparity: FloatImage, jump: np.float32) -> FloatImage:
    """Return the mean disparity of each cell's nearest surface `(H/2, W/2)`, NaN if all its pixels are unknown."""
    rows = disparity.shape[0] // 2
    cols = disparity.shape[1] // 2
    cells = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            nearest = F(-1.0)
            for k in range(4):
                nearest = max(nearest, disparity[2 * i + k // 2, 2 * j + k % 2])
            total = F(0.0)
            count = F(0.0)
            for k in range(4):
                value = disparity[2 * i + k // 2, 2 * j + k % 2]
                if value > nearest - jump:
                    total += value
                    count += F(1.0)
            cells[i, j] = total / count if count > 0 and nearest >= 0 else F(np.nan)
    return cells


@jit_rows
def fill_occlusions(cells: FloatImage) -> FloatImage:
    """Return the cells with holes filled by the farther neighbour along the row: most holes are occlusions."""
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
            if end < cols and not value <= cells[i, end]:
                value = cells[i, end]
            if np.isnan(value):
                value = F(0.0)
            for k in range(j, end):
                out[i, k] = value
            j = end
    return out


@jit_rows
def edge_preserving_mean(cells: FloatImage, radius: int, jump: np.float32) -> FloatImage:
    """Return each cell's mean over its neighbours that differ by less than `jump`, so that edges stay sharp."""
    rows, cols = cells.shape
    out = np.empty_like(cells)
    for i in prange(rows):
        total = np.zeros(cols, F)
        count = np.zeros(cols, F)
        for y in range(max(0, i - radius), min(rows, i + radius + 1)):
            for dx in range(-radius, radius + 1):
                # The columns are the innermost loop, over slices that start at 0, so that it runs on the vector units.
                first = max(0, -dx)
                last = min(cols, cols - dx)
                neighbours = cells[y, first + dx : last + dx]
                centres = cells[i, first:last]
                totals = total[first:last]
                counts = count[first:last]
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
