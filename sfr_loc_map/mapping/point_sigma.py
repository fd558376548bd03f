"""The standard deviation of points: noise, smoothing, saturation and the uncertainty of the calibration.

A point has three standard deviations along its ray:

- The `fusion_sigma` (`ViewPoints`) is the result of rows 1 to 5, or 1 to 6 for fused points. Views are compared and
  weighted by this sigma.
- The random sigma (`PointSigma.random`) also includes row 7.
- The total sigma (`PointSigma.total`, `PointCloud.sigma`) also includes row 8.

The table lists all contributions in the order of the calls. Standard deviations of disparities are in pixels, and
standard deviations of points are in metres:

=  ====================================  ===============================================================================
   where                                 formula
=  ====================================  ===============================================================================
1  residual_noise.noise_variance         image noise: variance of a residual; information = sum w g^2 / variance, with
                                         the slopes g of the grey levels and the weights w
2  variational_refinement.linearise      information / max(1, mean chi2 / mean weight, variance ratio of blocks)
3  disparity_sigma.disparity_sigma       variance 1 / (8 sqrt(h s)) + (SMOOTHING_BIAS curvature)^2 s / h +
                                         (CREASE_BIAS crease)^2, with the information h and the smoothness weight s
4  hole_filling.fill_holes               max(sigma, MIN_FILLED_SIGMA_PX) at filled pixels
5  pair_view.reproject                   abs(ray) Z^2 / (fx baseline) sigma, from pixels to metres
6  multiview.fusion (fused points only)  variance c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2, with the weights
                                         w_i = feather / s_i^2 and c = COMMON_VARIANCE
7  point_sigma.random_sigma              (1 + SIGMA_GROWTH f) sigma, with the saturated fraction f of a square of side
                                         NEARBY_SIDE_PX (`saturation`)
8  point_sigma.total_sigma               variance sigma^2 + the variance of the calibration error
=  ====================================  ===============================================================================

The docstrings of the functions state the bounds and windows of the formulas.

The error of the calibration is common to all points. A constant disparity error, for example due to a yaw of the right
camera, causes a depth error of `Z^2 / (fx baseline)` per pixel of disparity. Within a pair this error cannot be
distinguished from another depth. Averaging over points or pairs does not reduce the error. The configured uncertainty
of the calibration (`CalibrationPrior`, the parameters `mapping.calibration`) is a prior. The rotation of the right
camera that is measured in a pair changes this uncertainty (`sigma_of_calibration`). A set of pairs uses the largest
calibration sigmas of its pairs. Sigma is conditional on the poses, and the registration of poses does not change sigma.
The compensation of a roll does not change sigma either.

To add an error source:

- Measured noise that differs between pixels requires a term in `disparity_sigma`. The term affects the weights of the
  fusion.
- An allowance that differs between pixels, and is not a measured noise, requires a factor in `random_sigma`, like
  saturation. The factor does not affect the weights of the fusion.
- An error that is common to all points requires a parameter (`CalibrationPrior`), a field of `CalibrationSigma`, the
  computation of this field in `sigma_of_calibration`, and a term in `total_sigma`. The error does not affect the
  weights of the fusion, because averaging does not reduce the error.

Every new error source also requires a row in the table above.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, GreyImage, read_only
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
from sfr_loc_map.mapping.disparity.validity.saturation import Saturation
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints

SIGMA_GROWTH = F(1.5)  #: Relative growth of sigma in a completely saturated neighbourhood.
SIGMA_FACTORS = F(1.0) + SIGMA_GROWTH / F(255.0) * np.arange(256, dtype=F)
"""Factor on sigma, indexed by `Saturation.nearby_fraction_255`. Beside saturated pixels the measured noise is too
small, because clipping removes noise."""


class PointSigma(NamedTuple):
    """Standard deviations along the ray of N points, read-only `(N,)` float32 each, metres."""

    random: FloatArray32  #: Part that differs from point to point: noise, smoothing and saturation.
    total: FloatArray32  #: Random sigma combined with the calibration error, which is common to all points.

    @classmethod
    def concatenated(cls, parts: Sequence[PointSigma]) -> PointSigma:
        """Return the standard deviations of the points of all parts."""
        return cls(*(read_only(np.concatenate(columns)) for columns in zip(*parts, strict=True)))


def sigma_of_points(points: ViewPoints, view: PairView, calibration: CalibrationSigma, rig: StereoRig) -> PointSigma:
    """Return the standard deviations of points of a view, as reprojected or as fused with points of other views."""
    random = random_sigma(points, view.saturation)
    total = total_sigma(points, random, view.T_lm_left, calibration, rig)
    return PointSigma(read_only(random), read_only(total))


def random_sigma(points: ViewPoints, saturation: Saturation) -> FloatArray32:
    """Return the random sigma of each point `(N,)`, metres, which is larger beside saturated pixels."""
    return _random_sigma(points.fusion_sigma, points.v, points.u, saturation.nearby_fraction_255)


@jit_rows
def _random_sigma(
    sigma: FloatArray32, v: NDArray[np.uint16], u: NDArray[np.uint16], nearby_fraction_255: GreyImage
) -> FloatArray32:
    """Return the standard deviations `(N,)` times the factors for the nearby saturated fractions `(H, W)`."""
    out = np.empty_like(sigma)
    for n in prange(len(sigma)):
        out[n] = sigma[n] * SIGMA_FACTORS[nearby_fraction_255[v[n], u[n]]]
    return out


def total_sigma(
    points: ViewPoints, random: FloatArray32, T_lm_left: Transform, calibration: CalibrationSigma, rig: StereoRig
) -> FloatArray32:
    """Return the total standard deviation along the ray of each point `(N,)`, metres.

    With the random sigma, the range r, the disparity d, the depth Z = fx baseline_m / d, and the normalised coordinates
    (x, y) of the left pixel and (xr, y) of the right pixel:

        a^2     = (yaw (1 + xr^2))^2 + (pitch xr y)^2 + (roll y)^2 + distortion^2
        c^2     = a^2 (Z / baseline_m)^2 + focal^2 + baseline^2
        total^2 = sigma^2 + (r c)^2

    The angle a is the error of the angle between both rays, and c is the relative error of the range. The docstring of
    `disparity/right_camera/rotation` describes the geometry. `T_lm_left` is the pose of the points' left camera.
    """
    return _total_sigma(
        xyz=points.xyz,
        sigma=random,
        us=points.u,
        vs=points.v,
        pose=Pose.of(T_lm_left),
        camera=rig.camera,
        calibration=calibration,
    )


@jit_rows
def _total_sigma(
    xyz: FloatArray32,
    sigma: FloatArray32,
    us: NDArray[np.uint16],
    vs: NDArray[np.uint16],
    pose: Pose,
    camera: StereoCamera,
    calibration: CalibrationSigma,
) -> FloatArray32:
    """Return the total standard deviations `(N,)` of points `(N, 3)` in LM; the pose is that of the left camera."""
    rotation = pose.rotation
    position = pose.position
    total = np.empty(len(sigma), F)
    distortion_variance = calibration.distortion_rad * calibration.distortion_rad
    focal = calibration.focal_fraction
    baseline = calibration.baseline_fraction
    length_variance = focal * focal + baseline * baseline
    for n in prange(len(total)):
        depth = 0.0
        for k in range(3):
            depth += rotation[k, 2] * (np.float64(xyz[n, k]) - position[k])
        x = (us[n] - camera.cx) / camera.fx
        y = (vs[n] - camera.cy) / camera.fy
        right_x = x - camera.baseline_m / depth
        by_yaw = calibration.yaw_rad * (1.0 + right_x * right_x)
        by_pitch = calibration.pitch_rad * right_x * y
        by_roll = calibration.roll_rad * y
        angle_variance = by_yaw * by_yaw + by_pitch * by_pitch + by_roll * by_roll + distortion_variance
        relative_variance = angle_variance * (depth / camera.baseline_m) ** 2 + length_variance
        range_squared = depth * depth * (x * x + y * y + 1.0)
        total[n] = np.sqrt(np.float64(sigma[n]) * sigma[n] + range_squared * relative_variance)
    return total
