"""Tracking of the active landmarks in a new pair, and the pose that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, Pyramid, build_pyramid
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.patch_tracking import plane_homographies, track_patches
from sfr_loc_map.localisation.frontend.photometric_alignment import align_pose
from sfr_loc_map.localisation.frontend.pose_solver import solve_pose
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.parallel import both

MIN_NCC = 0.6
"""Minimum normalised cross-correlation of a tracked patch."""
INLIER_CHI2_PER_DOF = 9.0
"""Squared Mahalanobis residual per degree of freedom below which a landmark agrees with a pose."""
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
    def right_is_textured(self) -> bool:
        """Whether the right image shows anything: it is not black, white or blinded."""
        return float(np.std(self.right.levels[-1])) > MIN_TEXTURE


class Pose(NamedTuple):
    """Pose of the left camera in the world, as kernels take it; not checked.

    Attributes:
        rotation: `(3, 3)` left camera to world.
        position: `(3,)` metres.
    """

    rotation: FloatArray
    position: FloatArray

    @classmethod
    def of(cls, T_world_left: Transform) -> Pose:
        """Return the pose of a transform."""
        return cls(T_world_left.rotation, T_world_left.translation)


@dataclass(frozen=True, slots=True, eq=False)
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

    @property
    def T_world_left(self) -> Transform:
        """Pose of the left camera in the world."""
        return Transform(*self.pose)

    @property
    def inliers(self) -> Mask:
        """Landmarks `(M,)` that agree with the pose."""
        return np.nan_to_num(self.chi2_per_dof, nan=1e9) < INLIER_CHI2_PER_DOF

    @property
    def left_inlier_count(self) -> int:
        """Number of inliers observed in the left image."""
        return int(np.count_nonzero(self.inliers & np.isfinite(self.observations[:, 0])))

    @property
    def right_share(self) -> float:
        """Share of the landmarks observed in the left image that are also observed in the right one."""
        left = np.isfinite(self.observations[:, 0])
        return float(np.isfinite(self.observations[left, 2]).mean()) if left.any() else 0.0

    @property
    def flow_px(self) -> FloatArray:
        """Optical flow `(N,)` of the inliers in the left image since the newest keyframe, pixels."""
        moved = self.observations[:, :2] - self.landmarks.last_seen[:, :2]
        length = np.linalg.norm(moved, axis=1)[self.inliers]
        return np.asarray(length[np.isfinite(length)])

    @property
    def residual_px(self) -> float:
        """Typical residual of the inliers, pixels: median of the root of chi2 per dof times the mean variance."""
        found = np.isfinite(self.observations[:, ::2])
        total = np.where(found, self.variance[:, :, (0, 2)].mean(axis=2), 0.0).sum(axis=1)
        variance = total / np.maximum(found.sum(axis=1), 1)
        typical = np.sqrt(self.chi2_per_dof * variance)[self.inliers]
        return float(np.median(typical)) if len(typical) else float("nan")


class Tracker:
    """Tracks landmarks in pairs: first all together on coarse pyramid levels, then each one in both images."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig, camera: FloatArray) -> None:
        """Track for a rig with the camera `(4,)` fx, fy, cx, cy."""
        self._baseline, self._config, self._camera = rig.baseline_m, config, camera

    def align(self, left: Pyramid, landmarks: Landmarks, guesses: Sequence[Transform]) -> Pose:
        """Return the pose to some tenths of a pixel, from the best of some initial guesses."""
        top = LEVELS - 1
        results = [self._align_level(left, top, landmarks, Pose.of(guess), 6) for guess in guesses]
        pose, _ = max(results, key=lambda result: result[1])
        # the finest level adds nothing: `refine` starts from some tenths of a pixel
        for level in range(top - 1, 0, -1):
            pose, _ = self._align_level(left, level, landmarks, pose, 4)
        return pose

    def refine(self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset) -> TrackingResult:
        """Return the landmarks found near their projections from a pose, and the pose that follows.

        Args:
            frame: The pair.
            landmarks: Active landmarks.
            start: Pose that is right to about two pixels.
            offset: Rotation error of the right camera.
        """
        places = (*start, landmarks.host_rotations, landmarks.host_positions, landmarks.uv, landmarks.inverse_depth)
        found = both(
            track_patches,
            *(
                (
                    image.levels[0],
                    landmarks.patches[0],
                    landmarks.uv,
                    plane_homographies(*places, landmarks.slopes, self._camera, shift),
                    2.5,
                    6,
                )
                for image, shift in ((frame.left, 0.0), (frame.right, self._baseline))
            ),
        )
        for side in found:
            side[side[:, 6] < MIN_NCC] = np.nan
        right_uv = found[1][:, :2]
        observations = np.column_stack((found[0][:, :2], right_uv - offset.at(right_uv, self._camera)))
        variance = np.stack([self.position_variance(side[:, 2:5], side[:, 5]) for side in found], axis=1)
        hosts = (landmarks.host_rotations, landmarks.host_positions, landmarks.rays, landmarks.inverse_depth)
        rotation, position, information, chi2_per_dof = solve_pose(
            *start, *hosts, landmarks.covariance, observations, variance, self._camera, self._baseline, 10
        )
        return TrackingResult(Pose(rotation, position), information, landmarks, observations, variance, chi2_per_dof)

    def refine_from_afar(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset
    ) -> TrackingResult:
        """Return the same from a pose that is right to some pixels."""
        pose, _ = self._align_level(frame.left, 0, landmarks, start, 6)
        return self.refine(frame, landmarks, pose, offset)

    def trusts(self, result: TrackingResult) -> bool:
        """Tell whether enough landmarks agree on the pose, of all and of those that were found."""
        inliers, found = int(result.inliers.sum()), int(np.isfinite(result.chi2_per_dof).sum())
        return inliers >= self._config.min_tracked and inliers > 0.5 * found and found > 0.2 * len(result.landmarks)

    def left_right_swapped(self, frame: StereoFrame, result: TrackingResult, offset: RightOffset) -> bool:
        """Tell whether left and right image are swapped: they fit well when swapped back, and do not as they are."""
        if result.right_share > 0.3 or not frame.right_is_textured:
            return False
        rotation, position = result.pose
        start = Pose(rotation, position - rotation[:, 0] * self._baseline)
        other = self.refine(frame._replace(left=frame.right, right=frame.left), result.landmarks, start, offset)
        return self.trusts(other) and other.right_share > 0.6

    def position_variance(self, covariance: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the variances `(N, 3)` uu, uv, vv of tracked positions, px^2: half the patch's, half the image's.

        Args:
            covariance: `(N, 3)` uu, uv, vv for a noise of one grey level, px^2.
            residual: `(N,)` RMS, grey levels.
        """
        typical = np.nanmedian(residual) if np.isfinite(residual).any() else 1.0
        variance = covariance * (1.2 * np.maximum(residual, typical) ** 2)[:, None]
        variance[:, 0] += self._config.pixel_floor**2
        variance[:, 2] += self._config.pixel_floor**2
        return np.asarray(variance)

    def _align_level(
        self, left: Pyramid, level: int, landmarks: Landmarks, start: Pose, iterations: int
    ) -> tuple[Pose, float]:
        """Return the pose aligned with one pyramid level, and its mean correlation."""
        places = (*start, landmarks.host_rotations, landmarks.host_positions, landmarks.uv, landmarks.inverse_depth)
        homographies = plane_homographies(*places, landmarks.slopes, self._camera, 0.0)
        patches = landmarks.patches[level]
        rotation, position, score, _ = align_pose(
            left.levels[level], level, patches, homographies, *places, self._camera, iterations
        )
        return Pose(rotation, position), score
