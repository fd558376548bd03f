"""Sub-pixel disparity by a variational fit of the whole field to both images.

The field minimises, over cells of 2 x 2 pixels,

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

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.median import median
from sfr_loc_map.mapping.disparity.conjugate_gradient import conjugate_gradient_step
from sfr_loc_map.mapping.disparity.disparity_grid import (
    cells_from_pixels,
    edge_preserving_mean,
    fill_occlusions,
    pixels_from_cells,
)
from sfr_loc_map.mapping.disparity.filters import (
    box_mean,
    downsample_mean,
    second_differences,
    upsample_bilinear,
)
from sfr_loc_map.mapping.disparity.noise_model import GreyLevels, grey_levels, noise_variance, overall_noise
from sfr_loc_map.mapping.disparity.photometric_residual import (
    NormalEquations,
    cell_means,
    mean_template,
    normal_equations,
    normalised_residual,
    photometric_residual,
    slopes,
)
from sfr_loc_map.mapping.disparity.rectification_correction import RectificationCorrection, correct_rectification
from sfr_loc_map.mapping.disparity.regularisation import SmoothnessWeights, smoothness_weight

F = np.float32

LEVELS = 3
"""Grids of one iteration: cells of 2, 4 and 8 pixels."""
PAD = 2**LEVELS
"""Images are padded to a multiple of this."""
WARPS, NOISY_WARPS = 3, 5
"""Iterations; more where noise is large, as the matcher's field is then further from the best one."""
NOISY_PX = 1.2
"""Median standard deviation of the disparity of a cell by its own pixels alone from which noise is large, pixels."""
SOLVER_ITERATIONS = (8, 12, 12)
"""Conjugate gradient steps on each grid, finest first."""
JUMP_PX = F(1.0)
"""Neighbouring cells that differ more belong to two surfaces."""
START_TOLERANCES_PX = (F(1.5), F(0.7))
"""Neighbours that differ by less are averaged in the matcher's result, twice."""
BOX = 9
"""Side in cells over which brightness offset and noise level are averaged."""
TAIL = F(1.0 / 25.0)
"""Residuals of five standard deviations have half their weight."""
ROUGHNESS_CELLS = 4
"""Spacing of the second differences by which roughness is measured: far enough apart to rise above the noise."""
ROUGHNESS_FACTOR = 10.0 / ROUGHNESS_CELLS**2
GRID_FACTOR = 2.8
"""Growth of second differences with each doubling of the spacing: `2^1.5`, between a fractal and a smooth surface."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedDisparity:
    """A refined field and what is needed to judge it.

    Attributes:
        disparity_px: `(H, W)` float32, pixels, without holes.
        cells_px: `(H/2, W/2)` float32, pixels, the field on cells, padded.
        information: `(H/2, W/2)` float32, 1 / pixels^2 of one cell.
        weights: Of the field's second differences.
        normalised_residual: `(H, W)` float32, residual over its standard deviation; NaN outside the right image.
        noise: Standard deviation of a residual, grey levels.
        right: `(H, W)` float32, the corrected right image.
        correction: Of the right image.
    """

    disparity_px: FloatImage
    cells_px: FloatImage
    information: FloatImage
    weights: SmoothnessWeights
    normalised_residual: FloatImage
    noise: float
    right: FloatImage
    correction: RectificationCorrection


def refine(left: FloatImage, right: FloatImage, initial_px: FloatImage) -> RefinedDisparity:
    """Return the disparity field that fits both images best.

    Args:
        left: `(H, W)` float32 grey.
        right: `(H, W)` float32 grey.
        initial_px: `(H, W)` float32, pixels, right to about a pixel; NaN where unknown.
    """
    height, width = left.shape
    left, right, cells = padded(left), padded(right), initial_cells(padded(initial_px))
    correction, right = correct_rectification(left, right, pixels_from_cells(cells, JUMP_PX))
    grey = grey_levels(left)
    last = linearise(left, right, grey, cells)
    for warp in range(NOISY_WARPS):
        if warp == WARPS and median(last.equations.information) > NOISY_PX**-2:
            break
        cells, weights = coarse_to_fine_step(cells, last.equations.information, last.equations.information_vector)
        last = linearise(left, right, grey, cells)
    deviation = np.sqrt(last.variance)
    normalised = normalised_residual(last.residual, last.offset, deviation)
    return RefinedDisparity(
        np.ascontiguousarray(pixels_from_cells(cells, JUMP_PX)[:height, :width]),
        cells,
        last.equations.information,
        weights,
        normalised[:height, :width],
        median(deviation),
        np.ascontiguousarray(right[:height, :width]),
        correction,
    )


def padded(image: FloatImage) -> FloatImage:
    """Return the image with its last rows and columns repeated up to a multiple of `PAD`."""
    below, beside = -image.shape[0] % PAD, -image.shape[1] % PAD
    return np.ascontiguousarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), F)


def initial_cells(initial_px: FloatImage) -> FloatImage:
    """Return the matcher's disparities `(H, W)` as a field on cells without holes, its steps smoothed."""
    cells = fill_occlusions(cells_from_pixels(initial_px, JUMP_PX))
    for tolerance in START_TOLERANCES_PX:
        cells = edge_preserving_mean(cells, 3, tolerance)
    return cells


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """The data term about a field.

    Attributes:
        residual: `(H, W)`, grey levels, NaN outside the right image.
        offset: `(H/2, W/2)`, its brightness offset, grey levels.
        variance: `(H/2, W/2)`, grey levels squared.
        equations: Of the change of each cell.
    """

    residual: FloatImage
    offset: FloatImage
    variance: FloatImage
    equations: NormalEquations


def linearise(left: FloatImage, right: FloatImage, grey: GreyLevels, cells: FloatImage) -> Linearisation:
    """Return residuals, their brightness offset and variance, and the normal equations of each cell.

    `grey` is of the left image. Where residuals exceed their stated variance, the information is reduced by as much.
    """
    residual = photometric_residual(left, right, pixels_from_cells(cells, JUMP_PX))
    noise = overall_noise(residual)
    offset = box_mean(cell_means(residual, F(3.0 * noise)), BOX)
    variance = noise_variance(grey, residual, offset)
    template = mean_template(left, residual, offset, F(4.0 * noise))
    found = normal_equations(slopes(template), residual, offset, F(1.0) / variance, TAIL)
    chi2_per_dof = box_mean(found.chi2, BOX) / np.maximum(box_mean(found.weight, BOX), F(0.1))
    excess = np.maximum(chi2_per_dof, F(1.0))
    scaled = found._replace(
        information=np.asarray(found.information / excess, F),
        information_vector=np.asarray(found.information_vector / excess, F),
    )
    return Linearisation(residual, offset, variance, scaled)


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
