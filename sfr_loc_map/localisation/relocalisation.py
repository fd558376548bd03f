"""Relocalisation: the pose where prediction fails, from landmarks found again in an earlier image."""

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
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult, is_textured

RELOCALISATION_ATTEMPTS = 2  #: Good images that are compared with the window before a new one begins.
NO_POINTS = np.zeros((0, 2))
FLOW_WINDOW = (21, 21)
MAX_FLOW_ROUND_TRIP_PX = 1.0  #: Largest distance between a point and itself after flow forwards and backwards.
MAX_REPROJECTION_PX = 3.0


class KnownImage(NamedTuple):
    """A left image `(H, W)` and where, `(N, 2)` pixels, NaN where not, landmarks were observed in it."""

    image: GreyImage
    uv: FloatArray
    landmarks: Landmarks

    def places(self, among: Landmarks | None = None) -> tuple[FloatArray, FloatArray]:
        """Return pixels `(M, 2)` and points `(M, 3)` of the landmarks that were observed and are not at infinity.

        If others of the same window are given, those among them.
        """
        points = self.landmarks.points
        usable = np.isfinite(self.uv).all(axis=1) & np.isfinite(points).all(axis=1)
        if among is not None:
            usable &= np.isin(self.landmarks.index, among.index)
        return self.uv[usable], points[usable]


class Relocaliser:
    """Recovers lost tracking: by optical flow from the `last` image tracked, by descriptors from the `best` one.

    `attempts` are good images since a landmark was recognised; the caller starts them again.
    """

    def __init__(self, tracker: Tracker, config: LocalisationConfig, camera: StereoCamera) -> None:
        self._tracker, self._config, self._camera = tracker, config, camera
        self.last: KnownImage | None = None
        self.best: KnownImage | None = None
        self.attempts = 0

    def restart(self, image: GreyImage, landmarks: Landmarks) -> None:
        """Keep the first keyframe of a window alone."""
        self.last = self.best = KnownImage(image, landmarks.last_seen[:, :2], landmarks)
        self.attempts = 0

    def pose_by_flow(self, frame: StereoFrame, among: Landmarks | None = None) -> Pose | None:
        """Return the pose that landmarks of the last tracked image give by optical flow, None where too few agree.

        Pyramidal optical flow with a check backwards (Bouguet 2001), then a perspective pose by random samples. If
        landmarks are given, those among them.
        """
        if self.last is None:
            return None
        before, image, enough = self.last.image, frame.image, self._config.min_tracked
        uv, points = self.last.places(among)
        if len(uv) < enough:
            return None
        start = uv.astype(np.float32)[:, None]
        levels = int(np.clip(np.log2(min(image.shape) / 16), 2, 6))
        moved, found = _flow(before, image, start, levels)
        back, found_back = _flow(image, before, moved, levels)
        round_trip = np.abs(back - start).max(axis=(1, 2))
        good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (round_trip < MAX_FLOW_ROUND_TRIP_PX)
        if good.sum() < enough:
            return None
        points, uv = points[good], moved[good, 0].astype(np.float64)
        return _pnp(points, uv, self._camera, iterations=300, min_inliers=max(enough, 0.3 * len(points)))

    def _pose_by_descriptors(self, frame: StereoFrame, best: KnownImage) -> Pose | None:
        """Return the pose of an image taken far from the best one, as after lost images; None where too few agree.

        Upright SIFT descriptors (Lowe 2004) of one size at corners, mutual best matches, then a perspective pose by
        random samples.
        """
        corners = find_corners(frame.left[0].image, NO_POINTS, 2 * self._config.max_features, BORDER)
        (uv, points), enough = best.places(), self._config.min_tracked
        if min(len(uv), len(corners)) < enough:
            return None
        before, now = _sift(best.image, uv), _sift(frame.image, corners)
        matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(before, now)
        if len(matches) < enough:
            return None
        pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches])
        points, uv = points[pairs[:, 0]], np.ascontiguousarray(corners[pairs[:, 1]])
        return _pnp(points, uv, self._camera, iterations=2000, min_inliers=max(enough, 0.05 * len(points)))

    def relocalise(self, frame: StereoFrame, landmarks: Landmarks, offset: RightOffset) -> TrackingResult | None:
        """Track by optical flow, then by descriptors; return the first trusted result, else the last, or None."""
        pose, result = self.pose_by_flow(frame), None
        if pose is not None:
            result = self._tracker.refine_from_afar(frame, landmarks, pose, offset)
            if result.trusted:
                return result
        pose = None if self.best is None else self._pose_by_descriptors(frame, self.best)
        return result if pose is None else self._tracker.refine_from_afar(frame, landmarks, pose, offset)

    def gives_up(self, frame: StereoFrame, landmarks: Landmarks) -> bool:
        """Count an image without a recognised landmark; tell whether a new window shall begin with it."""
        corners = find_corners(frame.left[0].image, NO_POINTS, self._config.max_features, BORDER)
        enough = max(self._config.min_tracked, len(landmarks.index) // 2)
        self.attempts += len(corners) >= enough and is_textured(frame.right)
        return self.attempts > RELOCALISATION_ATTEMPTS


def _flow(
    before: GreyImage, now: GreyImage, start: NDArray[np.float32], levels: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return where points `(N, 1, 2)` went, and `(N, 1)` whether they were found."""
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, start.copy(), winSize=FLOW_WINDOW, maxLevel=levels)
    return np.asarray(moved, dtype=np.float32), np.asarray(found, dtype=np.uint8)


def _sift(image: GreyImage, uv: FloatArray) -> NDArray[np.float32]:
    """Return the descriptors `(N, 128)` of pixels `(N, 2)`."""
    size = max(8.0, min(image.shape) / 32)
    _, descriptors = cv2.SIFT.create().compute(image, [cv2.KeyPoint(float(u), float(v), size, 0.0) for u, v in uv])
    return np.asarray(descriptors, dtype=np.float32)


def _pnp(
    points: FloatArray, uv: FloatArray, camera: StereoCamera, *, iterations: int, min_inliers: float
) -> Pose | None:
    """Return the pose from points `(N, 3)` at pixels `(N, 2)` by random samples; None where too few agree."""
    fx, fy, cx, cy, _ = camera
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    ok, rotvec, translation, inliers = cv2.solvePnPRansac(
        points, uv, matrix, None, reprojectionError=MAX_REPROJECTION_PX, iterationsCount=iterations
    )
    if not ok or inliers is None or len(inliers) < min_inliers:
        return None
    r_cw = np.asarray(cv2.Rodrigues(rotvec)[0], dtype=np.float64)
    return Pose(np.ascontiguousarray(r_cw.T), np.asarray(-(r_cw.T @ translation[:, 0]), dtype=np.float64))
