"""Covariance of a pose, composed of terms that are named by their error source (table in `uncertainty`).

An attitude error displaces later positions. The terms `external` and `keyframes` are therefore propagated from the
position where the error arose to the present position (`LocatedCovariance`), and `correlated` from the mean of the
positions where its angles arose (`PathSums.correlated_at`). The term `attitude` is not propagated: it is an error of
the present rotation only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources
from sfr_loc_map.localisation.uncertainty.path_errors import PathErrors, PathSums
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel


class PoseTerms(NamedTuple):
    """Terms of the covariance of a pose, each `(6, 6)`."""

    external: FloatArray  #: External pose to which the covariance is relative.
    keyframes: FloatArray  #: Keyframes and windows since the external pose.
    #: Errors of this pair that no other pose shares: landmarks, blur, stale parts of its image.
    this_pair: FloatArray
    kept_motion: FloatArray  #: Unobserved motion while the pose is kept.
    correlated: FloatArray  #: Errors that are correlated between steps: lens distortion, ambiguous motions.
    disparity: FloatArray  #: Errors common to all disparities, which scale the path.
    attitude: FloatArray  #: Bending of the path by the yaw and by the drift of the right camera.

    @property
    def total(self) -> FloatArray:
        """Covariance `(6, 6)` of the pose."""
        return sum(self[1:], start=self.external)


def pose_terms(
    errors: PathErrors, position: FloatArray, calibration: OnlineCalibration, model: RoverModel
) -> PoseTerms:
    """Return the terms of the covariance of the left camera at a position `(3,)`, m, in the world."""
    since_origin = errors.sums.since(errors.origin.sums)
    return PoseTerms(
        external=errors.origin.external.at(position),
        keyframes=errors.of_keyframes(position),
        this_pair=errors.this_pair,
        kept_motion=errors.kept_motion,
        correlated=since_origin.correlated_at(position),
        disparity=_disparity_term(since_origin, calibration, model.sources),
        attitude=_attitude_term(since_origin, calibration, model),
    )


def _disparity_term(sums: PathSums, calibration: OnlineCalibration, sources: ErrorSources) -> FloatArray:
    """Return the term `disparity`: effects of a constant disparity error, and of the yaw before its correction.

        disparity   = common_px^2 bias bias' + uncorrected uncorrected'   (position only)
        common_px^2 = disparity_px^2 + yaw_sigma_px^2 + (unsettled_yaw_ratio remaining_px)^2
        uncorrected = target_px bias - corrected

    `bias` and `corrected` are sums over the steps (`PathSums`), so that `uncorrected` is the sum of the displacements
    times the part of the yaw that was not corrected at the step.
    """
    unsettled_px = sources.unsettled_yaw_ratio * calibration.yaw.remaining_px
    common_px2 = sources.disparity_px**2 + calibration.yaw.sigma_px**2 + unsettled_px**2
    uncorrected = calibration.yaw.target_px * sums.bias - sums.corrected
    term = np.zeros((6, 6))
    term[:3, :3] = common_px2 * np.outer(sums.bias, sums.bias) + np.outer(uncorrected, uncorrected)
    return term


def _attitude_term(sums: PathSums, calibration: OnlineCalibration, model: RoverModel) -> FloatArray:
    """Return the term `attitude`: the yaw of the right camera, and errors of its drift corrections, bend the path.

        attitude = ((bent_attitude_ratio / f)^2 (yaw_sigma_px^2 + bent_px^2)
                    + (drift_attitude_ratio / f)^2 drift_px^2) I   (rotation only)

    `bent_px` is the yaw to be corrected, including that of maps that were discarded (`YawEstimate.bent_px`). `drift_px`
    is the sum of the absolute drift corrections.
    """
    sources = model.sources
    bent_px = sources.bent_attitude_ratio * np.hypot(calibration.yaw.sigma_px, calibration.yaw.bent_px)
    attitude_px = np.hypot(bent_px, sources.drift_attitude_ratio * sums.drift_px)
    term = np.zeros((6, 6))
    term[3:, 3:] = np.eye(3) * (attitude_px / model.fx) ** 2
    return term
