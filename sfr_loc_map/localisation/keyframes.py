"""Keyframes: which pairs become keyframes, and how a keyframe is processed.

A keyframe adds its observations to the sliding window, receives new landmarks from stereo matches, and is adjusted
together with the other keyframes of the window (bundle adjustment). `KeyframeMaker.make` does this in a background
thread: it takes a `KeyframeJob` and returns a `KeyframeResult`. The first keyframe of a window (`begin_window`) is made
in the call that processes its pair.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask, is_finite
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap, NewLandmarks, SlidingWindow
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.frontend.landmarks import BORDER
from sfr_loc_map.localisation.frontend.masks import load_mask
from sfr_loc_map.localisation.frontend.noise import position_variance
from sfr_loc_map.localisation.frontend.pose_solver import StereoObservations
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.stereo_matching import match_corners
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.motion_size import MotionSize, size_between
from sfr_loc_map.localisation.small_linalg import median_without_nan

KEYFRAME_FLOW_RATIO = 0.05
"""Median optical flow since the last keyframe that triggers a new keyframe, as a fraction of the image width. A value
of 0.08 changes the errors by a few percent (measurements/localiser_trials.md)."""
KEYFRAME_INLIER_RATIO = 0.65
"""Minimum ratio of inliers to the landmarks of the last keyframe. Below this ratio, a new keyframe is made. If larger,
more pairs become keyframes, and the errors of keyframes accumulate. If smaller, tracking is lost more easily."""
ADJUSTMENT_ITERATIONS = 2
"""Gauss-Newton iterations per keyframe. The next keyframe continues from the result. With one iteration, the attitude
error was 5 % and 12 % larger on two drives (measurements/localiser_trials.md, "Landmarks eliminated by motions")."""
MIN_DEPTH_M = 0.5
"""Minimum depth of stereo matching, m. Rovers rarely see nearer points, and the time of the search is inversely
proportional to this depth."""
MAX_DISPARITY_RATIO = 0.5  #: Maximum disparity as a fraction of the width: the images then share half of the view.
MIN_INVERSE_DEPTH_PX = 1e-3
"""Minimum disparity, px, from which an inverse depth is computed, because noise may make the disparity of a distant
point negative."""
LARGE_IMAGE_PX = 900 * 900
"""Number of pixels from which an image has twice as many landmarks, each with a slope refined by its own patch. The
value is between the sizes that were tried, 512 x 512 and 1024 x 1024 (measurements/localiser_trials.md, "Images of
a megapixel: the sun and the edges of stones")."""
MAX_ADJUSTMENT = MotionSize(1.0, 1.0)
"""A bundle adjustment has diverged if it displaces the newest pose by more than this, m and rad. The value is far above
the usual displacement of millimetres, or of centimetres with a correction of the yaw."""
MEGAPIXEL = 1024 * 1024  #: Number of pixels from which the number of landmarks grows with `GROWTH`.
GROWTH = 0.25
"""Power of the number of pixels with which the number of landmarks grows: the square root of the side of the image. If
larger, the time of a keyframe exceeds the period of the pairs. If smaller, large images improve the accuracy less."""

ImageMask = NDArray[np.uint8]
"""`(H, W)` uint8; landmarks are not created where the mask is 0."""


class KeyframeJob(NamedTuple):
    """A tracked pair that becomes a keyframe."""

    frame: StereoFrame
    tracks: Tracks
    landmark_map: LandmarkMap  #: The map without this keyframe.
    calibration: OnlineCalibration  #: The calibration before this keyframe.
    ground_mask: ImageMask | None  #: 0 where the image does not move with the ground; None if nothing is excluded.


@dataclass(frozen=True, eq=False)
class KeyframeResult:
    """The map and the calibration after a keyframe."""

    landmark_map: LandmarkMap
    calibration: OnlineCalibration
    has_yaw_step: bool  #: Whether the yaw correction changed, which shifts all right observations and the pose.
    seconds: float  #: Duration of the processing.


def max_corners(rig: StereoRig, config: LocalisationConfig) -> int:
    """Return the approximate number of cells of the corner-detection grid, which depends on the image size.

    At most one corner is detected in each cell.
    """
    pixels = rig.width * rig.height
    factor = 2 if pixels >= LARGE_IMAGE_PX else 1
    by_size: float = factor * max(pixels / MEGAPIXEL, 1.0) ** GROWTH
    return round(config.max_features * by_size)


def adjustment_diverged(landmark_map: LandmarkMap, T_world_left: Transform) -> bool:
    """Return whether the adjustment of a map diverged.

    The newest pose or its covariance is then not finite, or the pose is far from that before the adjustment.
    """
    pose = landmark_map.window.newest_pose
    if not is_finite(*pose, landmark_map.covariance):
        return True
    return not size_between(Pose.of(T_world_left), pose).is_within(MAX_ADJUSTMENT)


class KeyframeMaker:
    """Makes keyframes. It holds parameters and masks, and keeps no state between calls."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig) -> None:
        """Load the masks. ConfigError if a mask cannot be read or its size is not the rig's."""
        self._rig = rig
        self._camera = rig.camera
        self._config = config
        self._left_mask = load_mask(config.left_mask, rig)
        self._right_mask = load_mask(config.right_mask, rig)
        self._is_large = rig.width * rig.height >= LARGE_IMAGE_PX
        self._max_corners = max_corners(rig, config)

    def is_needed(self, tracks: Tracks, landmark_map: LandmarkMap) -> bool:
        """Return whether few landmarks of the last keyframe are tracked, or the landmarks moved far in the image."""
        is_active = landmark_map.window.active[tracks.landmarks.rows]
        flow = _flow_since(tracks.landmarks.last_seen, tracks.observations, tracks.inliers, is_active)
        if flow.tracked < KEYFRAME_INLIER_RATIO * flow.in_keyframe:
            return True
        return flow.median_px > KEYFRAME_FLOW_RATIO * self._rig.width  # False for NaN

    def begin_window(
        self, frame: StereoFrame, pose: Pose, calibration: OnlineCalibration, ground_mask: ImageMask | None
    ) -> KeyframeResult:
        """Begin a window with a pair at a pose.

        The first pose of a window is fixed (gauge), because otherwise each relinearisation would move the whole window.
        """
        start = time.perf_counter()
        window, calibration = self._first_window(frame, pose, calibration, ground_mask)
        landmark_map = window.adjusted(ADJUSTMENT_ITERATIONS)
        landmark_map.prepare()
        return KeyframeResult(landmark_map, calibration, has_yaw_step=False, seconds=time.perf_counter() - start)

    def landmark_count(
        self, frame: StereoFrame, pose: Pose, calibration: OnlineCalibration, ground_mask: ImageMask | None
    ) -> int:
        """Return the number of landmarks of a window that begins with a pair, which the adjustment does not change."""
        window, _ = self._first_window(frame, pose, calibration, ground_mask)
        return int(np.count_nonzero(window.active))

    def _first_window(
        self, frame: StereoFrame, pose: Pose, calibration: OnlineCalibration, ground_mask: ImageMask | None
    ) -> tuple[SlidingWindow, OnlineCalibration]:
        """Return a window of one keyframe before its adjustment, and the calibration from its matches."""
        empty = SlidingWindow.empty(self._camera, self._config.window_keyframes)
        nothing_observed = StereoObservations(np.zeros((0, 4)), np.zeros((0, 2, 3)))
        window = empty.with_keyframe(pose, np.zeros(0, np.intp), nothing_observed)
        return self._with_landmarks(window, frame, calibration.window_begun(), ground_mask)

    def make(self, job: KeyframeJob) -> KeyframeResult:
        """Add a tracked pair to the window as a keyframe, and adjust the window.

        LinAlgError if the adjustment is singular.
        """
        start = time.perf_counter()
        tracks = job.tracks
        rows = tracks.landmarks.rows
        inliers = tracks.inliers
        window = job.landmark_map.window.deactivated(rows[~inliers])
        observed = StereoObservations(tracks.observations[inliers], tracks.variance[inliers])
        window = window.with_keyframe(tracks.pose, rows[inliers], observed)
        calibration, yaw_step_px = job.calibration.with_window_yaw(job.landmark_map.right_offset)
        if yaw_step_px != 0.0:
            window = window.with_yaw_corrected(yaw_step_px)
        window, calibration = self._with_landmarks(window, job.frame, calibration, job.ground_mask)
        landmark_map = window.adjusted(ADJUSTMENT_ITERATIONS)
        landmark_map.prepare()
        return KeyframeResult(landmark_map, calibration, yaw_step_px != 0.0, time.perf_counter() - start)

    def _with_landmarks(
        self, window: SlidingWindow, frame: StereoFrame, calibration: OnlineCalibration, ground_mask: ImageMask | None
    ) -> tuple[SlidingWindow, OnlineCalibration]:
        """Add landmarks at new corners that are matched in stereo, away from those observed in the newest keyframe."""
        known = _observed_in_newest(window)
        mask = self._left_mask if ground_mask is None else ground_mask
        if self._left_mask is not None and ground_mask is not None:
            mask = np.minimum(self._left_mask, ground_mask)
        corners = find_corners(frame.left[0].image, known[:, :2].copy(), self._max_corners, BORDER, mask)
        if not len(corners):
            return window, calibration
        focal_baseline = self._rig.fx * self._rig.baseline_m
        found = match_corners(
            frame.left,
            frame.right,
            corners,
            known,
            min(focal_baseline / MIN_DEPTH_M, MAX_DISPARITY_RATIO * self._rig.width),
            calibration.offset.pitch_px,
            self._right_mask,
            own_slopes=self._is_large,
        )
        calibration = calibration.with_matches(found.right, found.right[:, 1] - found.uv[:, 1])
        right_uv = found.right - calibration.offset.at(found.right, self._camera)
        inverse_depth_per_px = 1.0 / focal_baseline
        disparity_px = np.maximum(found.uv[:, 0] - right_uv[:, 0], MIN_INVERSE_DEPTH_PX)
        variance = position_variance(found.covariance, found.residual, self._camera.fx)
        new = NewLandmarks(
            uv=found.uv,
            inverse_depth=disparity_px * inverse_depth_per_px,
            slopes=found.slope * inverse_depth_per_px,
            patches=found.patches,
            observed=StereoObservations(np.column_stack((found.uv, right_uv)), np.stack((variance, variance), axis=1)),
        )
        return window.with_landmarks(frame.left, new), calibration


class _Flow(NamedTuple):
    """Image motion of landmarks in the left image since the newest keyframe."""

    in_keyframe: int  #: Number of active landmarks that were observed in the keyframe.
    tracked: int  #: Number of inliers that were observed in the keyframe.
    median_px: float  #: Median length of their image motions, px; NaN if there are none.


@jit
def _flow_since(keyframe_uv: FloatArray, uv: FloatArray, inliers: Mask, is_active: Mask) -> _Flow:
    """Return the flow of landmarks from pixels `(M, 4)` in the newest keyframe to those in a pair."""
    in_keyframe = 0
    tracked = 0
    flow_px = np.full(len(uv), np.nan)
    for n in range(len(uv)):
        in_keyframe += is_active[n] and not np.isnan(keyframe_uv[n, 0])
        if inliers[n]:
            u = uv[n, 0] - keyframe_uv[n, 0]
            v = uv[n, 1] - keyframe_uv[n, 1]
            flow_px[n] = np.sqrt(u * u + v * v)  # NaN if not observed
            tracked += not np.isnan(flow_px[n])
    return _Flow(in_keyframe, tracked, median_without_nan(flow_px))


def _observed_in_newest(window: SlidingWindow) -> FloatArray:
    """Return u, v and disparity `(M, 3)` of the active landmarks observed in both images of the newest keyframe, px."""
    observed = window.problem.observations[window.active, -1]
    known = np.column_stack((observed[:, :2], observed[:, 0] - observed[:, 2]))
    return np.asarray(known[np.isfinite(known).all(axis=1)])
