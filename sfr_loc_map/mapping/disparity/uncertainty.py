"""The standard deviation of each refined disparity."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.mapping.disparity.filters import box_mean, second_differences, upsample_bilinear
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity

F = np.float32

NOISE_INFORMATION = F(0.2026)
"""Information that noise alone simulates in one cell: four times the energy of the slope's taps over four, for the mean
of two images has a quarter of the residual's variance."""
MAX_SIGMA_PX = F(2.0)
NOISE_EXCESS = 0.85
"""Measured over theoretical standard deviation on flat ground."""
SHAPE_SHARE = 0.34
"""Error for each pixel of second difference and square cell of smoothing radius. Both factors were found on several
rendered grounds, lights and cameras at once; they are the same everywhere."""


def disparity_sigma(refined: RefinedDisparity) -> FloatImage:
    """Return the standard deviation of each disparity `(H, W)` float32, pixels.

    A field with information h per cell and smoothness weight s has, under white noise, the variance
    `integral d2k / (2 pi)^2 1 / (h + s k^4) = 1 / (8 sqrt(h s))` at each point. To that comes the bias of smoothing,
    which grows with the second differences that are left and with the square of the smoothing radius,
    `(s / h)^(1/4)` cells.
    """
    height, width = refined.disparity_px.shape
    information = np.maximum(box_mean(refined.information, 5) - NOISE_INFORMATION, F(1e-3))
    weight_x, weight_y = box_mean(refined.weights.along_x, 5), box_mean(refined.weights.along_y, 5)
    weight = np.sqrt(weight_x * weight_y)
    noise = F(0.125 * NOISE_EXCESS**2) / np.sqrt(information * weight)
    bias = np.square(SHAPE_SHARE * _curvature(refined.cells_px)) * (weight / information)
    sigma = upsample_bilinear(np.sqrt(noise + bias), (2 * noise.shape[0], 2 * noise.shape[1]))[:height, :width]
    return np.asarray(np.minimum(sigma, MAX_SIGMA_PX), F)


def _curvature(cells: FloatImage) -> FloatImage:
    """Return the mean size of second differences along both axes around each cell, pixels."""
    along_x, along_y = second_differences(cells)
    return box_mean(np.abs(along_x) + np.abs(along_y), 5)
