"""Tracking of patches: each patch is warped by its local plane, then its shift is estimated by least squares.

Warp: the pixel at the offset (i, j) from the centre of a host patch is compared with the pixel

    (x, y) = warp(i, j) + (shift_x, shift_y)

of the image, where `warp` is the homography of the plane (`plane_warp.LocalWarp`). Only the shift is estimated, by
Gauss-Newton on the difference of the two patches, both normalised to the same mean and contrast (Lucas and Kanade
1981). As in the inverse compositional method (Baker and Matthews 2004, section 3.2), the derivatives are those of the
template. The inverse transpose of the warp's Jacobian transforms them to the target image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.patch import (
    MIN_POWER,
    POWER,
    SAMPLED_PX,
    XX,
    XY,
    YY,
    PatchPixels,
    Templates,
    half_width,
    patch_pixels,
    products_with_samples,
    warp_pixels,
    warped_normal,
)
from sfr_loc_map.localisation.frontend.plane_warp import LocalWarp, local_warp

MIN_DETERMINANT = 0.05
"""Minimum determinant of a warp, which is the area, px^2, that a pixel of the host covers in the target. At 0.05, a
patch of 11 x 11 px has shrunk to 2.5 x 2.5 px, which are too few to show texture."""
MAX_SPAN_PX = 60.0
"""Maximum extent of a warped patch, px. At 60 px, samples are 6 px apart and skip the texture between them."""
MAX_DEPTH_CHANGE = 0.99
"""Maximum relative change of the depth from the centre of a patch to a corner. At 1 the corner reaches the plane of the
camera, where the homography is infinite."""
MIN_TEXTURE_RATIO = 1e-6
"""Minimum ratio of the determinant of a normal matrix to its squared trace, for texture in two directions. The ratio
must exceed the relative error of sums in float32, 1e-7."""
MAX_STEP_PX = 1.5
"""Maximum step of one iteration, px. The linearisation of the smoothed image is valid over about one pixel, and longer
steps leave the texture around the initial position."""
CONVERGED_PX = 0.03
"""Maximum last step of a converged track, px: a third of the usual residual of an inlier (0.1 px)."""
FINISHED_PX = 0.01
"""Step below which the iterations end, px. An earlier value was 0.004 px: measurements/localiser_trials.md, "Beside
other methods, and the changes that followed"."""


class PatchTracks(NamedTuple):
    """Tracks of N patches in an image.

    A row is NaN if the patch left the image, has no texture, did not converge, or has too low a correlation.
    """

    uv: FloatArray  #: `(N, 2)` position of the patch centre, pixels.
    covariance: FloatArray  #: `(N, 3)` uu, uv, vv of the position for an image noise of one grey level, px^2.
    residual: FloatArray  #: `(N,)` RMS of the residual, grey levels of the template.
    correlation: FloatArray  #: `(N,)` normalised cross-correlation with the image.


class TrackingLimits(NamedTuple):
    """Limits of a track."""

    max_shift: float  #: Maximum shift, pixels.
    iterations: int  #: Maximum number of Gauss-Newton iterations.
    min_correlation: float  #: Minimum normalised cross-correlation.


class _Box(NamedTuple):
    """Bounding box of a warped patch in the image, pixels."""

    left: float
    right: float
    top: float
    bottom: float


@jit_fast_ir_inline
def _bounding_box(warped: LocalWarp, pixels: PatchPixels, half: int) -> _Box:
    """Return the bounding box of a warped patch from its corners."""
    x = pixels.x
    y = pixels.y
    side = 2 * half
    last = x.size - 1
    left = warped.x + min(x[0], x[side], x[last - side], x[last])
    right = warped.x + max(x[0], x[side], x[last - side], x[last])
    top = warped.y + min(y[0], y[side], y[last - side], y[last])
    bottom = warped.y + max(y[0], y[side], y[last - side], y[last])
    return _Box(left, right, top, bottom)


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
    """Estimate the shift of a warped patch by Gauss-Newton; fill its track if it converges."""
    template = templates.values[n]
    moments = templates.moments[n]
    half = half_width(pixels.x.size)
    power = moments[POWER]
    determinant = warped.xu * warped.yv - warped.xv * warped.yu
    # If the corners are in front of the camera, all pixels between them are in front of it, too.
    is_in_front = half * (abs(warped.wu) + abs(warped.wv)) <= MAX_DEPTH_CHANGE
    if abs(determinant) < MIN_DETERMINANT or power == 0.0 or not is_in_front:
        return
    normal = warped_normal(warped, determinant, moments[XX], moments[XY], moments[YY])
    normal_determinant = normal.xx * normal.yy - normal.xy * normal.xy
    if normal_determinant <= MIN_TEXTURE_RATIO * (normal.xx + normal.yy) ** 2:
        return
    warp_pixels(pixels, warped)
    box = _bounding_box(warped, pixels, half)
    if box.right - box.left > MAX_SPAN_PX or box.bottom - box.top > MAX_SPAN_PX:
        return
    height, width = image.shape
    shift_x = 0.0
    shift_y = 0.0
    residual = 0.0
    correlation = -1.0
    converged = False
    for _ in range(limits.iterations):
        converged = False
        if max(abs(shift_x), abs(shift_y)) > limits.max_shift or box.left + shift_x < 0.0 or box.top + shift_y < 0.0:
            break
        if box.right + shift_x >= width - SAMPLED_PX or box.bottom + shift_y >= height - SAMPLED_PX:
            break
        centre_x = np.float32(warped.x + shift_x)
        centre_y = np.float32(warped.y + shift_y)
        products = products_with_samples(image, pixels.x, pixels.y, centre_x, centre_y, template)
        if products.power < MIN_POWER:
            break
        # The derivatives are orthogonal to the template's grey levels, so only the target enters the right-hand side.
        gain = np.sqrt(power / products.power)
        rhs_x = gain * (normal.b00 * products.x + normal.b01 * products.y)
        rhs_y = gain * (normal.b10 * products.x + normal.b11 * products.y)
        correlation = products.grey / np.sqrt(power * products.power)
        residual = np.sqrt(max(2.0 * power * (1.0 - correlation), 0.0) / pixels.x.size)
        step_x = (normal.yy * rhs_x - normal.xy * rhs_y) / normal_determinant
        step_y = (normal.xx * rhs_y - normal.xy * rhs_x) / normal_determinant
        step = max(abs(step_x), abs(step_y))
        limit = MAX_STEP_PX / step if step > MAX_STEP_PX else 1.0
        shift_x -= limit * step_x
        shift_y -= limit * step_y
        converged = step < CONVERGED_PX
        if step < FINISHED_PX:
            break
    if converged and correlation >= limits.min_correlation:
        covariance = tracks.covariance[n]
        covariance[0] = normal.yy / normal_determinant
        covariance[1] = -normal.xy / normal_determinant
        covariance[2] = normal.xx / normal_determinant
        tracks.uv[n, 0] = warped.x + shift_x
        tracks.uv[n, 1] = warped.y + shift_y
        tracks.residual[n] = residual
        tracks.correlation[n] = correlation


@jit_fast
def track_patches(
    image: FloatImage, templates: Templates, host_uv: FloatArray, homographies: FloatArray, limits: TrackingLimits
) -> PatchTracks:
    """Track patches in an image, from host pixels `(N, 2)` and homographies `(N, 3, 3)` from the host to the image."""
    count = len(host_uv)
    uv = np.full((count, 2), np.nan)
    covariance = np.full((count, 3), np.nan)
    tracks = PatchTracks(uv, covariance, np.full(count, np.nan), np.full(count, np.nan))
    pixels = patch_pixels(templates.values.shape[2])
    for n in range(count):
        warped = local_warp(homographies[n], host_uv[n, 0], host_uv[n, 1])
        _track(image, templates, n, warped, pixels, limits, tracks)
    return tracks
