"""A pair whose pose was accepted: the input for the errors of this pose, and of the step to this pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.motion_size import MotionSize


@dataclass(frozen=True, eq=False)
class AcceptedPair:
    """A pair whose pose was accepted: what its errors depend on (`State.accepted` collects the values)."""

    stamp_ns: int
    tracks: Tracks
    landmark_map: LandmarkMap  #: Map in which the pose was estimated.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    chi_median: float  #: Median squared Mahalanobis residual per degree of freedom; NaN without residuals.
    was_known: bool  #: Whether the previous pose was known (tracked or kept, not lost).
    shear_chi2: float  #: Squared shear of the image rows divided by its variance, per degree of freedom.
    inflation: Inflation  #: What the findings of the pair add to the covariance.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.

    @cached_property
    def T_world_left(self) -> Transform:
        """Pose of the left camera in the world."""
        return Transform(*self.tracks.pose)

    @cached_property
    def given_keyframes(self) -> FloatArray:
        """Covariance `(6, 6)` of the pose given the keyframes."""
        return np.asarray(np.linalg.inv(self.tracks.information))
