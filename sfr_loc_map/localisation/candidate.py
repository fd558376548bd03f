"""A pair between the stages of the localiser: the candidate that is judged, and the final pose of an accepted pair."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.selection import Ground
from sfr_loc_map.localisation.guards import ShearMean


class CorrectedTracks(NamedTuple):
    """Tracks and calibration after the correction of the right camera."""

    tracks: Tracks  #: Tracks with corrected right observations.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    shear_mean: ShearMean  #: The running mean, updated by the pair.
    shear_chi2: float = 0.0  #: Squared shear of the rows of this pair, divided by its variance, per degree of freedom.


class Candidate(NamedTuple):
    """A pair whose pose is to be judged."""

    frame: StereoFrame
    #: The map, in which landmarks that do not move with the ground are no longer tracked. Their earlier observations
    #: remain in the window (`SlidingWindow.deactivated`).
    landmark_map: LandmarkMap
    ground: Ground
    corrected: CorrectedTracks  #: Tracks of the ground after the correction.

    @property
    def tracks(self) -> Tracks:
        """Tracks of the ground with corrected right observations, and their pose."""
        return self.corrected.tracks


class FinalPose(NamedTuple):
    """The final pose of an accepted pair."""

    tracks: Tracks  #: The judged tracks. For a keyframe, tracks of all landmarks unless a guard refuses their pose.
    is_keyframe: bool  #: Whether the pair becomes a keyframe.
    is_recovery_image: bool  #: Whether the pair may serve to recover lost tracking.
