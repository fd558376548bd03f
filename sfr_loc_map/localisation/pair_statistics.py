"""Statistics of a tracked pair for the estimate: residuals, counts, and the displayed tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, median
from sfr_loc_map.localisation.estimate import LandmarkTracks, TrackingStatistics
from sfr_loc_map.localisation.findings import Finding, Verdict
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, Tracks
from sfr_loc_map.localisation.state import State


class ResidualStatistics(NamedTuple):
    """Medians of the residuals and of the chi-square of tracks."""

    chi_median: float  #: Median chi-square per degree of freedom; NaN without residuals.
    residual_px: float  #: Median residual of the inliers, px.


def residual_statistics(tracks: Tracks) -> ResidualStatistics:
    """Return the medians of the residuals and of the chi-square of tracks."""
    chi2 = tracks.chi2_per_dof
    found = np.isfinite(tracks.observations[:, ::2])
    mean_variance = 0.5 * (tracks.variance[:, :, 0] + tracks.variance[:, :, 2])
    total: FloatArray = np.where(found, mean_variance, 0.0).sum(axis=1)
    residuals = np.sqrt(chi2 * (total / np.maximum(found.sum(axis=1), 1)))
    return ResidualStatistics(median(chi2[~np.isnan(chi2)]), median(residuals[tracks.inliers]))


def accepted_statistics(state: State, tracks: Tracks, residuals: ResidualStatistics) -> TrackingStatistics:
    """Return the statistics of an accepted pair; the state is that after the pair."""
    offset = state.calibration.offset
    return TrackingStatistics(
        features=len(tracks.inliers),
        inliers=tracks.inlier_count,
        keyframes=state.keyframes,
        chi_median=residuals.chi_median,
        residual_px=residuals.residual_px,
        vertical_offset_px=offset.v,
        disparity_offset_px=-offset.u,
        roll_offset_px=offset.roll,
        masked_share=state.ground_memory.excluded.fraction,
    )


def refused_statistics(verdict: Verdict) -> TrackingStatistics:
    """Return the statistics of a refused pair."""
    if verdict.finding is Finding.REPEATED_PAIR:
        return TrackingStatistics(repeated=1)
    return TrackingStatistics(inliers=0)


def displayed(tracks: Tracks) -> LandmarkTracks:
    """Return copies of the displayed values of tracks."""
    residual = np.sqrt(tracks.chi2_per_dof / INLIER_CHI2_PER_DOF)
    return LandmarkTracks(tracks.observations[:, :2].copy(), tracks.landmarks.last_seen[:, :2].copy(), residual)
