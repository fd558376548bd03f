"""The standard deviation of each disparity, caused by noise, smoothing and edges.

The uncertainty of the calibration is added to the sigma of points (`mapping/point_sigma.py`).
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, median
from sfr_loc_map.mapping.disparity.refinement.cell_field import WINDOW_CELLS
from sfr_loc_map.mapping.disparity.refinement.data_term import SLOPE_NOISE_GAIN
from sfr_loc_map.mapping.disparity.refinement.smoothness import SmoothnessWeights
from sfr_loc_map.mapping.filters import box_mean, second_differences, upsample_bilinear

NOISE_INFORMATION = F(SLOPE_NOISE_GAIN)
"""Apparent information of one cell from noise alone, 1 / px^2: four pixels times the variance of a slope, which is
measured in the mean of both images and has a quarter of the residual's variance as its noise."""
MIN_INFORMATION = F(1e-3)  #: Lower bound of the information of a cell, 1 / px^2, which is a divisor.
MAX_SIGMA_PX = F(2.0)
"""Upper bound of the standard deviation, pixels. A larger error is a wrong match, which the validity tests detect."""
SMOOTHING_BIAS = F(0.34)  #: Error in pixels at a second difference of 1 pixel and a smoothing radius of 1 cell.
MAX_CURVATURE_MEDIANS = 10.0
"""For the smoothing bias, second differences are clipped to this multiple of their median. Larger second differences
are creases, which have a separate term."""
CREASE_BIAS = F(1.2)  #: Error in pixels at a second difference of 1 pixel above the median.
CREASE_CELLS = 3  #: Side of the window over which the second difference of a crease is averaged, cells.
MAX_CREASE_PX = F(1.0)
"""Upper bound of the second difference of a crease, pixels: the error beside an edge does not grow with its height."""


def disparity_sigma(
    cells: FloatImage, information: FloatImage, weights: SmoothnessWeights, shape: tuple[int, ...]
) -> FloatImage:
    """Return the standard deviation of each disparity of an image `(H, W)` with the given shape, pixels.

    The field, its information and the weights of its second differences are given on cells `(h, w)`.

    A field with the information h per cell and the smoothness weight s has, under white noise, the variance

        integral d2k / (2 pi)^2 1 / (h + s k^4) = 1 / (8 sqrt(h s))

    at each point. The formula has one weight. Here, s is the geometric mean of the weights along rows and along
    columns; the weight of the mixed second difference is not used. Smoothing adds a bias proportional to the remaining
    curvature and to the square of the smoothing radius, `(s / h)^(1/4)` cells. Creases add an error proportional to
    their curvature. The curvature is the sum of the magnitudes of the second differences along rows and along columns.
    The variance is the sum

        1 / (8 sqrt(h s)) + (SMOOTHING_BIAS curvature)^2 s / h + (CREASE_BIAS crease)^2

    The information, the weights and the curvature are means over `WINDOW_CELLS`, and the crease is a mean over
    `CREASE_CELLS`. The information is reduced by `NOISE_INFORMATION` and is at least `MIN_INFORMATION`. The curvature
    is at most `MAX_CURVATURE_MEDIANS` medians, and the crease is the curvature above the median, from 0 to
    `MAX_CREASE_PX`. Sigma is at most `MAX_SIGMA_PX`.
    """
    field_information = np.maximum(box_mean(information, WINDOW_CELLS) - NOISE_INFORMATION, MIN_INFORMATION)
    weight_x = box_mean(weights.along_x, WINDOW_CELLS)
    weight_y = box_mean(weights.along_y, WINDOW_CELLS)
    weight = np.sqrt(weight_x * weight_y)
    along_x, along_y = second_differences(cells)
    curvature = np.abs(along_x) + np.abs(along_y)
    median_curvature = median(curvature)
    ground_curvature = np.minimum(curvature, F(MAX_CURVATURE_MEDIANS * median_curvature))
    noise_variance = F(0.125) / np.sqrt(field_information * weight)
    bias_squared = np.square(SMOOTHING_BIAS * box_mean(ground_curvature, WINDOW_CELLS)) * (weight / field_information)
    crease_px = np.clip(box_mean(curvature, CREASE_CELLS) - F(median_curvature), F(0.0), MAX_CREASE_PX)
    crease_squared = np.square(CREASE_BIAS * crease_px)
    sigma_of_cells = np.sqrt(noise_variance + bias_squared + crease_squared)
    cell_rows, cell_columns = cells.shape
    sigma = upsample_bilinear(sigma_of_cells, (2 * cell_rows, 2 * cell_columns))
    height, width = shape
    return np.asarray(np.minimum(sigma[:height, :width], MAX_SIGMA_PX), F)
