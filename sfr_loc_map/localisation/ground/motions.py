"""Rigid motions in a pair: how landmarks are tracked and searched for, and how far a motion agrees with the image."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.localisation.frontend.landmarks import ALIGNED_LANDMARKS, Landmarks
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.cell_change import Change
from sfr_loc_map.localisation.ground.cell_motion import Agreement, agreement_of, image_motion
from sfr_loc_map.localisation.ground.thresholds import CONVINCING, MIN_AGREEMENT
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.relocalisation import RecoveryImages, Relocaliser


class MotionTools(NamedTuple):
    """What tracks and searches for motions, without state between calls."""

    tracker: Tracker
    relocaliser: Relocaliser
    camera: StereoCamera
    shape: tuple[int, int]  #: Height and width of the images.
    min_tracked: int  #: Minimum number of landmarks that agree on a motion.


class Motion(NamedTuple):
    """A rigid motion in a pair."""

    tracks: Tracks  #: Tracks whose inliers follow the motion.
    agreement: Agreement  #: How far the motion agrees with the pair.


class ComparedPair(NamedTuple):
    """A pair and its comparison with an earlier image, cell by cell. Its methods track and search for motions."""

    tools: MotionTools
    frame: StereoFrame
    prediction: Prediction
    recovery: RecoveryImages
    change: Change  #: Cells that changed, and cells that stayed, since the earlier image.
    earlier_pose: Pose  #: Pose of the earlier image.
    far_px: float  #: Image motion, px, from which an outlier does not count as unexplained (`thresholds.FAR_RATIO`).

    def motion(self, tracks: Tracks) -> Motion:
        """Return the motion of some tracks, from the earlier image to their pose."""
        landmarks = tracks.landmarks
        agreement = agreement_of(
            tracks.pose,
            self.earlier_pose,
            landmarks.estimates,
            landmarks.planes.uv,
            tracks.inliers,
            self.change,
            self.tools.camera,
            self.tools.shape,
            self.far_px,
        )
        return Motion(tracks, agreement)

    def tracked_from(self, landmarks: Landmarks, start: Pose) -> Motion:
        """Track landmarks from a pose, and return their motion."""
        return self.motion(self.tools.tracker.refine(self.frame, landmarks, start, self.prediction.offset))

    def search(self, landmarks: Landmarks) -> Motion | None:
        """Search for one motion of some landmarks, from the guesses, then by optical flow; None if too few agree."""
        tracker = self.tools.tracker
        min_tracked = self.tools.min_tracked
        count = len(landmarks.rows)
        if count < min_tracked:
            return None
        offset = self.prediction.offset
        start = tracker.align(self.frame.left, landmarks.thinned(ALIGNED_LANDMARKS), self.prediction.guesses)
        tracks = tracker.refine(self.frame, landmarks, start, offset)
        if tracks.inlier_count < CONVINCING * count:
            pose = self.tools.relocaliser.pose_by_flow(self.frame, self.recovery, landmarks)
            if pose is not None:
                by_flow = tracker.refine_from_afar(self.frame, landmarks, pose, offset)
                if by_flow.inlier_count > tracks.inlier_count:
                    tracks = by_flow
        if tracks.inlier_count < max(min_tracked, MIN_AGREEMENT * count):
            return None
        return self.motion(tracks)

    def image_motion_px(self, tracks: Tracks, *, start: Pose, end: Pose) -> float:
        """Return the image motion of the landmarks of some tracks between two poses, px."""
        return image_motion(start, end, tracks.landmarks.estimates, self.tools.camera)
