"""Sub-pixel disparity from the pictures themselves.

The field that is sought minimises, over cells of 2 x 2 pixels,

    sum (r - g s)^2 / variance  +  sum stiffness (second differences of the field)^2

r being the right picture warped by the present field minus the left one, g its slope along the row, s the change: all
pixels' shifts at once, tied by the smoothness of the ground instead of by a window that assumes a plane. Noise and the
ground's roughness are measured in the pictures, so that smoothing adapts; second differences far beyond the usual (the
edges of rocks) lose their stiffness. Each round warps anew and solves on three grids, coarse to fine, by conjugate
gradients.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.mapping import disparity_grid as grid
from sfr_loc_map.mapping import photometric_residual as photometry
from sfr_loc_map.mapping import regularisation as bending
from sfr_loc_map.mapping.filters import box_mean, enlarged, reduced, repeated
from sfr_loc_map.mapping.rectification_correction import Alignment, align

F = np.float32

LEVELS = 3
"""Grids of one round: cells of 2, 4 and 8 pixels."""
PAD = 2**LEVELS
"""Pictures are padded to a multiple of this."""
ROUNDS = 3
ITERATIONS = (8, 12, 12)
"""Conjugate gradient steps on each grid, finest first."""
JUMP_PX = F(1.0)
"""Neighbouring cells that differ more belong to two surfaces."""
BOX = 9
"""Side in cells over which brightness offset and noise level are averaged."""
TAIL = F(1.0 / 25.0)
"""Residuals of five standard deviations have half their weight."""
LEAST_NOISE = 0.3
"""Standard deviation that whole grey levels alone give a residual, about."""
ROUGHNESS_CELLS = 4
"""Spacing of the second differences by which roughness is measured: far enough apart to rise above the noise."""
ROUGHNESS_FACTOR = 10.0 / ROUGHNESS_CELLS**2
GRID_FACTOR = 2.8
"""Growth of second differences with each doubling of the spacing: `2^1.5`, between a fractal and a smooth surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined field and what is needed to judge it.

    Attributes:
        disparity_px: `(H, W)` float32, pixels, without holes.
        cells_px: `(H/2, W/2)` float32, pixels, the field on cells, padded.
        information: `(H/2, W/2)` float32, 1 / pixels^2 of one cell.
        stiffness: `(2, H/2, W/2)` float32, of second differences along rows and columns, 1 / pixels^2.
        misfit: `(H, W)` float32, residual over its standard deviation; NaN outside the right picture.
        noise: Standard deviation of a residual, grey levels.
        right: `(H, W)` float32, the right picture set right.
        alignment: How it had to be.
    """

    disparity_px: FloatImage
    cells_px: FloatImage
    information: FloatImage
    stiffness: FloatImage
    misfit: FloatImage
    noise: float
    right: FloatImage
    alignment: Alignment


def refine(left: FloatImage, right: FloatImage, initial_px: FloatImage) -> Refined:
    """Return the disparity field that fits the pictures best.

    Args:
        left: `(H, W)` float32 grey.
        right: `(H, W)` float32 grey.
        initial_px: `(H, W)` float32, pixels, right to about a pixel; NaN where unknown.
    """
    height, width = left.shape
    left, right, initial_px = (padded(image) for image in (left, right, initial_px))
    cells = grid.filled(grid.cells_of(initial_px, JUMP_PX))
    for tolerance in (JUMP_PX, F(0.7) * JUMP_PX):
        cells = grid.levelled(cells, 3, tolerance)
    alignment, right = align(left, right, grid.pixels_of(cells, JUMP_PX))
    stiffness = np.empty((3, *cells.shape), F)
    for _ in range(ROUNDS):
        data = _data(left, right, cells)
        cells = _solved(cells, data.equations[0], data.equations[1], stiffness)
    data = _data(left, right, cells)
    deviation = np.sqrt(data.variance)
    misfit = (data.residual - repeated(data.offset)) / repeated(deviation)
    return Refined(
        grid.pixels_of(cells, JUMP_PX)[:height, :width],
        cells,
        data.equations[0],
        stiffness[:2],
        misfit[:height, :width],
        float(np.median(deviation)),
        np.ascontiguousarray(right[:height, :width]),
        alignment,
    )


def padded(image: FloatImage) -> FloatImage:
    """Return the picture with its last rows and columns repeated up to a multiple of `PAD`."""
    below, beside = -image.shape[0] % PAD, -image.shape[1] % PAD
    return np.ascontiguousarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), F)


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    residual: FloatImage
    offset: FloatImage
    variance: FloatImage
    equations: FloatImage


def _data(left: FloatImage, right: FloatImage, cells: FloatImage) -> _Data:
    """Return residuals, their brightness offset and variance, and the normal equations of each cell."""
    residual = photometry.residual_of(left, right, grid.pixels_of(cells, JUMP_PX))
    some = residual[::8, ::4]
    some = some[np.isfinite(some)]
    noise = max(1.4826 * float(np.median(np.abs(some - np.median(some)))), LEAST_NOISE) if len(some) else LEAST_NOISE
    offset = box_mean(photometry.cell_means(residual, F(3.0 * noise)), BOX)
    variance = noise_variance(left, residual, offset)
    template = photometry.template_of(left, residual, offset, F(4.0 * noise))
    equations = np.empty((4, *cells.shape), F)
    photometry.normal_equations(template, residual, offset, F(1.0) / variance, TAIL, equations)
    excess = box_mean(equations[2], BOX) / np.maximum(box_mean(equations[3], BOX), F(0.1))
    equations[:2] /= np.maximum(excess, F(1.0))
    return _Data(residual, offset, variance, equations)


def noise_variance(left: FloatImage, residual: FloatImage, offset: FloatImage) -> FloatImage:
    """Return the variance of a residual in each cell, as the straight line over the grey level that fits best.

    A camera's noise has a constant part and one that grows with the light (photon noise).
    """
    grey = reduced(left, 2)
    sample = np.abs(residual[::8, ::4] - offset[::4, ::2]).ravel()
    level = grey[::4, ::2].ravel()
    order = np.argsort(level[np.isfinite(sample)], kind="stable")
    level, sample = level[np.isfinite(sample)][order], sample[np.isfinite(sample)][order]
    if len(level) < 8 * 50:
        return np.full(offset.shape, 25.0, F)
    centre = np.array([part.mean() for part in np.array_split(level, 8)], np.float64)
    variance = np.array([(1.4826 * float(np.median(part))) ** 2 for part in np.array_split(sample, 8)])
    variance = np.maximum(variance, LEAST_NOISE**2)
    weight = 1.0 / np.square(variance)
    middle = np.average(centre, weights=weight)
    spread = float(np.average(np.square(centre - middle), weights=weight))
    mean = float(np.average(variance, weights=weight))
    slope = float(np.average((centre - middle) * (variance - mean), weights=weight)) / max(spread, 1.0)
    model = F(mean) + F(slope) * (grey - F(middle))
    return np.asarray(np.clip(model, F(variance.min()), F(variance.max())), F)


def _roughness(cells: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the usual size of the field's second differences along rows and columns around each cell, pixels."""
    coarse = reduced(cells, ROUGHNESS_CELLS)
    kernel = np.array([[1.0, -2.0, 1.0]], F)
    scales = []
    for taps in (kernel, kernel.T):
        size = np.abs(np.asarray(cv2.filter2D(coarse, -1, taps, borderType=cv2.BORDER_REPLICATE), F))
        usual = max(float(np.median(size)), 1e-3)
        local = np.square(box_mean(np.sqrt(np.minimum(size, F(10.0 * usual))), BOX))
        local = box_mean(np.maximum(local, F(0.1 * usual)), 5)
        scales.append(enlarged(local, cells.shape) * F(ROUGHNESS_FACTOR))
    return scales[0], scales[1]


def _solved(cells: FloatImage, hessian: FloatImage, gradient: FloatImage, stiffness: FloatImage) -> FloatImage:
    """Return the field after one linearised solve on all grids; `stiffness` is filled with that of the finest."""
    scale_x, scale_y = _roughness(cells)
    for level in range(LEVELS - 1, 0, -1):
        factor = 2**level
        field, coarse_x, coarse_y = (reduced(image, factor) for image in (cells, scale_x, scale_y))
        sums, pulls = (reduced(image, factor) * F(factor * factor) for image in (hessian, gradient))
        weights = np.empty((3, *field.shape), F)
        bending.stiffness_of(field, coarse_x, coarse_y, F(GRID_FACTOR**level), weights)
        step = enlarged(bending.solved_step(field, sums, pulls, weights, ITERATIONS[level]), cells.shape)
        cells = cells + step
        gradient = gradient - hessian * step
    bending.stiffness_of(cells, scale_x, scale_y, F(1.0), stiffness)
    return cells + bending.solved_step(cells, hessian, gradient, stiffness, ITERATIONS[0])
