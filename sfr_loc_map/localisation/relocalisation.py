"""Relocalisation: recovery of lost tracking from an earlier image.

The first method is pyramidal optical flow from the last tracked image (Bouguet 2001). The second method matches upright
SIFT descriptors with those of the best image (Lowe 2004). Both methods estimate the pose by PnP with RANSAC.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.frontend.landmarks import BORDER, Landmarks
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame, is_textured
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks

MAX_FAILED_RECOVERIES = 3
"""Number of good images with a refused pose since the last accepted pair, after which a new window begins. If larger,
the localiser stays lost for longer. If smaller, a map is discarded in which the next pair might have been
relocalised."""
MIN_BEST_RATIO = 0.5
"""Minimum fraction of the landmarks that are inliers in the best image: the majority."""
GOOD_IMAGE_RATIO = 0.5
"""Minimum ratio of corners to landmarks of the map in a pair that may begin a window. If a map has more landmarks than
the grid has cells, the ratio to the number of cells is used. The value is half. If larger, no window begins in a scene
of less texture. If smaller, a window begins with a blurred pair."""
MIN_DESCRIPTOR_PX = 8.0  #: Minimum size of a descriptor, px: smaller descriptors are dominated by noise.
DESCRIPTORS_PER_SIDE = 32  #: Ratio of the shorter image side to the descriptor size: 16 px at 512 x 512.
NO_POINTS = np.zeros((0, 2))  #: No points.
FLOW_WINDOW = (21, 21)  #: Window of the optical flow, px: the default of OpenCV.
FLOW_LEVELS = 6
"""Maximum number of pyramid levels above the image in the optical flow. A motion of 64 px is 1 px at the sixth level.
OpenCV uses fewer levels if a level is not larger than the window: four at 512 x 512, six from 1345 x 1345 on."""
CORNERS_RATIO = 2
"""Ratio of the approximate number of described corners to `max_features`. The value is above 1, because the order of
corners by strength changes between images. If smaller, more landmarks have no match. If larger, the search takes
longer. In images of `keyframes.LARGE_IMAGE_PX` or more, a keyframe has at least twice `max_features` landmarks, so that
the corners are at most as many as the landmarks."""
MAX_FLOW_ROUND_TRIP_PX = 1.0
"""Maximum distance between a point and its position after forward and backward flow, px (Kalal et al. 2010)."""
MAX_REPROJECTION_PX = 3.0
"""Inlier gate of the PnP pose, px. The refinement that follows converges from an error of several pixels. If larger,
wrong matches bias the pose. If smaller, landmarks of uncertain depth are outliers."""


class Ransac(NamedTuple):
    """Parameters of the RANSAC search for a pose."""

    iterations: int
    min_inlier_ratio: float


FLOW_RANSAC = Ransac(300, 0.3)
"""For points of the optical flow, most of which are correct. If half of the points are correct, at least one of 300
samples of five points has no outlier with probability 0.9999. The minimum ratio was chosen by hand below one half."""
DESCRIPTOR_RANSAC = Ransac(2000, 0.05)
"""For matches of descriptors, most of which may be wrong. If 30 % of the matches are correct, at least one of 2000
samples has no outlier with probability 0.99. The minimum ratio was chosen by hand; `min_tracked` applies as well."""


class KnownImage(NamedTuple):
    """A left image in which landmarks were observed."""

    image: GreyImage  #: `(H, W)` uint8.
    uv: FloatArray  #: `(N, 2)` px, NaN where a landmark was not observed.
    landmarks: Landmarks  #: The N landmarks.

    def observed(self, among: Landmarks | None = None) -> tuple[FloatArray, FloatArray]:
        """Return pixels `(M, 2)` and points `(M, 3)` of the observed landmarks that are not at infinity.

        If other landmarks of the same window are given, only these are returned.
        """
        points = self.landmarks.points
        usable = np.isfinite(self.uv).all(axis=1) & np.isfinite(points).all(axis=1)
        if among is not None:
            usable &= np.isin(self.landmarks.rows, among.rows)
        return self.uv[usable], points[usable]


class RecoveryImages(NamedTuple):
    """Images from which lost tracking can be recovered."""

    last: KnownImage | None = None  #: Last tracked image.
    #: Last earlier image in which at least half of the landmarks were inliers; None if the last image is such an image.
    earlier_best: KnownImage | None = None

    @property
    def best(self) -> KnownImage | None:
        """Last tracked image in which at least half of the landmarks were inliers."""
        return self.last if self.earlier_best is None else self.earlier_best

    @classmethod
    def window_begun(cls, image: GreyImage, landmarks: Landmarks) -> RecoveryImages:
        """Return the recovery images of a new window: its first image."""
        return cls(KnownImage(image, landmarks.last_seen[:, :2], landmarks))

    def accepted(self, image: GreyImage, tracks: Tracks) -> RecoveryImages:
        """Return the recovery images, updated by an image whose pose was accepted."""
        known = KnownImage(image, tracks.observations[:, :2], tracks.landmarks)
        is_best = tracks.counts.in_left >= MIN_BEST_RATIO * len(tracks.inliers)
        return RecoveryImages(known, None if is_best else self.best)

    def adjusted(self, landmarks: Landmarks) -> RecoveryImages:
        """Return the recovery images, updated by the landmarks of the adjusted window.

        The newest keyframe of the window is always the last image, because each keyframe is also a recovery image.
        """
        if self.last is None:
            return self
        return self._replace(last=KnownImage(self.last.image, landmarks.last_seen[:, :2], landmarks))


class Relocaliser:
    """Recovers lost tracking. It holds the tools, and keeps no state between calls."""

    def __init__(self, tracker: Tracker, config: LocalisationConfig, camera: StereoCamera, max_corners: int) -> None:
        """`max_corners` is the approximate number of cells of the grid in which a keyframe detects corners."""
        self._tracker = tracker
        self._config = config
        self._camera = camera
        self._max_corners = max_corners

    def relocalise(
        self, frame: StereoFrame, landmarks: Landmarks, images: RecoveryImages, offset: RightCameraOffset
    ) -> Tracks | None:
        """Track from the pose by optical flow. If these tracks are not trusted, track from the pose by descriptors.

        Without a pose by descriptors, the tracks by optical flow are returned; None if there is no pose at all.
        """
        tracks = None
        pose = self.pose_by_flow(frame, images)
        if pose is not None:
            tracks = self._tracker.refine_from_afar(frame, landmarks, pose, offset)
            if tracks.is_trusted:
                return tracks
        pose = self._pose_by_descriptors(frame, images)
        return tracks if pose is None else self._tracker.refine_from_afar(frame, landmarks, pose, offset)

    def pose_by_flow(self, frame: StereoFrame, images: RecoveryImages, among: Landmarks | None = None) -> Pose | None:
        """Return the pose by optical flow from the last tracked image; None if too few landmarks agree.

        If landmarks are given, only these are used.
        """
        known = images.last
        if known is None:
            return None
        uv, points = known.observed(among)
        enough = self._config.min_tracked
        if len(uv) < enough:
            return None
        start = uv.astype(np.float32)[:, None]
        moved, found = _flow(known.image, frame.image, start)
        back, found_back = _flow(frame.image, known.image, moved)
        round_trip_px = np.abs(back - start).max(axis=(1, 2))
        good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (round_trip_px < MAX_FLOW_ROUND_TRIP_PX)
        if good.sum() < enough:
            return None
        points = points[good]
        uv = moved[good, 0].astype(np.float64)
        return _pnp(points, uv, self._camera, FLOW_RANSAC, enough)

    def _pose_by_descriptors(self, frame: StereoFrame, images: RecoveryImages) -> Pose | None:
        """Return the pose by mutual best matches with the best image; None if too few landmarks agree."""
        known = images.best
        if known is None:
            return None
        corners = find_corners(frame.left[0].image, NO_POINTS, CORNERS_RATIO * self._config.max_features, BORDER)
        uv, points = known.observed()
        enough = self._config.min_tracked
        if min(len(uv), len(corners)) < enough:
            return None
        before = _sift(known.image, uv)
        now = _sift(frame.image, corners)
        matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(before, now)
        if len(matches) < enough:
            return None
        pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches])
        points = points[pairs[:, 0]]
        uv = np.ascontiguousarray(corners[pairs[:, 1]])
        return _pnp(points, uv, self._camera, DESCRIPTOR_RANSAC, enough)

    def is_good_image(self, frame: StereoFrame, landmark_count: int) -> bool:
        """Return whether a pair shows enough corners, compared with the landmarks of the map, to begin a window."""
        corners = find_corners(frame.left[0].image, NO_POINTS, self._max_corners, BORDER)
        expected = min(landmark_count, self._max_corners)
        enough = max(self._config.min_tracked, int(GOOD_IMAGE_RATIO * expected))
        return len(corners) >= enough and is_textured(frame.right)


def _flow(
    before: GreyImage, now: GreyImage, start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the new positions of points `(N, 1, 2)`, and whether they were found `(N, 1)`."""
    end = start.copy()
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, end, winSize=FLOW_WINDOW, maxLevel=FLOW_LEVELS)
    return np.asarray(moved, dtype=np.float32), np.asarray(found, dtype=np.uint8)


def _sift(image: GreyImage, uv: FloatArray) -> NDArray[np.float32]:
    """Return upright SIFT descriptors `(N, 128)` of one size at pixels `(N, 2)`."""
    size = max(MIN_DESCRIPTOR_PX, min(image.shape) / DESCRIPTORS_PER_SIDE)
    _, descriptors = cv2.SIFT.create().compute(image, [cv2.KeyPoint(float(u), float(v), size, 0.0) for u, v in uv])
    return np.asarray(descriptors, dtype=np.float32)


def _pnp(points: FloatArray, uv: FloatArray, camera: StereoCamera, ransac: Ransac, enough: int) -> Pose | None:
    """Return the PnP pose from points `(N, 3)` at pixels `(N, 2)` by RANSAC; None if too few agree."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    ok, rotvec, translation, inliers = cv2.solvePnPRansac(
        points, uv, matrix, None, reprojectionError=MAX_REPROJECTION_PX, iterationsCount=ransac.iterations
    )
    if not ok or inliers is None or len(inliers) < max(enough, ransac.min_inlier_ratio * len(points)):
        return None
    R_camera_world = np.asarray(cv2.Rodrigues(rotvec)[0], dtype=np.float64)
    position = np.asarray(-(R_camera_world.T @ translation[:, 0]), dtype=np.float64)
    return Pose(np.ascontiguousarray(R_camera_world.T), position)
