"""Keyframe work: new landmarks, bundle adjustment and online calibration, in a background thread."""

from __future__ import annotations

import time
from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, median
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import HostedLandmarks, KeyframeDrift, SlidingWindow
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners, load_mask
from sfr_loc_map.localisation.frontend.landmarks import BORDER, Landmarks
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.sparse_stereo import match_corners
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.parallel import in_background

MIN_DISPARITY_PX = 1e-3
LARGE_IMAGE_PX, MEGAPIXEL = 900 * 900, 1024 * 1024
"""Pixels of an image from which on there are twice `max_features` landmarks, whose patches tell their slopes; and
pixels from which on the number grows with the fourth root."""


class KeyframeBackend:
    """Owns the sliding window, the landmarks and the online calibration.

    While a keyframe is in work (from `add_keyframe` to `wait`) all of it belongs to the background thread: the caller
    waits before it reads anything, so that results do not depend on timing.

    Attributes:
        landmarks: Active landmarks.
        calibration: Rotation error of the right camera.
        keyframe_count: Keyframes since the start.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig, camera: StereoCamera, tracker: Tracker) -> None:
        """Start without a window.

        Args:
            rig: Rectified rig.
            config: Parameters.
            camera: Camera of the rig.
            tracker: Knows the variance of matched positions.

        Raises:
            ConfigError: If a mask cannot be read or has another size than the rig.
        """
        self._rig, self._config, self._camera, self._tracker = rig, config, camera, tracker
        self._left_mask, self._right_mask = (load_mask(path, rig) for path in (config.left_mask, config.right_mask))
        pixels = rig.width * rig.height
        self._large = pixels >= LARGE_IMAGE_PX
        self._wanted = round(config.max_features * (1 + self._large) * max(pixels / MEGAPIXEL, 1.0) ** 0.25)
        self._foreign_mask: NDArray[np.uint8] | None = None
        self._pending: Future[float] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget everything, after the keyframe in work."""
        self.wait()
        self._window = self._new_window()
        self.landmarks = Landmarks.none()
        self.calibration = OnlineCalibration(self._camera, self._config.window_keyframes)
        self.keyframe_count = 0

    def leave_window(self) -> None:
        """Forget the window; what is known of the right camera stays."""
        self.wait()
        self._window, self.landmarks = self._new_window(), Landmarks.none()

    @property
    def started(self) -> bool:
        """Whether there is a window."""
        return len(self._window) > 0

    @property
    def pose(self) -> Pose:
        """Left camera at the newest keyframe, in the world."""
        return Pose(self._window.keyframes.rotations[-1], self._window.keyframes.positions[-1])

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the newest keyframe's pose in the window."""
        return self._window.last_covariance

    @property
    def drift(self) -> KeyframeDrift | None:
        """How well the newest keyframe is known from the one before; None in the first of a window."""
        return self._window.drift

    @property
    def masks(self) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8] | None]:
        """Where no landmark is made in the left and the right image: `(H, W)` uint8, 0 there; None for nowhere."""
        return _both_masks(self._left_mask, self._foreign_mask), self._right_mask

    def wait(self) -> float | None:
        """Wait for the keyframe in work; return the seconds that it took, None without one."""
        pending, self._pending = self._pending, None
        return None if pending is None else pending.result()

    def leave_out(self, rows: NDArray[np.intp], mask: NDArray[np.uint8] | None) -> None:
        """Stop tracking landmarks `(N,)` of the window that do not move with the ground.

        Args:
            rows: Their rows in the window.
            mask: `(H, W)` uint8, 0 where no landmark shall be made from now on; None for everywhere.
        """
        self._foreign_mask = mask
        if len(rows):
            self._window.deactivate(rows)
            self.landmarks = self._window.landmarks()

    def begin(self, frame: StereoFrame, T_world_left: Transform) -> int:
        """Begin a window with its first keyframe; the window before stays where there are too few landmarks.

        The window takes its first pose as exact: a window that may move as a whole would do so with each adjustment, as
        it is linearised again.

        Returns:
            Number of landmarks found; the window has begun if they are at least `min_tracked`.
        """
        self.calibration.interrupt()
        before = self._window, self.landmarks
        self._window = self._new_window()
        self._window.add_keyframe(Pose.of(T_world_left), np.zeros(0, np.intp), np.zeros((0, 4)), np.zeros((0, 2, 3)))
        self._add_landmarks(frame, np.zeros((0, 3)))
        found = len(self.landmarks)
        if found < self._config.min_tracked:
            self._window, self.landmarks = before
        else:
            self.keyframe_count += 1
        return found

    def without_drift(self, result: TrackingResult) -> TrackingResult:
        """Return a result without the drift of the right camera that it shows, which is corrected from now on."""
        px = self.calibration.learn_shift(self._tracker.right_shift(result))
        return result if px == 0.0 else self._tracker.with_right_moved(result, RightOffset(u=px))

    def wants_keyframe(self, result: TrackingResult) -> bool:
        """Tell whether a pair shall be a keyframe: few landmarks of the last one are left, or they moved far."""
        flow = result.flow_px
        followed = result.landmarks.among(self.landmarks)
        seen_by_keyframe = np.count_nonzero(np.isfinite(result.landmarks.last_seen[followed, 0]))
        if len(flow) < self._config.keyframe_share * seen_by_keyframe:
            return True
        return median(flow) > self._config.keyframe_flow * self._rig.width

    def complete(self, frame: StereoFrame, result: TrackingResult) -> TrackingResult:
        """Return the tracking of all landmarks, as in a keyframe, from that of those that are followed."""
        if len(result.landmarks) >= len(self.landmarks):
            return result
        all_of_them = self._tracker.refine_rest(frame, self.landmarks, result, self.calibration.offset)
        return all_of_them if self._tracker.trusts(all_of_them) else result

    def add_keyframe(self, frame: StereoFrame, result: TrackingResult) -> None:
        """Make a tracked pair a keyframe, in the background."""
        self.keyframe_count += 1
        self._pending = in_background(self._add_keyframe, frame, result)

    def _add_keyframe(self, frame: StereoFrame, result: TrackingResult) -> float:
        """Make a tracked pair a keyframe; return the seconds that it took."""
        start = time.perf_counter()
        window, good = self._window, result.inliers
        window.deactivate(result.landmarks.index[~good])
        window.add_keyframe(result.pose, result.landmarks.index[good], result.observations[good], result.variance[good])
        window.shift_right_observations(-self.calibration.learn_yaw(*window.right_offset))
        known = window.newest_observations
        known = np.column_stack((known[:, :2], known[:, 0] - known[:, 2]))
        self._add_landmarks(frame, known[np.isfinite(known).all(axis=1)])
        return time.perf_counter() - start

    def _add_landmarks(self, frame: StereoFrame, known: FloatArray) -> None:
        """Detect and match new landmarks beside known ones `(M, 3)` (u, v, disparity), then adjust the window."""
        mask, _ = self.masks
        corners = find_corners(frame.left.levels[0], known[:, :2].copy(), self._wanted, BORDER, mask)
        if len(corners):
            self._match_landmarks(frame, corners, known)
        self._window.adjust(self._config.adjustment_rounds)
        self.landmarks = self._window.landmarks()
        self.landmarks.prepare()

    def _match_landmarks(self, frame: StereoFrame, corners: FloatArray, known: FloatArray) -> None:
        max_disparity = min(self._rig.fx * self._rig.baseline_m / self._config.min_depth_m, 0.5 * self._rig.width)
        offset_v, own_slopes = self.calibration.offset.v, self._large
        found = match_corners(frame.left, frame.right, corners, known, max_disparity, offset_v, own_slopes=own_slopes)
        found = found.outside(self._right_mask)
        self.calibration.learn_vertical(found.right, found.right[:, 1] - found.uv[:, 1])
        right_uv = found.right - self.calibration.offset.at(found.right, self._camera)
        inverse_depth_per_px = 1.0 / (self._rig.fx * self._rig.baseline_m)
        variance = self._tracker.position_variance(found.covariance, found.residual)
        inverse_depth = np.maximum(found.uv[:, 0] - right_uv[:, 0], MIN_DISPARITY_PX) * inverse_depth_per_px
        new = HostedLandmarks.new(len(self._window) - 1, found.uv, inverse_depth, found.slope * inverse_depth_per_px)
        observed_uv, variances = np.column_stack((found.uv, right_uv)), np.stack((variance, variance), axis=1)
        self._window.add_landmarks(frame.left, new, found.patches, observed_uv, variances)

    def _new_window(self) -> SlidingWindow:
        return SlidingWindow(self._camera, self._config.window_keyframes)


def _both_masks(one: NDArray[np.uint8] | None, other: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
    """Return what neither of two masks leaves out."""
    if one is None or other is None:
        return other if one is None else one
    return np.minimum(one, other)
