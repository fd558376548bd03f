"""Patches that are warped by their local plane and tracked by least squares.

A patch is warped from its host image by the homography of its plane. Only the remaining shift is then estimated, by
Gauss-Newton on the difference of the two patches, each normalised to the same mean and contrast (Lucas and Kanade 1981;
Baker and Matthews 2004).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.small_linalg import reorder_to_median
from sfr_loc_map.jit import jit, jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.homography import WarpDerivative, warp, warp_derivative
from sfr_loc_map.localisation.frontend.patch import Patch, half_width, normalise, sample

MIN_POWER = 1e-3
"""Sum of squares about the mean below which a patch has no texture, grey levels squared."""
MIN_DETERMINANT = 0.05
"""Smallest area to which a warp may shrink a pixel, pixels."""
MAX_STEP_PX = 1.5
"""Largest step of one iteration."""
CONVERGED_PX, FINISHED_PX = 0.03, 0.01
"""Last step of a track that has converged, and the step below which no further iteration follows."""


class PatchTracks(NamedTuple):
    """Tracks of N patches in an image; NaN where a patch left the image, has no texture, did not converge, or differs.

    Attributes:
        uv: `(N, 2)` position of the patch centre, pixels.
        covariance: `(N, 3)` uu, uv, vv of that position for a noise of one grey level, px^2.
        residual: `(N,)` RMS, grey levels of the patch.
        correlation: `(N,)` normalised cross-correlation with the image.
    """

    uv: FloatArray
    covariance: FloatArray
    residual: FloatArray
    correlation: FloatArray


class _Workspace(NamedTuple):
    """Arrays of one patch: warped pixels x, y, template, its derivatives in the target, and the target's values."""

    x: Patch
    y: Patch
    template: Patch
    dx: Patch
    dy: Patch
    target: Patch


class _Box(NamedTuple):
    """Bounding box of the warped pixels of a patch."""

    low_x: float
    low_y: float
    high_x: float
    high_y: float


class _Normal(NamedTuple):
    """Power of a template and its normal matrix; the power is 0 where the patch cannot be tracked."""

    power: np.float32
    xx: float
    xy: float
    yy: float


class _Comparison(NamedTuple):
    """Right-hand side x, y, residual RMS and correlation of a patch at a shift."""

    x: float
    y: float
    residual: float
    correlation: float


class _Shift(NamedTuple):
    """Estimated shift of a patch; NaN where it did not converge."""

    x: float
    y: float
    residual: float
    correlation: float


@jit_fast_inline
def target_gradients(patch: Patch, warped: WarpDerivative, dx: Patch, dy: Patch) -> None:
    """Fill dx, dy with the gradients of a patch `(3, S * S)` in the target, without mean.

    They are the patch's, multiplied by the inverse transpose of the warp's derivative.
    """
    det = warped.xu * warped.yv - warped.xv * warped.yu
    b00, b01 = np.float32(warped.yv / det), np.float32(-warped.yu / det)
    b10, b11 = np.float32(-warped.xv / det), np.float32(warped.xu / det)
    for k in range(dx.size):
        dx[k] = b00 * patch[1, k] + b01 * patch[2, k]
        dy[k] = b10 * patch[1, k] + b11 * patch[2, k]
    normalise(dx)
    normalise(dy)


@jit_fast_inline
def _warp_pixels(h: FloatArray, u0: float, v0: float, x_out: Patch, y_out: Patch) -> _Box:
    """Fill the warped pixels of a patch around a host pixel; return their bounding box, `BEHIND` if any is there."""
    half = half_width(x_out.size)
    low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
    for j in (-half, half):
        for i in (-half, half):  # what is in front of the camera at its corners lies between them
            x, y = warp(h, u0 + i, v0 + j)
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    side = 2 * half + 1
    for j in range(side):
        v = v0 + (j - half)
        for i in range(side):
            u = u0 + (i - half)
            # a division by what may be 0 is no vector code
            scale = 1.0 / max(h[2, 0] * u + h[2, 1] * v + h[2, 2], 1e-9)
            x_out[j * side + i] = scale * (h[0, 0] * u + h[0, 1] * v + h[0, 2])
            y_out[j * side + i] = scale * (h[1, 0] * u + h[1, 1] * v + h[1, 2])
    return _Box(low_x, low_y, high_x, high_y)


@jit_fast_inline
def _project_out(template: Patch, power: np.float32, dx: Patch, dy: Patch) -> tuple[float, float, float]:
    """Remove from the derivatives what a change of contrast explains; return their normal matrix xx, xy, yy."""
    tx, ty = np.float32(0.0), np.float32(0.0)
    for k in range(template.size):
        tx += template[k] * dx[k]
        ty += template[k] * dy[k]
    tx /= power
    ty /= power
    hxx, hxy, hyy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(template.size):
        dx[k] -= template[k] * tx
        dy[k] -= template[k] * ty
        hxx += dx[k] * dx[k]
        hxy += dx[k] * dy[k]
        hyy += dy[k] * dy[k]
    if hxx * hyy - hxy * hxy <= 1e-6 * (hxx + hyy) ** 2:
        return 0.0, 0.0, 0.0
    return np.float64(hxx), np.float64(hxy), np.float64(hyy)


@jit_fast_inline
def _linearise(patch: Patch, box: _Box, warped: WarpDerivative, work: _Workspace) -> _Normal:
    """Fill the template, without its mean, and its derivatives in the target; return the normal matrix."""
    nothing = _Normal(np.float32(0.0), 0.0, 0.0, 0.0)
    span = 12.0 * half_width(work.template.size)
    if box.low_x < -1e8 or box.high_x - box.low_x > span or box.high_y - box.low_y > span:
        return nothing
    if abs(warped.xu * warped.yv - warped.xv * warped.yu) < MIN_DETERMINANT:
        return nothing
    template = work.template
    for k in range(template.size):
        template[k] = patch[0, k]
    power = normalise(template)
    if power < MIN_POWER:
        return nothing
    target_gradients(patch, warped, work.dx, work.dy)
    xx, xy, yy = _project_out(template, power, work.dx, work.dy)
    return _Normal(power, xx, xy, yy) if xx > 0.0 or yy > 0.0 else nothing


@jit_fast_inline
def _compare(image: FloatImage, sx: float, sy: float, power: np.float32, work: _Workspace) -> _Comparison:
    """Compare the template with the image at a shift; the correlation is -1 where the image has no texture."""
    values, template, dx, dy = work.target, work.template, work.dx, work.dy
    for k in range(values.size):
        values[k] = sample(image, work.x[k] + np.float32(sx), work.y[k] + np.float32(sy))
    target_power = normalise(values)
    if target_power < MIN_POWER:
        return _Comparison(0.0, 0.0, 0.0, -1.0)
    # the derivatives are orthogonal to the template, so only the target enters
    gain = np.sqrt(power / target_power)
    bx, by, dot = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(values.size):
        bx += dx[k] * values[k]
        by += dy[k] * values[k]
        dot += values[k] * template[k]
    bx, by = gain * bx, gain * by
    correlation = dot / np.sqrt(power * target_power)
    residual = np.sqrt(max(2.0 * power * (1.0 - correlation), 0.0) / values.size)
    return _Comparison(np.float64(bx), np.float64(by), residual, np.float64(correlation))


@jit_fast_inline
def _inside(image: FloatImage, box: _Box, sx: float, sy: float) -> bool:
    """Tell whether a shifted box lies inside an image."""
    height, width = image.shape
    if box.low_x + sx < 0.0 or box.low_y + sy < 0.0:
        return False
    return not (box.high_x + sx >= width - 1.001 or box.high_y + sy >= height - 1.001)


@jit_fast_inline
def _estimate_shift(
    image: FloatImage, box: _Box, normal: _Normal, work: _Workspace, max_shift: float, iterations: int
) -> _Shift:
    """Estimate the shift of a warped patch by Gauss-Newton."""
    det = normal.xx * normal.yy - normal.xy * normal.xy
    sx, sy, residual, correlation = 0.0, 0.0, 0.0, -1.0
    converged = False
    for _ in range(iterations):
        converged = False
        if max(abs(sx), abs(sy)) > max_shift or not _inside(image, box, sx, sy):
            break
        bx, by, residual, correlation = _compare(image, sx, sy, normal.power, work)
        if correlation <= -1.0:
            break
        dx, dy = (normal.yy * bx - normal.xy * by) / det, (normal.xx * by - normal.xy * bx) / det
        step = max(abs(dx), abs(dy))
        limit = MAX_STEP_PX / step if step > MAX_STEP_PX else 1.0
        sx -= limit * dx
        sy -= limit * dy
        converged = step < CONVERGED_PX
        if step < FINISHED_PX:
            break
    return _Shift(sx, sy, residual, correlation) if converged else _Shift(np.nan, np.nan, np.nan, np.nan)


@jit_fast
def track_patches(
    image: FloatImage,
    patches: Patch,
    host_uv: FloatArray,
    homographies: FloatArray,
    max_shift: float,
    iterations: int,
    min_correlation: float,
) -> PatchTracks:
    """Find warped patches in an image.

    Args:
        image: `(H, W)` float32, the target.
        patches: `(N, 3, S * S)` of `cut_patches`.
        host_uv: `(N, 2)` host pixels of the patch centres.
        homographies: `(N, 3, 3)` from host to target pixels.
        max_shift: Largest accepted shift, pixels.
        iterations: Most Gauss-Newton iterations.
        min_correlation: Smallest accepted correlation.
    """
    count, size = len(patches), patches.shape[2]
    tracks = PatchTracks(
        np.full((count, 2), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan), np.full(count, np.nan)
    )
    work = _Workspace(
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
    )
    for n in range(count):
        h, u, v = homographies[n], host_uv[n, 0], host_uv[n, 1]
        box = _warp_pixels(h, u, v, work.x, work.y)
        normal = _linearise(patches[n], box, warp_derivative(h, u, v), work)
        if normal.power == 0.0:
            continue
        shift = _estimate_shift(image, box, normal, work, max_shift, iterations)
        if np.isnan(shift.x) or shift.correlation < min_correlation:
            continue
        x, y = warp(h, u, v)
        det = normal.xx * normal.yy - normal.xy * normal.xy
        tracks.uv[n, 0], tracks.uv[n, 1] = x + shift.x, y + shift.y
        cov = tracks.covariance[n]
        cov[0], cov[1], cov[2] = normal.yy / det, -normal.xy / det, normal.xx / det
        tracks.residual[n], tracks.correlation[n] = shift.residual, shift.correlation
    return tracks


@jit
def noise_variance(covariance: FloatArray, residual: FloatArray) -> tuple[FloatArray, float]:
    """Return the variances `(N, 3)` of tracked positions by their noise, and the median residual.

    A residual below the median may be so by chance and counts as the median. Half of the noise is the patch's.

    Args:
        covariance: `(N, 3)` for a noise of one grey level, px^2.
        residual: `(N,)` RMS, grey levels; NaN where not found.
    """
    found = residual[~np.isnan(residual)]
    typical = reorder_to_median(found) if len(found) else 1.0
    variance = np.empty((len(residual), 3))
    for n in range(len(residual)):
        level = residual[n] if residual[n] > typical or np.isnan(residual[n]) else typical
        for i in range(3):
            variance[n, i] = covariance[n, i] * (1.2 * (level * level))
    return variance, typical
