"""Tracking of the active landmarks in a new pair, and the pose that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, Mask, finite_median, median
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.homography import plane_homographies
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, Pyramid, build_pyramid
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.patch_tracking import TrackingLimits, noise_variance, track_patches
from sfr_loc_map.localisation.frontend.photometric_alignment import Alignment, align_pose
from sfr_loc_map.localisation.frontend.pose_solver import StereoObservations, solve_pose
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.right_shift import RightShift, right_shift
from sfr_loc_map.localisation.parallel import both

MIN_NCC = 0.6
"""Minimum normalised cross-correlation of a tracked patch."""
MAX_SHIFT_PX = 2.5
"""Maximum distance of a landmark from its projection, pixels."""
EXPECTED_OFFSET_PX = 0.5
"""Offset of right positions beyond which landmarks are sought there: less is within the reach of tracking."""
SHIFT_ITERATIONS = 6
POSE_ITERATIONS = 10
INLIER_CHI2_PER_DOF = 9.0
"""Squared Mahalanobis residual per degree of freedom below which a landmark agrees with a pose."""
EDGES_FROM_PX = 600.0
"""Focal length from which on edges of stones, not noise, limit a pose: seen from elsewhere they are other points of the
stone, and the sun makes those of one side the stronger ones, so that the path turns. Their residuals are large."""
MIN_TEXTURE = 1.0
"""Standard deviation, grey levels, of the coarsest pyramid level below which an image shows nothing."""


class StereoFrame(NamedTuple):
    """A pair, ready for tracking.

    Attributes:
        stamp_ns: Stamp of the pair.
        image: `(H, W)` uint8, left.
        left: Left pyramid.
        right: Right pyramid.
    """

    stamp_ns: int
    image: GreyImage
    left: Pyramid
    right: Pyramid

    @classmethod
    def of(cls, pair: StereoPair) -> StereoFrame:
        """Build both pyramids, each in a thread of its own."""
        return cls(pair.stamp_ns, pair.left, *both(build_pyramid, (pair.left,), (pair.right,)))

    @property
    def left_is_textured(self) -> bool:
        """Whether the left image shows anything: it is not black, white or blinded."""
        return float(np.std(self.left.levels[-1])) > MIN_TEXTURE

    @property
    def right_is_textured(self) -> bool:
        """Whether the right image shows anything."""
        return float(np.std(self.right.levels[-1])) > MIN_TEXTURE


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """Observations of the active landmarks in a pair, and its pose.

    Attributes:
        pose: Left camera in the world.
        information: `(6, 6)` of the pose given the landmarks.
        landmarks: The M active landmarks.
        observations: `(M, 4)` u, v left, u, v right, pixels; NaN where not found.
        variance: `(M, 2, 3)` uu, uv, vv of the left and right positions, px^2.
        chi2_per_dof: `(M,)` squared Mahalanobis residual per degree of freedom; NaN where not found.
    """

    pose: Pose
    information: FloatArray
    landmarks: Landmarks
    observations: FloatArray
    variance: FloatArray
    chi2_per_dof: FloatArray

    @cached_property
    def T_world_left(self) -> Transform:
        """Pose of the left camera in the world."""
        return Transform(*self.pose)

    @cached_property
    def inliers(self) -> Mask:
        """Landmarks `(M,)` that agree with the pose; NaN does not."""
        return np.asarray(self.chi2_per_dof < INLIER_CHI2_PER_DOF)

    @cached_property
    def found_count(self) -> int:
        """Number of landmarks that were found."""
        return int(np.count_nonzero(np.isfinite(self.chi2_per_dof)))

    @cached_property
    def inlier_count(self) -> int:
        """Number of inliers."""
        return int(np.count_nonzero(self.inliers))

    @property
    def left_inlier_count(self) -> int:
        """Number of inliers observed in the left image."""
        return int(np.count_nonzero(self.inliers & np.isfinite(self.observations[:, 0])))

    @property
    def agreeing_share(self) -> float:
        """Share of the active landmarks that agree with the pose."""
        return self.inlier_count / max(len(self.landmarks), 1)

    @property
    def right_share(self) -> float:
        """Share of the landmarks observed in the left image that are also observed in the right one."""
        left, right = np.isfinite(self.observations[:, 0]), np.isfinite(self.observations[:, 2])
        return float((left & right).sum()) / max(float(left.sum()), 1.0)

    @property
    def flow_px(self) -> FloatArray:
        """Optical flow `(N,)` of the inliers in the left image since the newest keyframe, pixels."""
        moved = self.observations[:, :2] - self.landmarks.last_seen[:, :2]
        length = np.linalg.norm(moved, axis=1)[self.inliers]
        return np.asarray(length[np.isfinite(length)])

    @cached_property
    def chi_median(self) -> float:
        """Median over the landmarks of the squared Mahalanobis residual per degree of freedom; NaN without any."""
        return finite_median(self.chi2_per_dof)

    @property
    def residual_px(self) -> float:
        """Typical residual of the inliers, pixels: median of the root of chi2 per dof times the mean variance."""
        found = np.isfinite(self.observations[:, ::2])
        total = np.where(found, 0.5 * (self.variance[:, :, 0] + self.variance[:, :, 2]), 0.0).sum(axis=1)
        variance = total / np.maximum(found.sum(axis=1), 1)
        typical = np.sqrt(self.chi2_per_dof * variance)[self.inliers]
        return median(typical)


class Tracker:
    """Tracks landmarks in pairs: first all together on coarse pyramid levels, then each one in both images."""

    def __init__(self, config: LocalisationConfig, camera: StereoCamera) -> None:
        """Track for the camera of a rig."""
        self._config, self._camera = config, camera

    def align(self, left: Pyramid, landmarks: Landmarks, guesses: Sequence[Transform]) -> Pose:
        """Return the pose to some tenths of a pixel, from the best of some initial guesses."""
        top, landmarks = LEVELS - 1, landmarks.few
        results = [self._align_level(left, top, landmarks, Pose.of(guess), 6) for guess in guesses]
        pose = max(results, key=lambda result: result.correlation).pose
        # the finest level adds nothing: `refine` starts from some tenths of a pixel
        for level in range(top - 1, 0, -1):
            pose = self._align_level(left, level, landmarks, pose, 4).pose
        return pose

    def refine(self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset) -> TrackingResult:
        """Return the landmarks found near their projections from a pose, and the pose that follows.

        Args:
            frame: The pair.
            landmarks: Active landmarks.
            start: Pose that is right to about two pixels.
            offset: Rotation error of the right camera.
        """
        return self._solve(start, landmarks, self._observe(frame, landmarks, start, offset))

    def refine_rest(
        self, frame: StereoFrame, landmarks: Landmarks, result: TrackingResult, offset: RightOffset
    ) -> TrackingResult:
        """Return the tracking of landmarks of which some have been tracked; the others are sought from the pose found.

        Args:
            frame: The pair.
            landmarks: Active landmarks.
            result: That of some of them, and perhaps of landmarks that are no longer active.
            offset: Rotation error of the right camera.
        """
        known, rows = landmarks.among(result.landmarks), np.flatnonzero(result.landmarks.among(landmarks))
        rest = landmarks.rest if result.landmarks is landmarks.followed else landmarks.subset(~known)
        others = self._observe(frame, rest, result.pose, offset)
        uv, variance = np.empty((len(landmarks), 4)), np.empty((len(landmarks), 2, 3))
        uv[known], uv[~known] = result.observations[rows], others.uv
        variance[known], variance[~known] = result.variance[rows], others.variance
        return self._solve(result.pose, landmarks, StereoObservations(uv, variance))

    def right_shift(self, result: TrackingResult) -> RightShift:
        """Return by how much the right image is shifted against the landmarks."""
        seen = StereoObservations(result.observations, result.variance)
        return right_shift(result.pose, result.landmarks.estimates, seen, self._camera)

    def with_right_moved(self, result: TrackingResult, offset: RightOffset) -> TrackingResult:
        """Return a result with right positions corrected by one more offset, and the pose that follows."""
        observations = result.observations.copy()
        observations[:, 2:] -= offset.at(observations[:, 2:], self._camera)
        return self._solve(result.pose, result.landmarks, StereoObservations(observations, result.variance))

    def refine_from_afar(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset
    ) -> TrackingResult:
        """Return the same from a pose that is right to some pixels."""
        pose = self._align_level(frame.left, 0, landmarks, start, 6).pose
        return self.refine(frame, landmarks, pose, offset)

    def trusts(self, result: TrackingResult) -> bool:
        """Tell whether enough landmarks agree on the pose, of all and of those that were found."""
        inliers, found = result.inlier_count, result.found_count
        return inliers >= self._config.min_tracked and inliers > 0.5 * found and found > 0.2 * len(result.landmarks)

    def left_right_swapped(self, frame: StereoFrame, result: TrackingResult, offset: RightOffset) -> bool:
        """Tell whether left and right image are swapped: they fit well when swapped back, and do not as they are."""
        if result.right_share > 0.3 or not frame.right_is_textured:
            return False
        rotation, position = result.pose
        start = Pose(rotation, position - rotation[:, 0] * self._camera.baseline_m)
        other = self.refine(frame._replace(left=frame.right, right=frame.left), result.landmarks, start, offset)
        return self.trusts(other) and other.right_share > 0.6

    def position_variance(self, covariance: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the variances `(N, 3)` uu, uv, vv of tracked positions, px^2: half the patch's, half the image's.

        Args:
            covariance: `(N, 3)` uu, uv, vv for a noise of one grey level, px^2.
            residual: `(N,)` RMS, grey levels.
        """
        variance, typical = noise_variance(covariance, residual)
        floor = self._config.pixel_floor**2 * self._doubt(residual, typical)
        variance[:, 0] += floor
        variance[:, 2] += floor
        return variance

    def _doubt(self, residual: FloatArray, typical: float) -> FloatArray | float:
        """Return factors `(N,)` of the floor by residual; 1 where pixels are too large to show edges of stones."""
        if self._camera.fx < EDGES_FROM_PX:
            return 1.0
        return np.asarray(np.clip(residual / max(typical, 1e-6), 0.5, 4.0) ** 4)

    def _observe(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset
    ) -> StereoObservations:
        """Track landmarks in both images, from their projections."""
        planes, templates = landmarks.planes, landmarks.patches.level(0)
        in_left, in_right = (plane_homographies(start, planes, self._camera, x) for x in (0.0, self._camera.baseline_m))
        if abs(offset.u) > EXPECTED_OFFSET_PX:
            in_right[:, 0] += offset.u * in_right[:, 2]
        limits = TrackingLimits(MAX_SHIFT_PX, SHIFT_ITERATIONS, MIN_NCC)
        left, right = both(
            track_patches,  # one kernel and nothing else: a thread that asks for the interpreter's lock is put to sleep
            (frame.left.levels[0], templates, planes.uv, in_left, limits),
            (frame.right.levels[0], templates, planes.uv, in_right, limits),
        )
        uv, variance = np.empty((len(landmarks), 4)), np.empty((len(landmarks), 2, 3))
        uv[:, :2], uv[:, 2:] = left.uv, right.uv - offset.at(right.uv, self._camera)
        for side, found in enumerate((left, right)):
            variance[:, side] = self.position_variance(found.covariance, found.residual)
        return StereoObservations(uv, variance)

    def _solve(self, start: Pose, landmarks: Landmarks, seen: StereoObservations) -> TrackingResult:
        """Return observations with the pose that they give."""
        found = solve_pose(start, landmarks.estimates, seen, self._camera, POSE_ITERATIONS)
        return TrackingResult(found.pose, found.information, landmarks, seen.uv, seen.variance, found.chi2_per_dof)

    def _align_level(self, left: Pyramid, level: int, landmarks: Landmarks, start: Pose, iterations: int) -> Alignment:
        """Align the pose with one pyramid level."""
        return align_pose(
            left.level(level), landmarks.patches.level(level), landmarks.planes, start, self._camera, iterations
        )
