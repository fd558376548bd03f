"""Tools that search for rigid motions in a pair, and what they are given.

The terms are defined in the package docstring. The conditions that use the results are in `evidence`.
"""

from __future__ import annotations

from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.localisation.frontend.landmarks import ALIGNED_LANDMARKS, Landmarks
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.cell_change import Change, cell_counts
from sfr_loc_map.localisation.ground.cell_motion import Explained, explain, image_motion
from sfr_loc_map.localisation.ground.double_exposure import mixture_of
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.relocalisation import RecoveryImages, Relocaliser

MIN_AGREEMENT = 0.3
"""Minimum fraction of the landmarks searched for that the other motion must explain. Chosen by hand. If larger, another
motion among many outliers is missed. If smaller, chance agreement of outliers counts as a motion and degrades good
pairs."""
CONVINCING = 0.6
"""Minimum fraction of the landmarks searched for that the other motion must explain to be accepted without further
tests. Chosen by hand above one half: the majority agrees. If smaller, slow motions near the main motion are accepted.
If larger, fewer motions are accepted by this test alone; the others must also differ from the main motion in the
image (`evidence.MIN_DIFFERENCE_PX`)."""
MIN_MIXTURE_WEIGHT = 0.1
"""An image shows a second exposure if the lower bound of the estimated weight of this exposure exceeds this value. In
images of one exposure the estimate differs from 0 by a few hundredths at most."""
MIXTURE_SIGMAS = 3.0
"""Number of standard errors between the weight and its lower bound, so that the bound is too high in one image in
740 (normal errors). If larger, weak ghosts are missed."""


class ComparedPair(NamedTuple):
    """A pair and its comparison with an earlier image, cell by cell."""

    frame: StereoFrame
    prediction: Prediction
    recovery: RecoveryImages
    change: Change  #: Cells that changed, and cells that stayed, since the earlier image.
    earlier_pose: Pose  #: Pose of the earlier image.
    far_px: float  #: Image motion, px, from which an outlier does not count as unexplained (`selection.FAR_RATIO`).


class MotionTools(NamedTuple):
    """Tools that search for motions."""

    tracker: Tracker
    relocaliser: Relocaliser
    camera: StereoCamera
    shape: tuple[int, int]  #: Height and width of the images.
    min_tracked: int  #: Minimum number of landmarks that agree on a motion.

    def explained(self, pair: ComparedPair, tracks: Tracks) -> Explained:
        """Return what the motion from the earlier image to the pose of some tracks explains in a pair."""
        landmarks = tracks.landmarks
        return explain(
            tracks.pose,
            pair.earlier_pose,
            landmarks.estimates,
            landmarks.planes.uv,
            tracks.inliers,
            pair.change,
            self.camera,
            self.shape,
            pair.far_px,
        )

    def image_motion_px(self, tracks: Tracks, *, start: Pose, end: Pose) -> float:
        """Return the image motion of the landmarks of some tracks between two poses, px."""
        return image_motion(start, end, tracks.landmarks.estimates, self.camera)

    def shows_other(self, image: FloatImage, landmarks: Landmarks, shown: Pose, other: Pose) -> bool:
        """Return whether an image at the pose `shown` also shows some landmarks from another pose.

        The image is level `MIXTURE_LEVEL` of a left image.
        """
        mixture = mixture_of(image, landmarks, shown, other, self.camera)
        lower_bound = mixture.weight - MIXTURE_SIGMAS * mixture.standard_error
        return mixture.patches >= self.min_tracked and lower_bound > MIN_MIXTURE_WEIGHT

    def search(self, pair: ComparedPair, landmarks: Landmarks) -> Tracks | None:
        """Search for one motion of some landmarks, from the guesses, then by optical flow; None if too few agree."""
        count = len(landmarks.rows)
        if count < self.min_tracked:
            return None
        frame = pair.frame
        offset = pair.prediction.offset
        start = self.tracker.align(frame.left, landmarks.thinned(ALIGNED_LANDMARKS), pair.prediction.guesses.all)
        tracks = self.tracker.refine(frame, landmarks, start, offset)
        if tracks.inlier_count < CONVINCING * count:
            pose = self.relocaliser.pose_by_flow(frame, pair.recovery, landmarks)
            if pose is not None:
                by_flow = self.tracker.refine_from_afar(frame, landmarks, pose, offset)
                tracks = max(tracks, by_flow, key=attrgetter("inlier_count"))
        return tracks if tracks.inlier_count >= max(self.min_tracked, MIN_AGREEMENT * count) else None

    def refined(self, pair: ComparedPair, landmarks: Landmarks, start: Pose) -> Tracks:
        """Track landmarks of a pair from a pose."""
        return self.tracker.refine(pair.frame, landmarks, start, pair.prediction.offset)

    def cells(self, numbers: NDArray[np.intp]) -> Mask:
        """Return the cells `(R, C)` of some cell numbers; the number R * C is outside all cells."""
        rows, columns = cell_counts(self.shape)
        found = np.bincount(numbers, minlength=rows * columns + 1)
        return found[:-1].reshape(rows, columns) > 0
