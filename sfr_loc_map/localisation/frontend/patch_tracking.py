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
    Patch,
    PatchPixels,
    Templates,
    WarpedNormal,
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


class _Place(NamedTuple):
    """Warped centre of a patch, and the bounding box of its warped pixels."""

    x: float
    y: float
    low_x: float
    low_y: float
    high_x: float
    high_y: float


@jit_fast_inline
def _place(pixels: PatchPixels, warped: LocalWarp) -> _Place:
    """Return where the warped pixels of a patch are; those of its corners span them."""
    x, y, side, last = pixels.x, pixels.y, 2 * half_width(pixels.x.size), pixels.x.size - 1
    low_x, high_x = min(x[0], x[side], x[last - side], x[last]), max(x[0], x[side], x[last - side], x[last])
    low_y, high_y = min(y[0], y[side], y[last - side], y[last]), max(y[0], y[side], y[last - side], y[last])
    return _Place(warped.x, warped.y, warped.x + low_x, warped.y + low_y, warped.x + high_x, warped.y + high_y)


@jit_fast_inline
def _normal(moments: FloatArray, warped: LocalWarp) -> WarpedNormal:
    """Return the normal matrix of a template of some moments `(6,)` in the target; all 0 if it cannot be tracked."""
    nothing = WarpedNormal(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    det = warped.xu * warped.yv - warped.xv * warped.yu
    if abs(det) < MIN_DETERMINANT or moments[0] == 0.0:
        return nothing
    normal = warped_normal(warped, det, moments[3], moments[4], moments[5])
    if normal.xx * normal.yy - normal.xy * normal.xy <= 1e-6 * (normal.xx + normal.yy) ** 2:
        return nothing
    return normal


@jit_fast_inline
def _track(
    image: FloatImage,
    place: _Place,
    normal: WarpedNormal,
    pixels: PatchPixels,
    template: Patch,
    power: float,
    limits: TrackingLimits,
    tracks: PatchTracks,
    n: int,
) -> None:
    """Estimate the shift of a warped patch, whose template has some power, by Gauss-Newton; fill its track."""
    height, width = image.shape
    det = normal.xx * normal.yy - normal.xy * normal.xy
    sx, sy, residual, correlation = 0.0, 0.0, 0.0, -1.0
    converged = False
    for _ in range(limits.iterations):
        converged = False
        if max(abs(sx), abs(sy)) > limits.max_shift or place.low_x + sx < 0.0 or place.low_y + sy < 0.0:
            break
        if place.high_x + sx >= width - 1.001 or place.high_y + sy >= height - 1.001:
            break
        x, y = np.float32(place.x + sx), np.float32(place.y + sy)
        found = products_with_samples(image, pixels.x, pixels.y, x, y, template)
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
        tracks.uv[n, 0], tracks.uv[n, 1] = place.x + sx, place.y + sy
        tracks.residual[n], tracks.correlation[n] = residual, correlation


@jit_fast
def track_patches(
    image: FloatImage, templates: Templates, host_uv: FloatArray, homographies: FloatArray, limits: TrackingLimits
) -> PatchTracks:
    """Find patches in an image, from their host pixels `(N, 2)` and homographies `(N, 3, 3)` from host to target."""
    values, moments = templates.values, templates.moments
    count, size = len(values), values.shape[2]
    tracks = PatchTracks(
        np.full((count, 2), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan), np.full(count, np.nan)
    )
    pixels, half = patch_pixels(size), half_width(size)
    for n in range(count):
        warped = local_warp(homographies[n], host_uv[n, 0], host_uv[n, 1])
        normal = _normal(moments[n], warped)
        # what is in front of the camera at its corners lies between them
        if normal.xx + normal.yy == 0.0 or half * (abs(warped.wu) + abs(warped.wv)) > MAX_DEPTH_CHANGE:
            continue
        warp_pixels(pixels, warped)
        place = _place(pixels, warped)
        if place.high_x - place.low_x > MAX_SPAN_PX or place.high_y - place.low_y > MAX_SPAN_PX:
            continue
        _track(image, place, normal, pixels, values[n], moments[n, 0], limits, tracks, n)
    return tracks
