"""Keyframe work: new landmarks, bundle adjustment and online calibration, in a background thread."""

from __future__ import annotations

import time
from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import SlidingWindow
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners, load_mask
from sfr_loc_map.localisation.frontend.landmarks import BORDER, Landmarks
from sfr_loc_map.localisation.frontend.patch import LEVELS
from sfr_loc_map.localisation.frontend.sparse_stereo import match_corners
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult

KEYFRAME_FLOW = 0.05
"""Median optical flow since the last keyframe, as a share of the image width, that triggers a new one."""
ADJUSTMENT_ROUNDS = 2  #: Gauss-Newton iterations of each window adjustment: the next keyframe goes on from there.
MIN_DEPTH_M = 0.5  #: Nearest depth of stereo matching.
MIN_DISPARITY_PX = 1e-3
LARGE_IMAGE_PX, MEGAPIXEL = 900 * 900, 1024 * 1024
"""Pixels of an image from which on there are twice `max_features` landmarks, whose patches tell their slopes; and
pixels from which on the number grows with the fourth root."""


class KeyframeBackend:
    """Owns the sliding window (None before it has begun), the landmarks and the online calibration.

    While `add_keyframe` is at work (`pending`) all of it belongs to the background thread: the caller
    waits before it reads anything, so that results do not depend on timing. No landmark is made where `dynamic_mask`
    `(H, W)` is 0, as the image does not move with the ground there. `corrected`: the last keyframe moved all right
    positions, and so the pose.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig, tracker: Tracker) -> None:
        """Start without a window; raises ConfigError if a mask cannot be read or has another size than the rig."""
        self._rig, self._camera, self._config, self._tracker = rig, rig.camera, config, tracker
        self._left_mask, self._right_mask = (load_mask(path, rig) for path in (config.left_mask, config.right_mask))
        pixels = rig.width * rig.height
        self._large = pixels >= LARGE_IMAGE_PX
        self._wanted = round(config.max_features * (1 + self._large) * max(pixels / MEGAPIXEL, 1.0) ** 0.25)
        self.dynamic_mask: NDArray[np.uint8] | None = None
        self.pending: Future[float] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget everything, after the keyframe in work."""
        self.leave_window()
        self.calibration = OnlineCalibration(self._camera, self._config.window_keyframes)
        self.keyframe_count, self.corrected = 0, False

    def leave_window(self) -> None:
        """Forget the window; what is known of the right camera stays."""
        if self.pending is not None:
            self.pending.result()
        self.pending = None
        self.window: SlidingWindow | None = None
        self.landmarks = Landmarks.none()

    @property
    def masks(self) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8] | None]:
        """Where no landmark is made in the left and the right image: `(H, W)` uint8, 0 there; None for nowhere."""
        left, dynamic = self._left_mask, self.dynamic_mask
        if left is None or dynamic is None:
            return dynamic if left is None else left, self._right_mask
        return np.minimum(left, dynamic), self._right_mask

    def begin(self, frame: StereoFrame, T_world_left: Transform) -> int:
        """Begin a window with its first keyframe; the window before stays where there are too few landmarks.

        The window takes its first pose as exact: a window that may move as a whole would do so with each adjustment, as
        it is linearised again. Returns the number of landmarks found; it has begun if they are at least `min_tracked`.
        """
        self.calibration.interrupt()
        before = self.window, self.landmarks
        self.window = window = SlidingWindow(self._camera, self._config.window_keyframes)
        window.add_keyframe(Pose.of(T_world_left), np.zeros(0, np.intp), np.zeros((0, 4)), np.zeros((0, 2, 3)))
        self._add_landmarks(window, frame, np.zeros((0, 3)))
        found = len(self.landmarks.index)
        if found < self._config.min_tracked:
            self.window, self.landmarks = before
        else:
            self.keyframe_count += 1
        return found

    def add_keyframe(self, window: SlidingWindow, frame: StereoFrame, result: TrackingResult) -> float:
        """Make a tracked pair a keyframe of the window; return the seconds that it took."""
        start, good = time.perf_counter(), result.inliers
        self.keyframe_count += 1
        rows = result.landmarks.index
        window.active[rows[~good]] = False
        window.add_keyframe(result.pose, rows[good], result.observations[good], result.variance[good])
        change = self.calibration.learn_yaw(*window.right_offset)
        self.corrected = change != 0.0
        if self.corrected:  # all right positions move as by a yaw of the right camera
            uv = window.problem.observations.copy()
            x = (uv[:, :, 2] - self._camera.cx) / self._camera.fx
            uv[:, :, 2] -= change * (1.0 + x * x)
            window.problem = window.problem._replace(observations=uv)
        known = window.problem.observations[window.active, -1]
        known = np.column_stack((known[:, :2], known[:, 0] - known[:, 2]))
        self._add_landmarks(window, frame, known[np.isfinite(known).all(axis=1)])
        return time.perf_counter() - start

    def _add_landmarks(self, window: SlidingWindow, frame: StereoFrame, known: FloatArray) -> None:
        """Detect and match new landmarks beside known ones `(M, 3)` (u, v, disparity), then adjust the window."""
        mask, right_mask = self.masks
        corners = find_corners(frame.left[0].image, known[:, :2].copy(), self._wanted, BORDER, mask)
        if len(corners):
            camera, calibration, per_px = self._camera, self.calibration, self._rig.fx * self._rig.baseline_m
            max_disparity, offset_v = min(per_px / MIN_DEPTH_M, 0.5 * self._rig.width), calibration.offset.v
            found = match_corners(
                frame.left, frame.right, corners, known, max_disparity, offset_v, right_mask, own_slopes=self._large
            )
            calibration.learn_vertical(found.right, found.right[:, 1] - found.uv[:, 1])
            right_uv = found.right - calibration.offset.at(found.right, camera)
            inverse_depth_per_px = 1.0 / per_px
            variance = self._tracker.position_variance(found.covariance, found.residual)
            inverse_depth = np.maximum(found.uv[:, 0] - right_uv[:, 0], MIN_DISPARITY_PX) * inverse_depth_per_px
            observed, variances = np.column_stack((found.uv, right_uv)), np.stack((variance, variance), axis=1)
            slopes = found.slope * inverse_depth_per_px
            window.add_landmarks(frame.left, found.uv, inverse_depth, slopes, found.patches, observed, variances)
        window.adjust(ADJUSTMENT_ROUNDS)
        self.landmarks = marks = window.landmarks()
        # what the next pairs are compared with is found and copied here
        _ = marks.median_depth, marks.followed.median_depth
        _ = marks.followed.patches[0], marks.rest.patches[0]
        _ = [marks.followed.few.patches[level] for level in range(1, LEVELS)]
