"""The localiser: one call per stereo pair."""

from __future__ import annotations

import time
from concurrent.futures import Future

import numpy as np

from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import RightOffset
from sfr_loc_map.localisation.backend.sliding_window import Landmarks, Window
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.localisation.frontend.feature_detection import find_corners, load_mask
from sfr_loc_map.localisation.frontend.image_pyramid import Pyramid, build_pyramid
from sfr_loc_map.localisation.frontend.patch_tracking import HALF
from sfr_loc_map.localisation.frontend.sparse_stereo import match_corners
from sfr_loc_map.localisation.frontend.tracking import Pose, Tracked, Tracker
from sfr_loc_map.localisation.parallel import both, in_background
from sfr_loc_map.localisation.pose_covariance import UNSEEN_SIGMA, Start, common_covariance, covariance_of_rb
from sfr_loc_map.localisation.relocalisation import WellSeen, pose_by_descriptors, pose_by_flow
from sfr_loc_map.localisation.stage_timer import Stages

BORDER = HALF + 4
"""Pixels along the edges where no corner is taken: a patch with its gradients must fit."""
MOST_MISSED = 4
"""Pairs that may be missing for the motion before them still to be a guess."""
PATIENCE = 2
"""Good pictures that are tried against the old window before a new one is begun."""


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair.

    What a keyframe needs besides its pose (new landmarks, the adjustment of the window) is done after its call, in a
    thread of its own; the next call waits for the end of it, so that results do not depend on timing.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig, T_ds_rb: Transform) -> None:
        """Start at a given pose.

        Args:
            rig: Rectified rig with its place on the rover.
            config: Parameters.
            T_ds_rb: Pose of RB in DS at the first pair.

        Raises:
            GeometryError: If the rig's place on the rover is not known.
            ConfigError: If a mask cannot be read or has another size than the rig.
        """
        self._rig, self._config = rig, config
        self._T_rb_left = rig.T_rb_left
        self._camera = np.array([rig.fx, rig.fy, rig.cx, rig.cy])
        self._masks = tuple(load_mask(path, rig) for path in (config.left_mask, config.right_mask))
        self._tracker = Tracker(rig, config, self._camera)
        self._keyframe: Future[float] | None = None
        self._max_disparity = min(rig.fx * rig.baseline_m / config.min_depth_m, 0.5 * rig.width)
        self.reset(T_ds_rb)

    def reset(self, T_ds_rb: Transform) -> None:
        """Forget everything and start anew at this pose."""
        self._end_keyframe()
        self._window = Window(self._camera, self._rig.baseline_m, self._config.window_keyframes)
        self._T_ds_world = T_ds_rb @ self._T_rb_left
        self._rotation, self._position = np.eye(3), np.zeros(3)
        self._last_motion: tuple[FloatArray, FloatArray] = (np.eye(3), np.zeros(3))
        self._last_pair: StereoPair | None = None
        self._last_stamp_ns, self._last_step_ns = 0, 0
        self._lost_now = False
        self._last_covariance: FloatArray
        self._landmarks: Landmarks
        self._last_left: GreyImage
        self._last_seen: FloatArray
        self._well_seen: WellSeen
        self._seen_by_keyframe: int
        self._start: Start
        self._way_per_px, self._way_set_right = np.zeros(3), np.zeros(3)
        self._good_while_lost = self._repeats = 0
        self._keyframe_count = 0
        self._right_offset = RightOffset(self._camera, self._config.window_keyframes)
        self._last_tracked: Tracked | None = None

    @property
    def last_tracked(self) -> Tracked | None:
        """What was found of the landmarks in the last pair, trusted or not; None where none was looked for."""
        return self._last_tracked

    def set_pose(self, T_ds_rb: Transform) -> None:
        """Let the next estimate start at this pose."""
        self._end_keyframe()
        current = Transform(self._rotation, self._position)
        self._T_ds_world = T_ds_rb @ self._T_rb_left @ current.inverse()

    @staticmethod
    def warm_up() -> None:
        """Load or compile all machine code, so that no call pays for it; it is the same for all rigs."""
        width, height = 320, 240
        rig = StereoRig(width, height, 300.0, 300.0, 160.0, 120.0, 0.1, Transform.identity())
        random = np.random.default_rng(0)
        texture = random.integers(0, 255, (height, width + 200), np.uint8)
        config = LocalisationConfig(window_keyframes=2, max_features=100, min_tracked=8)
        other = Localiser(rig, config, Transform.identity())
        # small steps are tracked until a keyframe leaves the window, a leap is found again by flow, black is lost
        for stamp_ns, shift in enumerate((0, 4, 30, 60, 90, 150)):
            left, right = (np.ascontiguousarray(texture[:, s : s + width]) for s in (shift, shift + 10))
            other.process(StereoPair(stamp_ns, left, right))
        other.process(StereoPair(6, np.zeros_like(left), np.zeros_like(left)))
        other._end_keyframe()

    def process(self, pair: StereoPair, motion: Transform | None = None) -> PoseEstimate:
        """Return the pose at one pair; pairs come in the order of their stamps.

        Args:
            pair: Pictures of the rig's size.
            motion: What another source (wheel odometry, for example) says of the motion since the last pair:
                `T_before_now` of RB. It is only a place to start looking from; where the pictures fit another start
                better, as with a wrong one, it has no effect.

        Raises:
            LocalisationError: If the pair does not have the rig's size.
        """
        if pair.left.shape != (self._rig.height, self._rig.width):
            found = f"{pair.left.shape[1]} x {pair.left.shape[0]}"
            wanted = f"{self._rig.width} x {self._rig.height}"
            raise LocalisationError(f"pair {pair.stamp_ns} is {found}, the rig is {wanted}: give pictures of the rig")
        self._stages = Stages()
        with self._stages("wait"):
            self._end_keyframe()
        before, self._last_pair = self._last_pair, pair
        if before is not None and len(self._window) and _same_pictures(before, pair) and not self._lost_now:
            return self._repeated(pair)
        self._last_tracked = None
        with self._stages("pyramid"):
            left, right = both(build_pyramid, (pair.left,), (pair.right,))
        if not len(self._window):
            return self._begin(pair, left, right, np.zeros((6, 6)))
        tracked = self._track(pair, left, right, motion)
        if tracked is None or self._exchanged(left, right, tracked):
            return self._lost(pair, left, right)
        return self._tracking(pair, left, right, tracked)

    def _tracking(self, pair: StereoPair, left: Pyramid, right: Pyramid, tracked: Tracked) -> PoseEstimate:
        """Take the pose that was found; begin a keyframe where one is wanted."""
        self._lost_now, self._good_while_lost, self._repeats = False, 0, 0
        motion = Transform(self._rotation, self._position).inverse() @ Transform(tracked.rotation, tracked.position)
        self._last_motion = (motion.rotation, motion.translation)
        self._last_stamp_ns, self._last_step_ns = pair.stamp_ns, pair.stamp_ns - self._last_stamp_ns
        step_per_px = (tracked.position - self._position) * self._depth() / (self._rig.fx * self._rig.baseline_m)
        self._way_per_px += step_per_px
        self._way_set_right += step_per_px * self._right_offset.u
        self._rotation, self._position = tracked.rotation, tracked.position
        self._last_covariance = np.asarray(np.linalg.inv(tracked.information) + self._window.last_covariance)
        # by the right picture alone a pose is found, but nothing that later pairs could go on from
        by_left = tracked.left_count >= self._config.min_tracked
        if by_left:
            self._last_left, self._last_seen = pair.left, tracked.observed[:, :2]
            if tracked.left_count >= 0.5 * len(tracked.landmarks):
                self._well_seen = WellSeen(pair.left, self._last_seen, self._landmarks.points)
        wanted = by_left and self._wants_keyframe(tracked)
        self._keyframe_count += wanted
        statistics = {
            "features": float(len(tracked.landmarks)),
            "inliers": float(tracked.inliers.sum()),
            "keyframes": float(self._keyframe_count),
            "chi_median": float(np.nanmedian(tracked.chi)),
            "residual_px": tracked.residual_px,
            "vertical_offset_px": self._right_offset.v,
            "disparity_offset_px": -self._right_offset.u,
            "roll_offset_px": self._right_offset.roll,
        }
        estimate = self._estimate(pair.stamp_ns, TrackingState.TRACKING, self._last_covariance, statistics)
        if wanted:  # from here on all belongs to the other thread, until the next call
            self._keyframe = in_background(self._add_keyframe, left, right, tracked)
        return estimate

    def _repeated(self, pair: StereoPair) -> PoseEstimate:
        """Return the last pose again; the rover may stand still, or have gone on as before unseen."""
        self._repeats += 1
        rotation, step = self._last_motion
        unseen = self._repeats * np.repeat([np.linalg.norm(step), np.linalg.norm(rotvec_from_matrix(rotation))], 3)
        covariance = self._last_covariance + np.diag(unseen**2) / self._config.inflation
        return self._estimate(pair.stamp_ns, TrackingState.TRACKING, covariance, {"repeated": 1.0})

    def _exchanged(self, left: Pyramid, right: Pyramid, tracked: Tracked) -> bool:
        """Tell whether left and right are the wrong way round: they fit well when exchanged, and do not as they are."""
        if tracked.right_share > 0.3 or float(np.std(right.levels[-1])) < 1.0:
            return False
        position = tracked.position - tracked.rotation[:, 0] * self._rig.baseline_m
        other = self._tracker.refine(right, left, tracked.landmarks, (tracked.rotation, position), self._right_offset)
        return self._tracker.trusted(other) and other.right_share > 0.6

    def _begin(self, pair: StereoPair, left: Pyramid, right: Pyramid, covariance: FloatArray) -> PoseEstimate:
        """Begin a window at the pose known last, as well known as its covariance `(6, 6)` says.

        The window itself takes its first pose as known: a window that may move as a whole would do so with every
        adjustment, as it is linearised anew.
        """
        window = Window(self._camera, self._rig.baseline_m, self._config.window_keyframes)
        window.add_keyframe(self._rotation, self._position, np.zeros(0, np.intp), np.zeros((0, 4)), np.zeros((0, 2, 3)))
        before, self._window = self._window, window
        self._add_landmarks(left, right, np.zeros((0, 3)))
        if len(self._landmarks) < self._config.min_tracked:
            features = float(len(self._landmarks))
            self._window = before
            if len(before):
                self._refresh()
            return self._estimate(pair.stamp_ns, TrackingState.LOST, lost_covariance(), {"features": features})
        self._last_left, self._last_motion = pair.left, (np.eye(3), np.zeros(3))
        self._last_stamp_ns, self._last_step_ns = pair.stamp_ns, 0
        self._good_while_lost, self._lost_now = 0, False
        self._last_covariance = window.last_covariance
        common = common_covariance(self._depth(), self._config.common_px, self._rig.fx)
        self._start = Start(self._position, covariance + common)
        self._well_seen = WellSeen(pair.left, self._last_seen, self._landmarks.points)
        self._keyframe_count += 1
        state = TrackingState.INITIALISING if self._keyframe_count == 1 else TrackingState.TRACKING
        features = float(len(self._landmarks))
        return self._estimate(pair.stamp_ns, state, window.last_covariance, {"features": features})

    def _lost(self, pair: StereoPair, left: Pyramid, right: Pyramid) -> PoseEstimate:
        """Say that the pose is not known; begin anew where good pictures come and none is recognised."""
        self._last_motion, self._lost_now = (np.eye(3), np.zeros(3)), True
        corners = find_corners(left.levels[0], np.zeros((0, 2)), self._config.max_features, BORDER)
        enough = max(self._config.min_tracked, len(self._landmarks) // 2)
        self._good_while_lost += len(corners) >= enough and float(np.std(right.levels[-1])) > 1.0
        if self._good_while_lost > PATIENCE:
            known = self._window.last_covariance + self._start.carried_to(self._position)
            return self._begin(pair, left, right, known + np.diag(np.square(UNSEEN_SIGMA)))
        return self._estimate(pair.stamp_ns, TrackingState.LOST, lost_covariance(), {"inliers": 0.0})

    def _track(self, pair: StereoPair, left: Pyramid, right: Pyramid, motion: Transform | None) -> Tracked | None:
        marks = self._landmarks
        if len(marks) < self._config.min_tracked:
            return None
        with self._stages("align"):
            start = self._tracker.align(left, marks, self._predictions(pair.stamp_ns, motion))
        with self._stages("refine"):
            tracked = self._tracker.refine(left, right, marks, start, self._right_offset)
        self._last_tracked = tracked
        if self._tracker.trusted(tracked):
            return tracked
        with self._stages("relocate"):
            return self._relocate(pair, left, right)

    def _relocate(self, pair: StereoPair, left: Pyramid, right: Pyramid) -> Tracked | None:
        """Look for the landmarks where prediction has failed."""
        marks, fewest = self._landmarks, self._config.min_tracked
        known = (self._last_left, pair.left, self._last_seen, marks.points)
        start = pose_by_flow(*known, self._camera, fewest)
        if (found := self._found_from(start, left, right)) is not None:
            return found
        corners = find_corners(left.levels[0], np.zeros((0, 2)), 2 * self._config.max_features, BORDER)
        start = pose_by_descriptors(self._well_seen, pair.left, corners, self._camera, fewest)
        return self._found_from(start, left, right)

    def _found_from(self, start: Pose | None, left: Pyramid, right: Pyramid) -> Tracked | None:
        if start is None:
            return None
        tracked = self._tracker.refine_from_afar(left, right, self._landmarks, start, self._right_offset)
        self._last_tracked = tracked
        return tracked if self._tracker.trusted(tracked) else None

    def _predictions(self, stamp_ns: int, motion: Transform | None) -> list[Pose]:
        """Return where the camera may be: moved on as before, standing still, moved as another source says."""
        moved, step = self._last_motion
        starts = [
            (self._rotation @ moved, self._position + self._rotation @ step),
            (self._rotation, self._position),
        ]
        missed = round((stamp_ns - self._last_stamp_ns) / self._last_step_ns) - 1 if self._last_step_ns > 0 else 0
        if 0 < missed <= MOST_MISSED:  # pairs that did not come, or the same one again
            further = starts[0]
            for _ in range(missed):
                further = (further[0] @ moved, further[1] + further[0] @ step)
            starts.append(further)
        if motion is not None:
            said = Transform(self._rotation, self._position) @ self._T_rb_left.inverse() @ motion @ self._T_rb_left
            starts.append((said.rotation, said.translation))
        return starts

    def _wants_keyframe(self, tracked: Tracked) -> bool:
        before = tracked.landmarks.last_seen[:, :2]
        flow = np.linalg.norm(tracked.observed[:, :2] - before, axis=1)[tracked.inliers]
        flow = flow[np.isfinite(flow)]
        if len(flow) < self._config.keyframe_share * self._seen_by_keyframe:
            return True
        return float(np.median(flow)) > self._config.keyframe_flow * self._rig.width

    def _end_keyframe(self) -> None:
        """Wait for the keyframe in work, and go on from its adjusted pose."""
        pending, self._keyframe = self._keyframe, None
        if pending is None:
            return
        self._stages.seconds["keyframe"] = pending.result()
        self._rotation, self._position = self._window.rotations[-1], self._window.positions[-1]
        self._last_covariance = self._window.last_covariance
        if self._well_seen.left is self._last_left:
            self._well_seen = WellSeen(self._last_left, self._last_seen, self._landmarks.points)

    def _add_keyframe(self, left: Pyramid, right: Pyramid, tracked: Tracked) -> float:
        """Make a tracked pair a keyframe; return the seconds that it took."""
        start = time.perf_counter()
        window = self._window
        good = tracked.inliers
        window.alive[tracked.landmarks.index[~good]] = False
        window.add_keyframe(
            tracked.rotation,
            tracked.position,
            tracked.landmarks.index[good],
            tracked.observed[good],
            tracked.variance[good],
        )
        window.move_right_pictures(-self._right_offset.learn_columns(*window.right_offset))
        known = window.observed[window.alive, -1]
        known = np.column_stack((known[:, :2], known[:, 0] - known[:, 2]))
        self._add_landmarks(left, right, known[np.isfinite(known).all(axis=1)])
        return time.perf_counter() - start

    def _add_landmarks(self, left: Pyramid, right: Pyramid, known: FloatArray) -> None:
        corners = find_corners(left.levels[0], known[:, :2].copy(), self._config.max_features, BORDER, self._masks[0])
        if len(corners):
            found = match_corners(left, right, corners, known, self._max_disparity, self._right_offset.v)
            found = found.outside(self._masks[1])
            self._right_offset.learn_rows(found.right, found.right[:, 1] - found.uv[:, 1])
            right_seen = found.right - self._right_offset.at(found.right)
            scale = 1.0 / (self._rig.fx * self._rig.baseline_m)
            variance = self._tracker.variance(np.column_stack((found.covariance, found.residual)))
            observed = np.column_stack((found.uv, right_seen))
            self._window.add_landmarks(
                left,
                found.uv,
                np.maximum(found.uv[:, 0] - right_seen[:, 0], 1e-3) * scale,
                found.slope * scale,
                found.patches,
                observed,
                np.stack((variance, variance), axis=1),
            )
        self._window.adjust(self._config.adjustment_rounds)
        self._refresh()

    def _refresh(self) -> None:
        """Take the landmarks that are looked for from the window."""
        self._landmarks = self._window.landmarks()
        self._last_seen = self._landmarks.last_seen[:, :2]
        self._seen_by_keyframe = int(np.isfinite(self._last_seen[:, 0]).sum())

    def _depth(self) -> float:
        """Return the usual depth of the landmarks, metres; 0 where there are none."""
        rho = self._landmarks.rho
        return 1.0 / max(float(np.median(rho)), 1e-3) if len(rho) else 0.0

    def _estimate(
        self, stamp_ns: int, state: TrackingState, covariance: FloatArray, statistics: dict[str, float]
    ) -> PoseEstimate:
        T_ds_left = self._T_ds_world @ Transform(self._rotation, self._position)
        T_ds_rb = T_ds_left @ self._T_rb_left.inverse()
        if state is not TrackingState.LOST:
            covariance = covariance * self._config.inflation + self._start.carried_to(self._position)
            covariance = covariance + common_covariance(self._depth(), self._config.common_px, self._rig.fx)
            covariance[:3, :3] += self._way_covariance()
            lever = T_ds_rb.translation - T_ds_left.translation
            covariance = covariance_of_rb(covariance, self._T_ds_world.rotation, lever)
        return PoseEstimate(stamp_ns, T_ds_rb, covariance, state, statistics, self._stages.seconds)

    def _way_covariance(self) -> FloatArray:
        """Return the covariance `(3, 3)` of the way from what all disparities are off by together.

        That is what can never be known of them, what is not known yet of the right camera's yaw, and the way that was
        driven before the yaw was found.
        """
        known = self._right_offset.found_u * self._way_per_px - self._way_set_right
        variance = self._config.common_disparity_px**2 + self._right_offset.sigma_u**2
        return np.asarray(variance * np.outer(self._way_per_px, self._way_per_px) + np.outer(known, known))


def _same_pictures(before: StereoPair, now: StereoPair) -> bool:
    return np.array_equal(before.left, now.left) and np.array_equal(before.right, now.right)
