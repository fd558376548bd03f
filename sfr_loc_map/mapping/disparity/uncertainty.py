"""The standard deviation of each refined disparity."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.median import median
from sfr_loc_map.mapping.disparity.filters import box_mean, second_differences, upsample_bilinear
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity

F = np.float32

NOISE_INFORMATION = F(0.2026)
"""Information that noise alone simulates in one cell: four times the energy of the slope's taps over four, for the mean
of two images has a quarter of the residual's variance."""
MAX_SIGMA_PX = F(2.0)
WINDOW_CELLS = 9
SHAPE_SHARE = F(0.34)
"""Error for each pixel of second difference and square cell of smoothing radius."""
CREASE_SHARE = F(1.2)
"""Error for each pixel by which the second difference within 3 x 3 cells exceeds its median: beside edges and creases
the field is off by as much as it bends. Both shares were found on several rendered grounds, lights and cameras at once.
"""
MAX_CREASE_PX = F(1.0)
"""Larger second differences are edges between surfaces; the error beside them does not grow with their height."""
EDGE_FACTOR = 10.0
"""Second differences beyond so many times the median are edges, no shape of the ground."""


def disparity_sigma(refined: RefinedDisparity) -> FloatImage:
    """Return the standard deviation of each disparity `(H, W)` float32, pixels.

    A field with information h per cell and smoothness weight s has, under white noise, the variance
    `integral d2k / (2 pi)^2 1 / (h + s k^4) = 1 / (8 sqrt(h s))` at each point. To that come the bias of smoothing,
    which grows with the second differences that are left and with the square of the smoothing radius,
    `(s / h)^(1/4)` cells, and the error beside creases.
    """
    height, width = refined.disparity_px.shape
    information = np.maximum(box_mean(refined.information, WINDOW_CELLS) - NOISE_INFORMATION, F(1e-3))
    weight = np.sqrt(box_mean(refined.weights.along_x, WINDOW_CELLS) * box_mean(refined.weights.along_y, WINDOW_CELLS))
    curvature = _curvature(refined.cells_px)
    typical = median(curvature)
    of_ground = box_mean(np.minimum(curvature, F(EDGE_FACTOR * typical)), WINDOW_CELLS)
    noise = F(0.125) / np.sqrt(information * weight)
    bias = np.square(SHAPE_SHARE * of_ground) * (weight / information)
    crease = np.square(CREASE_SHARE * np.clip(box_mean(curvature, 3) - F(typical), F(0.0), MAX_CREASE_PX))
    sigma = upsample_bilinear(np.sqrt(noise + bias + crease), (2 * noise.shape[0], 2 * noise.shape[1]))
    return np.asarray(np.minimum(sigma[:height, :width], MAX_SIGMA_PX), F)


def _curvature(cells: FloatImage) -> FloatImage:
    """Return the size of the second differences along both axes, pixels."""
    along_x, along_y = second_differences(cells)
    return np.asarray(np.abs(along_x) + np.abs(along_y), F)
