"""Patches that are warped by their local plane and tracked by least squares.

A patch is warped from its host image by the homography of its plane. Only the remaining shift is then estimated, by
Gauss-Newton on the difference of the two patches, each normalised to the same mean and contrast (Lucas and Kanade
1981; Baker and Matthews 2004). Its derivatives in the target are those in the host, multiplied by the inverse
transpose of the warp's derivative, so their products follow from those of the template.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import (
    MIN_POWER,
    LocalWarp,
    PatchPixels,
    Templates,
    half_width,
    local_warp,
    patch_pixels,
    products_with_samples,
    warp_pixels,
    warped_normal,
)

MIN_DETERMINANT = 0.05  #: Smallest area to which a warp may shrink a pixel, pixels.
MAX_SPAN_PX = 60.0  #: Largest extent of a warped patch, pixels.
MAX_DEPTH_CHANGE = 0.99  #: Largest change of the depth from the centre of a patch to a corner, over the depth.
MAX_STEP_PX = 1.5  #: Largest step of one iteration.
CONVERGED_PX, FINISHED_PX = 0.03, 0.01
"""Last step of a track that has converged, and the step below which no further iteration follows."""


class PatchTracks(NamedTuple):
    """Tracks of N patches in an image; NaN where one left the image, has no texture, did not converge, or differs."""

    uv: FloatArray  #: `(N, 2)` position of the patch centre, pixels.
    covariance: FloatArray  #: `(N, 3)` uu, uv, vv of that position for a noise of one grey level, px^2.
    residual: FloatArray  #: `(N,)` RMS, grey levels of the patch.
    correlation: FloatArray  #: `(N,)` normalised cross-correlation with the image.


class TrackingLimits(NamedTuple):
    """What a track has to keep."""

    max_shift: float  #: Largest accepted shift, pixels.
    iterations: int  #: Most Gauss-Newton iterations.
    min_correlation: float  #: Smallest accepted correlation.


@jit_fast_inline
def _track(
    image: FloatImage,
    templates: Templates,
    n: int,
    warped: LocalWarp,
    pixels: PatchPixels,
    limits: TrackingLimits,
    tracks: PatchTracks,
) -> None:
    """Estimate the shift of a warped patch by Gauss-Newton; fill its track if there is one."""
    template, moments, half = templates.values[n], templates.moments[n], half_width(pixels.x.size)
    power, det = moments[0], warped.xu * warped.yv - warped.xv * warped.yu
    # what is in front of the camera at its corners lies between them
    if abs(det) < MIN_DETERMINANT or power == 0.0 or half * (abs(warped.wu) + abs(warped.wv)) > MAX_DEPTH_CHANGE:
        return
    normal = warped_normal(warped, det, moments[3], moments[4], moments[5])
    det = normal.xx * normal.yy - normal.xy * normal.xy
    if det <= 1e-6 * (normal.xx + normal.yy) ** 2:
        return
    warp_pixels(pixels, warped)
    # the corners span the patch
    x, y, side, last = pixels.x, pixels.y, 2 * half, pixels.x.size - 1
    low_x = warped.x + min(x[0], x[side], x[last - side], x[last])
    high_x = warped.x + max(x[0], x[side], x[last - side], x[last])
    low_y = warped.y + min(y[0], y[side], y[last - side], y[last])
    high_y = warped.y + max(y[0], y[side], y[last - side], y[last])
    if high_x - low_x > MAX_SPAN_PX or high_y - low_y > MAX_SPAN_PX:
        return
    height, width = image.shape
    sx, sy, residual, correlation = 0.0, 0.0, 0.0, -1.0
    converged = False
    for _ in range(limits.iterations):
        converged = False
        if max(abs(sx), abs(sy)) > limits.max_shift or low_x + sx < 0.0 or low_y + sy < 0.0:
            break
        if high_x + sx >= width - 1.001 or high_y + sy >= height - 1.001:
            break
        found = products_with_samples(image, x, y, np.float32(warped.x + sx), np.float32(warped.y + sy), template)
        if found.power < MIN_POWER:
            break
        # the derivatives are orthogonal to the template, so only the target enters
        gain = np.sqrt(power / found.power)
        bx = gain * (normal.b00 * found.x + normal.b01 * found.y)
        by = gain * (normal.b10 * found.x + normal.b11 * found.y)
        correlation = found.grey / np.sqrt(power * found.power)
        residual = np.sqrt(max(2.0 * power * (1.0 - correlation), 0.0) / pixels.x.size)
        dx, dy = (normal.yy * bx - normal.xy * by) / det, (normal.xx * by - normal.xy * bx) / det
        step = max(abs(dx), abs(dy))
        limit = MAX_STEP_PX / step if step > MAX_STEP_PX else 1.0
        sx -= limit * dx
        sy -= limit * dy
        converged = step < CONVERGED_PX
        if step < FINISHED_PX:
            break
    if converged and correlation >= limits.min_correlation:
        cov = tracks.covariance[n]
        cov[0], cov[1], cov[2] = normal.yy / det, -normal.xy / det, normal.xx / det
        tracks.uv[n, 0], tracks.uv[n, 1] = warped.x + sx, warped.y + sy
        tracks.residual[n], tracks.correlation[n] = residual, correlation


@jit_fast
def track_patches(
    image: FloatImage, templates: Templates, host_uv: FloatArray, homographies: FloatArray, limits: TrackingLimits
) -> PatchTracks:
    """Find patches in an image, from their host pixels `(N, 2)` and homographies `(N, 3, 3)` from host to target."""
    count, size = len(host_uv), templates.values.shape[2]
    tracks = PatchTracks(
        np.full((count, 2), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan), np.full(count, np.nan)
    )
    pixels = patch_pixels(size)
    for n in range(count):
        warped = local_warp(homographies[n], host_uv[n, 0], host_uv[n, 1])
        _track(image, templates, n, warped, pixels, limits, tracks)
    return tracks
