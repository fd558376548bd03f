"""The localiser: one call per stereo pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.rotation import FloatArray, rotvec_from_matrix, skew
from sfr_loc_map.geometry.stereo import GreyImage, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.alignment import align_pose
from sfr_loc_map.localisation.calibration import RightOffset
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.corners import find_corners, load_mask
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.localisation.images import LEVELS, Pyramid, build_pyramid
from sfr_loc_map.localisation.parallel import both
from sfr_loc_map.localisation.patches import HALF, plane_homographies, track_patches
from sfr_loc_map.localisation.pose_solver import solve_pose
from sfr_loc_map.localisation.relocation import WellSeen, pose_by_descriptors, pose_by_flow
from sfr_loc_map.localisation.sparse_stereo import match_corners
from sfr_loc_map.localisation.window import Landmarks, Window

BORDER = HALF + 4
"""Pixels along the edges where no corner is taken: a patch with its gradients must fit."""
PATIENCE = 2
"""Good pictures that are tried against the old window before a new one is begun."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A pair tracked against the window.

    Attributes:
        rotation: `(3, 3)` left camera to world.
        position: `(3,)` metres.
        information: `(6, 6)` of the pose given the window.
        landmarks: The M landmarks looked for.
        observed: `(M, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(M, 2, 3)` uu, uv, vv, px^2.
        chi: `(M,)` squared Mahalanobis residual a degree of freedom; NaN where not seen.
    """

    rotation: FloatArray
    position: FloatArray
    information: FloatArray
    landmarks: Landmarks
    observed: FloatArray
    variance: FloatArray
    chi: FloatArray

    @property
    def residual_px(self) -> float:
        """Typical residual of the agreeing landmarks, pixels: root of the median of chi times the variance."""
        variance = self.variance[:, :, (0, 2)].mean(axis=(1, 2))
        typical = np.sqrt(self.chi * variance)[self.inliers]
        return float(np.median(typical)) if len(typical) else float("nan")

    @property
    def right_share(self) -> float:
        """Share of the landmarks found in the left picture that were found in the right one."""
        left = np.isfinite(self.observed[:, 0])
        return float(np.isfinite(self.observed[left, 2]).mean()) if left.any() else 0.0

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Landmarks `(M,)` that agree with the pose."""
        return np.nan_to_num(self.chi, nan=1e9) < 9.0


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair."""

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
        self._max_disparity = min(rig.fx * rig.baseline_m / config.min_depth_m, 0.5 * rig.width)
        self.reset(T_ds_rb)

    def reset(self, T_ds_rb: Transform) -> None:
        """Forget everything and start anew at this pose."""
        self._window = Window(self._camera, self._rig.baseline_m, self._config.window_keyframes)
        self._T_ds_world = T_ds_rb @ self._T_rb_left
        self._rotation, self._position = np.eye(3), np.zeros(3)
        self._last_motion: tuple[FloatArray, FloatArray] = (np.eye(3), np.zeros(3))
        self._last_pair: StereoPair | None = None
        self._lost_now = False
        self._last_covariance: FloatArray
        self._landmarks: Landmarks
        self._last_left: GreyImage
        self._last_seen: FloatArray
        self._well_seen: WellSeen
        self._seen_by_keyframe: int
        self._start_covariance, self._start_position = np.zeros((6, 6)), np.zeros(3)
        self._good_while_lost = 0
        self._keyframe_count = 0
        self._right_offset = RightOffset(self._camera, self._config.window_keyframes)
        self._last_tracked: Tracked | None = None

    @property
    def last_tracked(self) -> Tracked | None:
        """What was found of the landmarks in the last pair, trusted or not; None where none was looked for."""
        return self._last_tracked

    def set_pose(self, T_ds_rb: Transform) -> None:
        """Let the next estimate start at this pose."""
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
        before, self._last_pair = self._last_pair, pair
        if before is not None and len(self._window) and _same_pictures(before, pair) and not self._lost_now:
            return self._repeated(pair)
        self._last_tracked = None
        left, right = both(build_pyramid, (pair.left,), (pair.right,))
        if not len(self._window):
            return self._start(pair, left, right, np.zeros((6, 6)))
        tracked = self._track(pair, left, right, motion)
        if tracked is None or self._exchanged(left, right, tracked):
            return self._lost(pair, left, right)
        self._lost_now = False
        motion = Transform(self._rotation, self._position).inverse() @ Transform(tracked.rotation, tracked.position)
        self._last_motion = (motion.rotation, motion.translation)
        self._rotation, self._position = tracked.rotation, tracked.position
        self._last_covariance = np.asarray(np.linalg.inv(tracked.information) + self._window.last_covariance)
        self._last_left, self._last_seen = pair.left, tracked.observed[:, :2]
        self._good_while_lost = 0
        if self._wants_keyframe(tracked):
            self._add_keyframe(left, right, tracked)
            self._rotation, self._position = self._window.rotations[-1], self._window.positions[-1]
            self._last_covariance = self._window.last_covariance
        if tracked.inliers.sum() >= 0.5 * len(tracked.landmarks):
            self._well_seen = WellSeen(pair.left, self._last_seen, self._landmarks.points)
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
        return self._estimate(pair.stamp_ns, TrackingState.TRACKING, self._last_covariance, statistics)

    def _repeated(self, pair: StereoPair) -> PoseEstimate:
        """Return the last pose again; the rover may stand still, or have gone on as before unseen."""
        rotation, step = self._last_motion
        unseen = np.repeat([np.linalg.norm(step), np.linalg.norm(rotvec_from_matrix(rotation))], 3)
        covariance = self._last_covariance + np.diag(unseen**2) / self._config.inflation
        return self._estimate(pair.stamp_ns, TrackingState.TRACKING, covariance, {"repeated": 1.0})

    def _exchanged(self, left: Pyramid, right: Pyramid, tracked: Tracked) -> bool:
        """Tell whether left and right are the wrong way round: they fit well when exchanged, and do not as they are."""
        if tracked.right_share > 0.3 or float(np.std(right.levels[-1])) < 1.0:
            return False
        position = tracked.position - tracked.rotation[:, 0] * self._rig.baseline_m
        other = self._refine(right, left, tracked.landmarks, tracked.rotation, position)
        return self._trusted(other) and other.right_share > 0.6

    def _start(self, pair: StereoPair, left: Pyramid, right: Pyramid, covariance: FloatArray) -> PoseEstimate:
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
        self._good_while_lost, self._lost_now = 0, False
        self._last_covariance = window.last_covariance
        self._start_covariance, self._start_position = covariance, self._position
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
            # what was driven meanwhile is not known: as far as the rover may have come, in any direction
            spread = np.array([1.0, 1.0, 0.3, 0.1, 0.1, 0.5])
            known = self._with_start(self._window.last_covariance)
            return self._start(pair, left, right, known + np.diag(spread**2))
        return self._estimate(pair.stamp_ns, TrackingState.LOST, lost_covariance(), {"inliers": 0.0})

    def _track(self, pair: StereoPair, left: Pyramid, right: Pyramid, motion: Transform | None) -> Tracked | None:
        marks = self._landmarks
        if len(marks) < self._config.min_tracked:
            return None
        tracked = self._refine(left, right, marks, *self._align(left, marks, motion))
        if self._trusted(tracked):
            return tracked
        known = (self._last_left, pair.left, self._last_seen, marks.points)
        start = pose_by_flow(*known, self._camera, self._config.min_tracked)
        if start is not None and self._trusted(again := self._from_afar(left, right, start)):
            return again
        corners = find_corners(left.levels[0], np.zeros((0, 2)), 2 * self._config.max_features, BORDER)
        start = pose_by_descriptors(self._well_seen, pair.left, corners, self._camera, self._config.min_tracked)
        if start is not None and self._trusted(again := self._from_afar(left, right, start)):
            return again
        return None

    def _from_afar(self, left: Pyramid, right: Pyramid, start: tuple[FloatArray, FloatArray]) -> Tracked:
        """Track from a start that is right to some pixels."""
        marks = self._landmarks
        return self._refine(left, right, marks, *self._align_level(left, 0, marks, *start, 6)[:2])

    def _trusted(self, tracked: Tracked) -> bool:
        """Tell whether enough landmarks agree on the pose, of all and of those that were found."""
        agree, found = int(tracked.inliers.sum()), int(np.isfinite(tracked.chi).sum())
        return agree >= self._config.min_tracked and agree > 0.5 * found and found > 0.2 * len(tracked.landmarks)

    def _refine(
        self, left: Pyramid, right: Pyramid, marks: Landmarks, rotation: FloatArray, position: FloatArray
    ) -> Tracked:
        baseline = self._rig.baseline_m
        places = (rotation, position, marks.host_rotations, marks.host_positions, marks.uv, marks.rho, marks.slopes)
        found = both(
            track_patches,
            *(
                (image.levels[0], marks.patches[0], marks.uv, plane_homographies(*places, self._camera, shift), 2.5, 6)
                for image, shift in ((left, 0.0), (right, baseline))
            ),
        )
        for side in found:
            side[side[:, 6] < 0.6] = np.nan
        observed = np.column_stack((found[0][:, :2], found[1][:, :2] - self._right_offset.at(found[1][:, :2])))
        variance = np.stack((self._variance(found[0]), self._variance(found[1])), axis=1)
        rotation, position, information, chi = solve_pose(
            rotation,
            position,
            marks.host_rotations,
            marks.host_positions,
            marks.rays,
            marks.rho,
            marks.covariance,
            observed,
            variance,
            self._camera,
            baseline,
            10,
        )
        self._last_tracked = Tracked(rotation, position, information, marks, observed, variance, chi)
        return self._last_tracked

    def _variance(self, found: FloatArray) -> FloatArray:
        """Return the variances `(N, 3)` of tracked positions, half of it the patch's and half the picture's."""
        residual = found[:, 5:6]
        typical = np.nanmedian(residual) if np.isfinite(residual).any() else 1.0
        variance = found[:, 2:5] * (1.2 * np.maximum(residual, typical) ** 2)
        variance[:, 0] += self._config.pixel_floor**2
        variance[:, 2] += self._config.pixel_floor**2
        return variance

    def _align(self, left: Pyramid, marks: Landmarks, motion: Transform | None) -> tuple[FloatArray, FloatArray]:
        moved, step = self._last_motion
        top = LEVELS - 1
        starts = [
            (self._rotation @ moved, self._position + self._rotation @ step),
            (self._rotation, self._position),
        ]
        if motion is not None:
            said = Transform(self._rotation, self._position) @ self._T_rb_left.inverse() @ motion @ self._T_rb_left
            starts.append((said.rotation, said.translation))
        results = [self._align_level(left, top, marks, *start, 6) for start in starts]
        best = max(results, key=lambda result: result[2])
        for level in range(top - 1, 0, -1):
            best = self._align_level(left, level, marks, best[0], best[1], 4)
        return best[0], best[1]

    def _align_level(
        self, left: Pyramid, level: int, marks: Landmarks, rotation: FloatArray, position: FloatArray, rounds: int
    ) -> tuple[FloatArray, FloatArray, float, float]:
        places = (rotation, position, marks.host_rotations, marks.host_positions, marks.uv, marks.rho)
        homographies = plane_homographies(*places, marks.slopes, self._camera, 0.0)
        return align_pose(left.levels[level], level, marks.patches[level], homographies, *places, self._camera, rounds)

    def _wants_keyframe(self, tracked: Tracked) -> bool:
        before = tracked.landmarks.last_seen[:, :2]
        flow = np.linalg.norm(tracked.observed[:, :2] - before, axis=1)[tracked.inliers]
        flow = flow[np.isfinite(flow)]
        if len(flow) < self._config.keyframe_share * self._seen_by_keyframe:
            return True
        return float(np.median(flow)) > self._config.keyframe_flow * self._rig.width

    def _add_keyframe(self, left: Pyramid, right: Pyramid, tracked: Tracked) -> None:
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
        self._keyframe_count += 1

    def _add_landmarks(self, left: Pyramid, right: Pyramid, known: FloatArray) -> None:
        corners = find_corners(left.levels[0], known[:, :2].copy(), self._config.max_features, BORDER, self._masks[0])
        if len(corners):
            found = match_corners(left, right, corners, known, self._max_disparity, self._right_offset.v)
            found = found.outside(self._masks[1])
            self._right_offset.learn_rows(found.right, found.right[:, 1] - found.uv[:, 1])
            right_seen = found.right - self._right_offset.at(found.right)
            scale = 1.0 / (self._rig.fx * self._rig.baseline_m)
            variance = self._variance(np.column_stack((found.right, found.covariance, found.residual)))
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

    def _estimate(
        self, stamp_ns: int, state: TrackingState, covariance: FloatArray, statistics: dict[str, float]
    ) -> PoseEstimate:
        T_ds_left = self._T_ds_world @ Transform(self._rotation, self._position)
        T_ds_rb = T_ds_left @ self._T_rb_left.inverse()
        if state is not TrackingState.LOST:
            covariance = self._with_start(covariance * self._config.inflation) + np.diag(self._common_variance())
            covariance = self._covariance_of_rb(covariance, T_ds_rb.translation - T_ds_left.translation)
        return PoseEstimate(stamp_ns, T_ds_rb, covariance, state, statistics)

    def _with_start(self, covariance: FloatArray) -> FloatArray:
        """Add how well the first pose of the window is known, `(6, 6)`, left camera in the world."""
        jacobian = np.eye(6)
        jacobian[:3, 3:] = -skew(self._position - self._start_position)
        return np.asarray(covariance + jacobian @ self._start_covariance @ jacobian.T)

    def _common_variance(self) -> FloatArray:
        """Return the variances `(6,)` of what a whole picture is off by (blur, jitter): no landmark shows it."""
        depth = 1.0 / max(float(np.median(self._landmarks.rho)), 1e-3) if len(self._landmarks) else 0.0
        angle = self._config.common_px / self._rig.fx
        return np.repeat(np.square([angle * depth, angle]), 3)

    def _covariance_of_rb(self, covariance: FloatArray, lever: FloatArray) -> FloatArray:
        """Turn the covariance of the left camera in the world into that of RB in DS (lever `(3,)` metres in DS)."""
        turn = self._T_ds_world.rotation
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = jacobian[3:, 3:] = turn
        jacobian[:3, 3:] = -skew(lever) @ turn
        result = jacobian @ covariance @ jacobian.T
        return np.asarray(0.5 * (result + result.T))


def _same_pictures(before: StereoPair, now: StereoPair) -> bool:
    return np.array_equal(before.left, now.left) and np.array_equal(before.right, now.right)
