"""The named error sources of the localiser, and what else is constant in a run.

The formulas that use the error sources are in `covariance`. Other values also enter the covariances. They are where
they are used, because the estimates depend on them as well:

| value | module | enters |
|---|---|---|
| `PIXEL_FLOOR`, `RESIDUAL_GAIN`, `EDGE_RESIDUALS` | `frontend.tracking` | noise of observations, hence C, W, K |
| `FIRST_SIGMA_PX`, `YAW_WALK_PX`, `FOLLOWED_ERROR_RATIO` | `backend.online_calibration` | `yaw_sigma` |
| `START_VARIANCE` | `backend.sliding_window` | first pose of a window, hence W |
| `MIN_VARIANCE` | `covariance` | minimum variance of a step |
| `unseen_speed_m_s`, `unseen_turn_rad_s` | `config.MotionBounds` | unseen motion |
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.symmetric_matrices import symmetric


@dataclass(frozen=True, slots=True)
class ErrorSources:
    """The error sources of the localiser: standard deviations, and ratios to what is estimated.

    The values were chosen by hand so that NEES is near 1 on rendered drives (`make nees`). With a larger value the
    covariance is larger than the errors and NEES falls below 1. With a smaller one errors exceed what is stated.

    The letter at the beginning of each text says which formula of `covariance` the field enters: P pose, Q step, N
    noise, S systematic, M unseen motion. The twist contains Q, N and S.
    """

    blur_px: float = 0.03
    """P. Error of a whole image (blur, jitter), px: it is common to all landmarks and therefore unobservable."""
    exposure_rad: float = 1e-5
    """N. Attitude noise of a whole image, rad, because its mean exposure is not at the stamp (vibration: 4e-5)."""
    disparity_px: float = 0.01
    """P, S. Error that all disparities share, px: it scales the path."""
    lens_px: float = 0.0007
    """P (in A), S. Disparity error that varies over the image, of a lens whose residuals show none, px. It bends the
    path."""
    lens_ratio: float = 0.17
    """P (in A), S. The same error as a ratio to the RMS of the residual disparities."""
    unsettled_yaw_ratio: float = 0.5
    """P. Error of the yaw of the right camera as a ratio to the yaw that is still to be corrected."""
    bent_attitude_ratio: float = 0.25
    """P. Attitude error as a ratio to the yaw: an uncorrected yaw bends the path."""
    followed_attitude_ratio: float = 0.1
    """P. Attitude error as a ratio to the drift of the right camera that was followed."""
    adjustment_inflation: float = 2.0
    """P, Q. Factor on the covariance of the bundle adjustment, because errors of neighbouring landmarks are
    correlated."""
    keyframe_px: float = 0.01
    """Q. Position error of a keyframe that its landmarks share, px at their median depth."""
    min_step_ratio: float = 0.02
    """Q. Ratio of the smallest step to a keyframe interval: no pose is exactly the one before."""
    min_interval_ratio: float = 0.25
    """Q. Smallest keyframe interval as a ratio to the interval that the optical flow triggers."""
    variance_gain: float = 0.1
    """Q, N. Gain of a pair in the variance factor, which follows light and ground within some ten pairs."""
    min_variance_factor: float = 0.2
    """Q, N. Smallest variance factor: below it, errors dominate that no residual shows."""
    step_inflation: float = 1.5
    """Q. Factor on the variance factor in steps: errors that neighbouring landmarks share are in no residual."""
    white_ratio: float = 0.5
    """N. Fraction of the covariance of a pose that is independent from pair to pair (image noise)."""
    climb_ratio: float = 0.3
    """M. Vertical over horizontal speed of a motion that no image showed: slopes of up to 17 degrees."""
    tilt_ratio: float = 0.2
    """M. Roll and pitch rate over the turn rate of a motion that no image showed."""


@dataclass(frozen=True, slots=True, eq=False)
class RoverModel:
    """What is constant in a run: the mount of the left camera, its geometry, the motion bounds, the error sources."""

    T_rb_left: Transform  #: Takes points in the left camera to RB.
    T_left_rb: Transform  #: Takes points in RB to the left camera.
    fx: float  #: Focal length, px.
    focal_baseline: float  #: Focal length times baseline, px m.
    keyframe_rad: float  #: Size of the motion between two keyframes, rad of optical flow.
    bounds: MotionBounds
    sources: ErrorSources = ErrorSources()

    @classmethod
    def of(cls, rig: StereoRig, bounds: MotionBounds, keyframe_flow: float) -> RoverModel:
        """Return the model of a rig; GeometryError if the extrinsics are unknown.

        The flow that triggers a keyframe is a fraction of the image width.
        """
        return cls(
            T_rb_left=rig.T_rb_left,
            T_left_rb=rig.T_rb_left.inverse(),
            fx=rig.fx,
            focal_baseline=rig.fx * rig.baseline_m,
            keyframe_rad=keyframe_flow * rig.width / rig.fx,
            bounds=bounds,
        )

    def covariance_of_left(
        self, covariance: FloatArray, *, R_world_frame: FloatArray, R_world_left: FloatArray
    ) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in some frame."""
        lever = R_world_left @ self.T_rb_left.rotation.T @ self.T_rb_left.translation
        return symmetric(propagated_covariance(covariance, lever, R_world_frame))
