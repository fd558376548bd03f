"""The named error sources of the localiser.

The package docstring of `uncertainty` lists the formulas that use the error sources. The values in the table enter the
covariances, too. They are defined where they are used, because the estimates also depend on them.

| value | module | enters |
|---|---|---|
| `PIXEL_FLOOR`, `RESIDUAL_GAIN`, `EDGE_RESIDUALS` | `frontend.noise` | noise of observations |
| `FIRST_SIGMA_PX`, `YAW_WALK_PX`, `DRIFT_ERROR_RATIO` | `backend.online_calibration` | `yaw_sigma_px` |
| `START_VARIANCE` | `backend.sliding_window` | first pose of a window, hence `keyframes` |
| `MIN_VARIANCE` | `step_covariance` | variance added to each step |
| `unseen_speed_m_s`, `unseen_turn_rad_s` | `config.MotionBounds` | unobserved motion |
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ErrorSources:
    """The error sources of the localiser: standard deviations, and ratios to estimated values.

    The values were chosen by hand so that NEES per degree of freedom is near 1 on rendered drives (`make nees`). If a
    value is too large, the covariance exceeds the errors and this NEES falls below 1. If a value is too small, this
    NEES exceeds 1. NEES is one number for all values together. It determines their total, not each single value, whose
    order of magnitude follows from the physical error that its description names.

    The words at the beginning of each description name the formulas that use the field: the covariance of a pose, parts
    of the covariance of a step (step, noise, systematic), and the unobserved motion, which enters both covariances.
    """

    blur_px: float = 0.03
    """Pose. Error of a whole image (blur, jitter), px, which is common to all landmarks and therefore unobservable."""
    exposure_rad: float = 1e-5
    """Noise. Attitude noise of a whole image, rad, because the stamp is not at mid-exposure (4e-5 with vibration)."""
    disparity_px: float = 0.01
    """Pose, systematic. Error common to all disparities, px, which scales the path."""
    lens_px: float = 0.0007
    """Pose (`correlated`), systematic. Disparity error that varies over the image and bends the path, px, if the
    residuals show no lens distortion."""
    lens_ratio: float = 0.17
    """Pose (`correlated`), systematic. Ratio of the disparity error that bends the path (as `lens_px`) to the RMS of
    the residual disparities."""
    unsettled_yaw_ratio: float = 0.5
    """Pose. Ratio of the error of the right camera's yaw to the part of this yaw that is not corrected yet."""
    bent_attitude_ratio: float = 0.25
    """Pose. Ratio of the attitude error to the right camera's yaw before its correction, because the yaw bends the
    path."""
    drift_attitude_ratio: float = 0.1
    """Pose. Ratio of the attitude error to the drift corrections of the right camera."""
    adjustment_inflation: float = 2.0
    """Pose, step. Factor on the covariance of the bundle adjustment, because errors of neighbouring landmarks are
    correlated."""
    keyframe_px: float = 0.01
    """Step. Position error of a keyframe, common to all its landmarks, px at their median depth."""
    min_step_ratio: float = 0.02
    """Step. Minimum ratio of a step to the keyframe interval, because a step at rest has an error, too."""
    min_interval_ratio: float = 0.25
    """Step. Ratio of the minimum keyframe interval to the interval that triggers a keyframe."""
    variance_gain: float = 0.1
    """Step, noise. Gain of the variance factor per pair. The factor adapts to light and ground within ten pairs."""
    min_variance_factor: float = 0.2
    """Step, noise. Minimum variance factor. Below this value, the dominant errors do not appear in residuals."""
    step_inflation: float = 1.5
    """Step. Factor on the variance factor, because errors common to neighbouring landmarks do not appear in
    residuals."""
    white_ratio: float = 0.5
    """Noise. Fraction of the covariance of a pose that is independent from pair to pair (image noise)."""
    climb_ratio: float = 0.3
    """Unobserved. Ratio of vertical to horizontal speed in an unobserved motion: slopes of 17 deg."""
    tilt_ratio: float = 0.2
    """Unobserved. Ratio of roll and pitch rate to turn rate in an unobserved motion."""
