"""Tracking of the active landmarks in a new pair, and the pose that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.patch import LEVELS, Pyramid, plane_homographies
from sfr_loc_map.localisation.frontend.patch_tracking import TrackingLimits, track_patches
from sfr_loc_map.localisation.frontend.photometric_alignment import align_patches
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset, StereoObservations, solve_pose
from sfr_loc_map.localisation.parallel import both

LIMITS = TrackingLimits(max_shift=2.5, iterations=6, min_correlation=0.6)
"""Of a landmark against its projection: pixels, Gauss-Newton iterations, normalised cross-correlation."""
EXPECTED_OFFSET_PX = 0.5
"""Offset of right positions beyond which landmarks are sought there: less is within the reach of tracking."""
ALIGNED_LEVELS = range(LEVELS - 1, 0, -1)
"""The finest level adds nothing: patches are tracked from some tenths of a pixel."""
FIRST_ITERATIONS, NEXT_ITERATIONS = 6, 4
"""Gauss-Newton iterations of an alignment on the first level, and on each next one."""
POSE_ITERATIONS = 10
INLIER_CHI2_PER_DOF = 9.0
"""Squared Mahalanobis residual per degree of freedom below which a landmark agrees with a pose."""
PIXEL_FLOOR = 0.05  #: Smallest standard deviation of a tracked position, pixels.
EDGES_FROM_PX = 600.0
"""Focal length from which on edges of stones, not noise, limit a pose: seen from elsewhere they are other points of the
stone, and the sun makes those of one side the stronger ones, so that the path turns. Their residuals are large."""
MIN_TEXTURE = 1.0
"""Standard deviation, grey levels, of the coarsest pyramid level below which an image shows nothing."""


class StereoFrame(NamedTuple):
    """A pair, ready for tracking."""

    stamp_ns: int  #: Stamp of the pair.
    image: GreyImage  #: `(H, W)` uint8, left.
    left: Pyramid  #: Left pyramid.
    right: Pyramid  #: Right pyramid.


def is_textured(image: Pyramid) -> bool:
    """Tell whether an image shows anything: it is not black, white or blinded."""
    return float(np.std(image[-1].image)) > MIN_TEXTURE


@dataclass(frozen=True, slots=True, eq=False)
class TrackingResult:
    """Observations of the active landmarks in a pair, and its pose."""

    pose: Pose  #: Left camera in the world.
    information: FloatArray  #: `(6, 6)` of the pose given the landmarks.
    landmarks: Landmarks  #: The M active landmarks.
    observations: FloatArray  #: `(M, 4)` u, v left, u, v right, pixels; NaN where not found.
    variance: FloatArray  #: `(M, 2, 3)` uu, uv, vv of the left and right positions, px^2.
    chi2_per_dof: FloatArray  #: `(M,)` squared Mahalanobis residual per degree of freedom; NaN where not found.
    inliers: Mask  #: `(M,)` landmarks that agree with the pose.
    inlier_count: int  #: Their number.
    trusted: bool  #: Whether enough landmarks agree on the pose, of all and of those that were found.
    right_share: float  #: Share of the landmarks observed in the left image that are also observed in the right one.


class Tracker:
    """Tracks landmarks in pairs: first all together on coarse pyramid levels, then each one in both images."""

    def __init__(self, config: LocalisationConfig, camera: StereoCamera) -> None:
        self._min_tracked, self._camera = config.min_tracked, camera

    def align(
        self, left: Pyramid, landmarks: Landmarks, guesses: Sequence[Pose], levels: Sequence[int] = ALIGNED_LEVELS
    ) -> Pose:
        """Return the pose to some tenths of a pixel, level by level from the guess that fits the first one best."""
        planes, iterations = landmarks.planes, FIRST_ITERATIONS
        for level in levels:
            found = []
            for guess in guesses:
                homographies = plane_homographies(guess, planes, self._camera, 0.0)
                patches = landmarks.patches[level]
                found.append(align_patches(left[level], patches, homographies, planes, guess, self._camera, iterations))
            guesses, iterations = [max(found, key=attrgetter("correlation")).pose], NEXT_ITERATIONS
        return guesses[0]

    def refine(
        self,
        frame: StereoFrame,
        landmarks: Landmarks,
        start: Pose,
        offset: RightOffset,
        known: TrackingResult | None = None,
    ) -> TrackingResult:
        """Return the landmarks found near their projections from a pose, and the pose that follows.

        The start is right to about two pixels, the offset is the rotation error of the right camera. What is known is
        the tracking of some of the landmarks, which are not sought again, and perhaps of others.
        """
        if known is None:
            sought = landmarks
        elif known.landmarks is landmarks.followed:
            sought = landmarks.rest
        else:
            sought = landmarks.subset(~landmarks.among(known.landmarks))
        planes, templates = sought.planes, sought.patches[0]
        in_left, in_right = (plane_homographies(start, planes, self._camera, x) for x in (0.0, self._camera.baseline_m))
        if abs(offset.u) > EXPECTED_OFFSET_PX:
            in_right[:, 0] += offset.u * in_right[:, 2]
        left, right = both(
            track_patches,  # one kernel and nothing else: a thread that asks for the interpreter's lock is put to sleep
            (frame.left[0].image, templates, planes.uv, in_left, LIMITS),
            (frame.right[0].image, templates, planes.uv, in_right, LIMITS),
        )
        uv, variance = np.empty((len(planes.uv), 4)), np.empty((len(planes.uv), 2, 3))
        uv[:, :2], uv[:, 2:] = left.uv, right.uv - offset.at(right.uv, self._camera)
        for side, tracks in enumerate((left, right)):
            variance[:, side] = self.position_variance(tracks.covariance, tracks.residual)
        if known is not None:
            before, rows = landmarks.among(known.landmarks), known.landmarks.among(landmarks)
            new_uv, new_variance = uv, variance
            uv, variance = np.empty((len(landmarks.index), 4)), np.empty((len(landmarks.index), 2, 3))
            uv[before], uv[~before] = known.observations[rows], new_uv
            variance[before], variance[~before] = known.variance[rows], new_variance
        seen = StereoObservations(uv, variance)
        pose, information, (*_, chi2) = solve_pose(start, landmarks.estimates, seen, self._camera, POSE_ITERATIONS)
        inliers = chi2 < INLIER_CHI2_PER_DOF  # NaN is none
        count, found = int(np.count_nonzero(inliers)), int(np.count_nonzero(np.isfinite(chi2)))
        trusted = count >= self._min_tracked and count > 0.5 * found and found > 0.2 * len(chi2)
        seen_left = np.isfinite(uv[:, 0])
        right_share = float((seen_left & np.isfinite(uv[:, 2])).sum() / max(int(seen_left.sum()), 1))
        return TrackingResult(pose, information, landmarks, uv, variance, chi2, inliers, count, trusted, right_share)

    def refine_from_afar(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightOffset
    ) -> TrackingResult:
        """Return the same from a pose that is right to some pixels."""
        return self.refine(frame, landmarks, self.align(frame.left, landmarks, [start], (0,)), offset)

    def fits_swapped(self, frame: StereoFrame, result: TrackingResult, offset: RightOffset) -> bool:
        """Tell whether the landmarks fit well where left and right image are swapped."""
        rotation, position = result.pose
        start = Pose(rotation, position - rotation[:, 0] * self._camera.baseline_m)
        other = self.refine(frame._replace(left=frame.right, right=frame.left), result.landmarks, start, offset)
        return other.trusted and other.right_share > 0.6

    def position_variance(self, covariance: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the variances `(N, 3)` uu, uv, vv of tracked positions, px^2: half the patch's, half the image's.

        The covariance `(N, 3)` is that for a noise of one grey level, the residual `(N,)` RMS, grey levels, NaN where
        not found. One below the median may be so by chance and counts as the median.
        """
        found = np.sort(residual[~np.isnan(residual)])  # as quick as `np.median` is not
        typical = 0.5 * (found[(len(found) - 1) // 2] + found[len(found) // 2]) if len(found) else 1.0
        level = np.maximum(residual, typical)
        variance = covariance * (1.2 * (level * level))[:, None]
        floor: FloatArray | float = PIXEL_FLOOR**2
        if self._camera.fx >= EDGES_FROM_PX:
            floor = floor * np.clip(residual / max(typical, 1e-6), 0.5, 4.0) ** 4
        variance[:, 0] += floor
        variance[:, 2] += floor
        return np.asarray(variance)
