"""The vertical disparity of a pair as a polynomial, by robust least squares on photometric residuals.

Content of the right image that is s pixels lower than in the left image changes the residual by minus s times the slope
of the image along the column. A fit is one Gauss-Newton step, whose linearisation is valid within about one pixel.

The disparity was estimated from the same residuals. Where edges are oblique, an error of the disparity has therefore
already explained a part of the vertical disparity. `fit_vertical_disparity` ignores this error and returns too small
values if the vertical disparity is large. `fit_jointly_with_disparity` fits a correction of the disparity, too.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.robust_statistics import cauchy_weight, mad_sigma
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.photometric_residual import cubic, photometric_residual

SAMPLING_STRIDE = 3  #: Every third pixel of every third row is used.
HALF_WEIGHT_SIGMAS = 2.0  #: Residuals of this many standard deviations have half the weight (`cauchy_weight`).
MIN_GREY_SIGMA = 1e-3  #: Added to the standard deviation of residuals, grey levels, which is a divisor.
DAMPING = 1e-9  #: Added to the diagonal of the normal equations, as a fraction of their trace.
FREE_BLOCK_PX = 8  #: Side of the blocks whose disparity is free in `fit_jointly_with_disparity`, pixels.
MIN_SLOPE_SUM = 1e-6  #: Added to the sum of the squared slopes along the row in a block, which is a divisor.
SMOOTHING = np.array([[0.125, 0.25, 0.125]], F)
"""Taps of the Sobel operator across the derivative, scaled to slopes per pixel for differences over two pixels."""
SOBEL_SCALE = 0.125  #: Scale of the Sobel operator for slopes per pixel.


class VerticalPolynomial(NamedTuple):
    """A vertical disparity `constant + along_x x + along_y y + saddle x y + along_yy y^2`, pixels.

    x and y are normalised coordinates in the right image. Content of the right image is lower than in the left image
    where the value is positive.
    """

    constant: float = 0.0  #: Vertical disparity at the principal point.
    along_x: float = 0.0
    along_y: float = 0.0
    saddle: float = 0.0
    along_yy: float = 0.0

    def plus(self, other: VerticalPolynomial) -> VerticalPolynomial:
        """Return the sum of two polynomials."""
        return VerticalPolynomial(*(one + another for one, another in zip(self, other, strict=True)))

    def at_pixels(self, column: FloatArray, row: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return the vertical disparity at pixels of the right image, pixels; columns and rows are broadcast."""
        x, y = _normalised(column, row, camera)
        return self.constant + self.along_x * x + self.along_y * y + self.saddle * x * y + self.along_yy * y * y


LINEAR_TERMS = 3  #: Number of the terms that are constant or linear.
ALL_TERMS = 5  #: Number of all terms of a `VerticalPolynomial`.


class VerticalFit(NamedTuple):
    """Least-squares fit of the first terms of a vertical disparity; the other terms are 0."""

    polynomial: VerticalPolynomial
    sigmas: VerticalPolynomial  #: Standard deviations of the coefficients.


def _normalised(column: FloatArray, row: FloatArray, camera: StereoCamera) -> tuple[FloatArray, FloatArray]:
    """Return the normalised coordinates x and y of columns and of rows."""
    return (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy


def fit_vertical_disparity(
    left: FloatImage,
    right: FloatImage,
    disparity_px: FloatImage,
    camera: StereoCamera,
    *,
    term_count: int,
    min_count: int,
    used: Mask | None = None,
) -> VerticalFit | None:
    """Return the first `term_count` terms of the vertical disparity; None if too few pixels or no slopes are available.

    The disparity `(H, W)` is defined everywhere. `used` is the mask of the pixels that may be used; None means all
    pixels.
    """
    sampled = np.s_[::SAMPLING_STRIDE, ::SAMPLING_STRIDE]
    residual = photometric_residual(left, right, disparity_px)
    usable = np.isfinite(residual[sampled])
    if used is not None:
        usable &= used[sampled]
    row, column = np.nonzero(usable)
    if len(row) < min_count:
        return None
    r = residual[sampled][usable].astype(np.float64)
    slope = _sampled_slopes(_mean_image(left, residual))[usable].astype(np.float64)
    right_column = np.float64(SAMPLING_STRIDE) * column - disparity_px[sampled][usable].astype(np.float64)
    right_row = np.float64(SAMPLING_STRIDE) * row
    sigma = mad_sigma(r) + MIN_GREY_SIGMA
    terms = _terms(right_column, right_row, camera, term_count)
    return _solved(terms * slope[:, None], cauchy_weight(r, HALF_WEIGHT_SIGMAS * sigma), r, sigma)


def fit_jointly_with_disparity(
    left: FloatImage, right: FloatImage, disparity_px: FloatImage, camera: StereoCamera, used: Mask, *, min_count: int
) -> VerticalFit | None:
    """Return all terms of the vertical disparity, fitted together with a change of the disparity in each block.

    The disparity `(H, W)` may have an unknown error that is constant in each block of `FREE_BLOCK_PX` pixels. With the
    slopes gx along the row and gy along the column and the weights w, the elimination of this error from the normal
    equations replaces gy by `gy - gx sum w gx gy / sum w gx^2`, with the sums over the block (Frisch and Waugh 1933).

    `used` `(H, W)` is the mask of the pixels that may be used. Returns None if fewer than `min_count` of them are in
    complete blocks, or if no slopes are available.
    """
    residual = photometric_residual(left, right, disparity_px)
    usable = np.isfinite(residual) & used
    height, width = (side // FREE_BLOCK_PX * FREE_BLOCK_PX for side in left.shape)
    usable[height:] = False
    usable[:, width:] = False
    row, column = np.nonzero(usable)
    if len(row) < min_count:
        return None
    r = residual[usable].astype(np.float64)
    sigma = mad_sigma(r) + MIN_GREY_SIGMA
    weight = np.zeros(left.shape)
    weight[usable] = cauchy_weight(r, HALF_WEIGHT_SIGMAS * sigma)
    mean = _mean_image(left, residual)
    slope_x = np.asarray(cv2.Sobel(mean, cv2.CV_64F, 1, 0, scale=SOBEL_SCALE), np.float64)
    slope_y = np.asarray(cv2.Sobel(mean, cv2.CV_64F, 0, 1, scale=SOBEL_SCALE), np.float64)
    common = _block_sums(weight * slope_x * slope_y) / (_block_sums(weight * slope_x * slope_x) + MIN_SLOPE_SUM)
    slope_y[:height, :width] -= common * slope_x[:height, :width]
    terms = _terms(column.astype(np.float64) - disparity_px[usable], row.astype(np.float64), camera, ALL_TERMS)
    return _solved(terms * slope_y[usable][:, None], weight[usable], r, sigma)


def _terms(column: FloatArray, row: FloatArray, camera: StereoCamera, count: int) -> FloatArray:
    """Return the first terms of a `VerticalPolynomial` without their coefficients `(N, count)`.

    The columns and rows `(N,)` are positions in the right image.
    """
    x, y = _normalised(column, row, camera)
    return np.column_stack((np.ones(len(x)), x, y, x * y, y * y)[:count])


def _mean_image(left: FloatImage, residual: FloatImage) -> FloatImage:
    """Return the mean of the left image and the warped right image; the left image where the residual is NaN."""
    return np.asarray(cv2.scaleAdd(cv2.patchNaNs(residual.copy(), 0.0), 0.5, left), F)


def _block_sums(values: FloatArray) -> FloatArray:
    """Return at each pixel of the complete blocks of an image `(H, W)` the sum over the block."""
    rows, columns = (side // FREE_BLOCK_PX for side in values.shape)
    inside = values[: rows * FREE_BLOCK_PX, : columns * FREE_BLOCK_PX]
    sums = inside.reshape(rows, FREE_BLOCK_PX, columns, FREE_BLOCK_PX).sum(axis=(1, 3))
    return np.asarray(sums.repeat(FREE_BLOCK_PX, axis=0).repeat(FREE_BLOCK_PX, axis=1), np.float64)


def _solved(design: FloatArray, weight: FloatArray, r: FloatArray, sigma: float) -> VerticalFit | None:
    """Return the coefficients c that minimise the weighted sum of squares of r + D c, with their standard deviations.

    r are residuals `(N,)`, and D is a design `(N, K)`. None if the weighted design is zero.
    """
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    if not normal.any():
        return None
    covariance = np.linalg.inv(normal + DAMPING * np.trace(normal) * np.eye(len(normal)))
    coefficients = -(covariance @ (weighted.T @ r))
    sigmas = sigma * np.sqrt(np.diag(covariance))
    return VerticalFit(VerticalPolynomial(*coefficients.tolist()), VerticalPolynomial(*sigmas.tolist()))


def without_vertical_disparity(image: FloatImage, vertical: VerticalPolynomial, camera: StereoCamera) -> FloatImage:
    """Return the right image `(H, W)` with its rows shifted up by the vertical disparity."""
    height, width = image.shape
    columns = np.arange(width, dtype=np.float64)[None]
    rows = np.arange(height, dtype=np.float64)[:, None]
    return shift_rows(image, vertical.at_pixels(columns, rows, camera).astype(F))


@jit_rows
def shift_rows(image: FloatImage, shift: FloatImage) -> FloatImage:
    """Return the image at rows `v + shift`, with `shift` `(H, W)` in pixels; the border is repeated."""
    rows, cols = image.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            v = min(max(F(y) + shift[y, x], F(0.0)), F(rows - 1))
            k = int(v)
            p0 = image[max(k - 1, 0), x]
            p1 = image[k, x]
            p2 = image[min(k + 1, rows - 1), x]
            p3 = image[min(k + 2, rows - 1), x]
            out[y, x] = cubic(p0, p1, p2, p3, v - F(k))
    return out


def _sampled_slopes(image: FloatImage) -> FloatImage:
    """Return the slope along the column at the samples, grey levels per pixel.

    The Sobel operator is applied only to the rows of the samples.
    """
    rows = np.pad(np.arange(len(image)), 1, mode="reflect")  # the image is mirrored at its border
    rows_above = rows[:-2:SAMPLING_STRIDE]
    rows_below = rows[2::SAMPLING_STRIDE]
    difference = image.take(rows_below, axis=0) - image.take(rows_above, axis=0)
    return np.asarray(cv2.filter2D(difference, -1, SMOOTHING)[:, ::SAMPLING_STRIDE], F)
