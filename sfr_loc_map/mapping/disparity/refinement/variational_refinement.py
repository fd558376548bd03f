"""Sub-pixel disparity by a variational fit of the whole field to both images (after Horn and Schunck 1981).

The field is represented by cells of 2 x 2 pixels, because a surface is smooth over several pixels. All cells are solved
together, coupled by the smoothness of the ground, instead of in windows that assume a plane. The noise of the images
and the shape of the ground are measured in each pair, so that the smoothing adapts to both. Each iteration warps the
right image again (`linearise`) and changes the field by s, which minimises on each of three grids, coarse to fine,

    sum w (r - o - g s)^2 / (c variance)  +  sum w_x (d_xx)^2 + w_y (d_yy)^2 + w_m (d_xy)^2

- The first sum is over pixels. r is the warped right image minus the left image, o the brightness offset around the
  pixel, g the slope along the row, and w the Cauchy weight of the residual. The variance of the residuals is inflated
  by the factor c (`linearise`).
- The second sum is over the elements of the grid, with the second differences of d, the field plus s. Their Cauchy
  weights w_x, w_y and w_m (`smoothness`) decrease far above the typical size, for example at the edges of rocks.
- w, c and the weights of the second differences are constant within a solve.
- An element of a coarse grid is a block of cells with a common s. Its data term is therefore the sum over its cells.
  The second differences on this grid and their scale, multiplied by `GRID_FACTOR` per doubling, refer to its spacing. A
  coarse solve thus minimises another smoothness energy than the finest grid, and only prepares the solve there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, median
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual
from sfr_loc_map.mapping.disparity.refinement.cell_field import LEVELS, WINDOW_CELLS, disparity_from_cells, padded
from sfr_loc_map.mapping.disparity.refinement.conjugate_gradients import conjugate_gradient_step
from sfr_loc_map.mapping.disparity.refinement.data_term import cell_means, mean_template, normal_equations, slopes
from sfr_loc_map.mapping.disparity.refinement.disparity_sigma import disparity_sigma
from sfr_loc_map.mapping.disparity.refinement.residual_noise import (
    block_variance_ratio,
    noise_variance,
    overall_noise,
    rounding_noise,
)
from sfr_loc_map.mapping.disparity.refinement.smoothness import (
    GRID_FACTOR,
    SmoothnessWeights,
    cauchy_scale_of,
    smoothness_weights,
)
from sfr_loc_map.mapping.filters import box_mean, downsample_mean, upsample_bilinear, upsample_nearest

ITERATIONS = 3  #: Number of iterations, each of which warps the right image.
EXTRA_ITERATIONS = 2  #: Number of additional iterations if the noise is large (`NOISY_PX`).
NOISY_PX = 1.2
"""The noise is large if the data of a single cell determine its disparity less accurately than this (standard deviation
in the median over the cells), pixels. The initial field is then farther from the minimum."""
SOLVER_ITERATIONS = (8, 12, 12)  #: Conjugate gradient iterations on each grid, finest grid first.
DATA_HALF_WEIGHT_SIGMAS = 5.0  #: Residuals of this many standard deviations have half the weight in the data term.
ROBUST_FACTOR = F(1.0 / DATA_HALF_WEIGHT_SIGMAS**2)  #: Factor of the squared normalised residual in the Cauchy weight.
CLIPPING_SIGMAS = 3.0  #: For the brightness offset, residuals are clipped to this many standard deviations.
TEMPLATE_SIGMAS = 4.0
"""Where the residual exceeds this many standard deviations, the template is the left image alone."""
MIN_WEIGHT = F(0.1)  #: Lower bound of the mean robust weight around a cell, which is a divisor (`linearise`).


@dataclass(frozen=True, slots=True, eq=False)
class RefinedDisparity:
    """A refined disparity with its uncertainty, and the residuals with which it is judged."""

    px: FloatImage  #: `(H, W)` float32, pixels, defined everywhere.
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of the disparity, pixels.
    #: `(H, W)` float32, residual divided by its standard deviation; NaN outside the right image.
    normalised_residual: FloatImage
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.


class LeftImage(NamedTuple):
    """The left image with the quantities that the refinement derives from it."""

    image: FloatImage  #: `(2 h, 2 w)`, padded, grey levels.
    cell_grey: FloatImage  #: `(h, w)`, mean grey level of each cell.
    min_noise: float  #: Standard deviation of a residual due to rounding alone, grey levels.


class Linearisation(NamedTuple):
    """The data term at a field."""

    residual: FloatImage  #: `(2 h, 2 w)`, grey levels; NaN outside the right image.
    offset: FloatImage  #: `(h, w)`, brightness offset of the residuals, grey levels.
    variance: FloatImage  #: `(h, w)`, variance of the residuals, grey levels squared.
    information: FloatImage  #: `(h, w)`, information on a change of the field by the inflated variance, 1 / px^2.
    information_vector: FloatImage  #: `(h, w)`, information times the least squares change, 1 / px.


def refine_disparity(left: FloatImage, right: FloatImage, initial_cells: FloatImage) -> RefinedDisparity:
    """Return the disparity field that fits both images `(H, W)` best.

    The right image must have the exposure of the left image and no vertical disparity. The initial field
    (`cells_from_disparity`) must be correct to about one pixel.
    """
    reference = _prepare_left(left)
    padded_right = padded(right)
    cells = initial_cells
    data_term = linearise(reference, padded_right, cells)
    for iteration in range(ITERATIONS + EXTRA_ITERATIONS):
        if iteration == ITERATIONS and not _is_noisy(data_term):
            break
        cells, weights = _coarse_to_fine_solve(cells, data_term)
        data_term = linearise(reference, padded_right, cells)
    height, width = left.shape
    deviation = np.sqrt(data_term.variance)
    normalised = (data_term.residual - upsample_nearest(data_term.offset, 2)) / upsample_nearest(deviation, 2)
    return RefinedDisparity(
        px=disparity_from_cells(cells, left.shape),
        sigma_px=disparity_sigma(cells, data_term.information, weights, left.shape),
        normalised_residual=normalised[:height, :width],
        noise_grey=median(deviation),
    )


def _is_noisy(data_term: Linearisation) -> bool:
    """Return whether the noise is so large that additional iterations are required (`NOISY_PX`)."""
    return median(data_term.information) <= NOISY_PX**-2


def _prepare_left(left: FloatImage) -> LeftImage:
    """Return the left image with the quantities that all iterations share."""
    image = padded(left)
    cell_grey = downsample_mean(image, 2)
    return LeftImage(image, cell_grey, rounding_noise(left))


def linearise(left: LeftImage, right: FloatImage, cells: FloatImage) -> Linearisation:
    """Return the data term at a field; slopes are measured in the mean of both images.

    The variance in the information is inflated where residuals exceed it (means over `WINDOW_CELLS`), and everywhere if
    the residuals are correlated between pixels (`block_variance_ratio`).
    """
    residual = photometric_residual(left.image, right, disparity_from_cells(cells, left.image.shape))
    noise = overall_noise(residual, left.min_noise)
    means = cell_means(residual, F(CLIPPING_SIGMAS * noise))
    offset = box_mean(means, WINDOW_CELLS)
    variance = noise_variance(left.cell_grey, residual, offset, left.min_noise)
    template = mean_template(left.image, residual, offset, F(TEMPLATE_SIGMAS * noise))
    equations = normal_equations(slopes(template), residual, offset, F(1.0) / variance, ROBUST_FACTOR)
    mean_chi2 = box_mean(equations.chi2, WINDOW_CELLS)
    mean_weight = np.maximum(box_mean(equations.weight, WINDOW_CELLS), MIN_WEIGHT)
    inflation = np.maximum(mean_chi2 / mean_weight, block_variance_ratio(means, offset, variance))
    return Linearisation(
        residual=residual,
        offset=offset,
        variance=variance,
        information=np.asarray(equations.information / inflation, F),
        information_vector=np.asarray(equations.information_vector / inflation, F),
    )


def _coarse_to_fine_solve(cells: FloatImage, data_term: Linearisation) -> tuple[FloatImage, SmoothnessWeights]:
    """Return the field after one linearised solve on all grids, coarse to fine, and the weights of the finest grid.

    The weights are computed from the field before the last step. The data term of a block is the sum over its cells.
    After each coarse step, the information vector of the remaining change is reduced by the information times the step.
    """
    scale_x, scale_y = cauchy_scale_of(cells)
    information = data_term.information
    information_vector = data_term.information_vector
    for level in range(LEVELS - 1, 0, -1):
        factor = 2**level
        cells_per_block = F(factor * factor)
        coarse_cells = downsample_mean(cells, factor)
        weights = smoothness_weights(
            coarse_cells, downsample_mean(scale_x, factor), downsample_mean(scale_y, factor), F(GRID_FACTOR**level)
        )
        coarse_step = conjugate_gradient_step(
            coarse_cells,
            downsample_mean(information, factor) * cells_per_block,
            downsample_mean(information_vector, factor) * cells_per_block,
            weights,
            SOLVER_ITERATIONS[level],
        )
        step = upsample_bilinear(coarse_step, cells.shape)
        cells = cells + step
        information_vector = information_vector - information * step
    weights = smoothness_weights(cells, scale_x, scale_y, F(1.0))
    step = conjugate_gradient_step(cells, information, information_vector, weights, SOLVER_ITERATIONS[0])
    return cells + step, weights
