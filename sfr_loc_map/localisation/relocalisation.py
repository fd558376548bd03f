"""Relocalisation: the pose where prediction fails, from landmarks found again in an earlier image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.frontend.landmarks import BORDER, Landmarks
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult

RELOCALISATION_ATTEMPTS = 2
"""Good images that are compared with the window before a new one begins."""
NO_POINTS = np.zeros((0, 2))
FLOW_WINDOW = (21, 21)
MAX_FLOW_ROUND_TRIP_PX = 1.0
"""Largest distance between a point and itself after flow forwards and backwards."""
MAX_REPROJECTION_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class RelocalisationKeyframe:
    """A left image with the landmarks observed in it.

    Attributes:
        image: `(H, W)` uint8.
        uv: `(N, 2)` where they were observed, pixels; NaN where not.
        points: `(N, 3)` metres, world; NaN at infinity.
        index: `(N,)` their rows in the sliding window.
    """

    image: GreyImage
    uv: FloatArray
    points: FloatArray
    index: NDArray[np.intp]

    def subset(self, index: NDArray[np.intp]) -> RelocalisationKeyframe:
        """Return it with the landmarks in these rows of the window alone."""
        kept = np.isin(self.index, index)
        return RelocalisationKeyframe(self.image, self.uv[kept], self.points[kept], self.index[kept])

    @property
    def usable(self) -> Mask:
        """Points `(N,)` that were observed and are not at infinity."""
        return np.asarray(np.isfinite(self.uv).all(axis=1) & np.isfinite(self.points).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A left image `(H, W)` and where, `(N, 2)` pixels, landmarks were observed in it."""

    image: GreyImage
    uv: FloatArray
    landmarks: Landmarks

    @property
    def keyframe(self) -> RelocalisationKeyframe:
        """The same with the places of the landmarks."""
        return RelocalisationKeyframe(self.image, self.uv, self.landmarks.points, self.landmarks.index)


class Relocaliser:
    """Recovers lost tracking.

    It keeps two images: the last one tracked, from which optical flow reaches the next few, and the last one in which
    most landmarks were observed, which descriptors recognise also after a gap.
    """

    def __init__(self, tracker: Tracker, config: LocalisationConfig, camera: StereoCamera) -> None:
        """Start without images."""
        self._tracker, self._config, self._camera = tracker, config, camera
        self._last: _Seen | None = None
        self._best: _Seen | None = None
        self._attempts = 0

    def restart(self, image: GreyImage, landmarks: Landmarks) -> None:
        """Keep the first keyframe of a window alone."""
        self._last = self._best = _Seen(image, landmarks.last_seen[:, :2], landmarks)
        self._attempts = 0

    def recovered(self) -> None:
        """Give the next loss of tracking all attempts again."""
        self._attempts = 0

    def remember(self, image: GreyImage, result: TrackingResult) -> None:
        """Keep a tracked left image."""
        self._last = _Seen(image, result.observations[:, :2], result.landmarks)
        if result.left_inlier_count >= 0.5 * len(result.landmarks):
            self._best = self._last

    def update(self, landmarks: Landmarks) -> None:
        """Take the landmarks of the keyframe that the last image has become."""
        if self._last is None:
            return
        seen = _Seen(self._last.image, landmarks.last_seen[:, :2], landmarks)
        self._best = seen if self._best is self._last else self._best
        self._last = seen

    def pose_by_flow(self, frame: StereoFrame, landmarks: Landmarks) -> Pose | None:
        """Return the pose that some landmarks of the last tracked image give by optical flow, None without one."""
        if self._last is None:
            return None
        keyframe = self._last.keyframe.subset(landmarks.index)
        return pnp_from_optical_flow(keyframe, frame.image, self._camera, self._config.min_tracked)

    def relocalise(self, frame: StereoFrame, landmarks: Landmarks, offset: RightOffset) -> TrackingResult | None:
        """Track the landmarks from poses by optical flow, then by descriptors.

        Returns:
            The first result that is trusted, otherwise the last one; None where no pose was found at all.
        """
        if self._last is None or self._best is None:
            return None
        min_inliers, result = self._config.min_tracked, None
        pose = pnp_from_optical_flow(self._last.keyframe, frame.image, self._camera, min_inliers)
        if pose is not None:
            result = self._tracker.refine_from_afar(frame, landmarks, pose, offset)
            if self._tracker.trusts(result):
                return result
        corners = find_corners(frame.left.levels[0], NO_POINTS, 2 * self._config.max_features, BORDER)
        pose = pnp_from_descriptors(self._best.keyframe, frame.image, corners, self._camera, min_inliers)
        return result if pose is None else self._tracker.refine_from_afar(frame, landmarks, pose, offset)

    def gives_up(self, frame: StereoFrame, landmarks: Landmarks) -> bool:
        """Count an image without a recognised landmark; tell whether a new window shall begin with it."""
        corners = find_corners(frame.left.levels[0], NO_POINTS, self._config.max_features, BORDER)
        enough = max(self._config.min_tracked, len(landmarks) // 2)
        self._attempts += len(corners) >= enough and frame.right_is_textured
        return self._attempts > RELOCALISATION_ATTEMPTS


def pnp_from_optical_flow(
    keyframe: RelocalisationKeyframe, image: GreyImage, camera: StereoCamera, min_inliers: int
) -> Pose | None:
    """Find the pose of a left image from points observed in an earlier one.

    Pyramidal optical flow with a check backwards (Bouguet 2001), then a perspective pose by random samples.

    Args:
        keyframe: The earlier image.
        image: `(H, W)` uint8.
        camera: Camera of the rig.
        min_inliers: Minimum number of points that agree.

    Returns:
        The pose, None where too few points agree.
    """
    usable = keyframe.usable
    if usable.sum() < min_inliers:
        return None
    start = keyframe.uv[usable].astype(np.float32)[:, None]
    levels = int(np.clip(np.log2(min(image.shape) / 16), 2, 6))
    moved, found = _flow(keyframe.image, image, start, levels)
    back, found_back = _flow(image, keyframe.image, moved, levels)
    round_trip = np.abs(back - start).max(axis=(1, 2))
    good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (round_trip < MAX_FLOW_ROUND_TRIP_PX)
    if good.sum() < min_inliers:
        return None
    points, uv = keyframe.points[usable][good], moved[good, 0].astype(np.float64)
    return _pnp(points, uv, camera, iterations=300, min_inliers=max(min_inliers, 0.3 * len(points)))


def pnp_from_descriptors(
    keyframe: RelocalisationKeyframe, image: GreyImage, corners: FloatArray, camera: StereoCamera, min_inliers: int
) -> Pose | None:
    """Find the pose of a left image taken far from an earlier one, as after lost images.

    Upright SIFT descriptors (Lowe 2004) of one size, mutual best matches, then a perspective pose by random samples.

    Args:
        keyframe: The earlier image.
        image: `(H, W)` uint8.
        corners: `(M, 2)` pixels of the image where points may be.
        camera: Camera of the rig.
        min_inliers: Minimum number of points that agree.

    Returns:
        The pose, None where too few points agree.
    """
    usable = keyframe.usable
    if min(int(usable.sum()), len(corners)) < min_inliers:
        return None
    old = _sift(keyframe.image, keyframe.uv[usable])
    new = _sift(image, corners)
    matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(old, new)
    if len(matches) < min_inliers:
        return None
    pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches])
    points, uv = keyframe.points[usable][pairs[:, 0]], np.ascontiguousarray(corners[pairs[:, 1]])
    return _pnp(points, uv, camera, iterations=2000, min_inliers=max(min_inliers, 0.05 * len(points)))


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
