"""Tracking of landmarks in a stereo pair, and the pose of that pair.

1. `align` estimates one pose from many patches, from coarse to fine pyramid levels (direct image alignment, as in
   Forster et al., SVO, 2017). The pose is accurate to a few hundredths of a pixel of the finest aligned level.
2. `observe` tracks each landmark in both images with its patch warped by its local plane (Lucas and Kanade 1981).
3. `solve` estimates the pose from all observations, with Geman-McClure weights and the uncertainty of each landmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.noise import position_variance
from sfr_loc_map.localisation.frontend.patch_tracking import TrackingLimits, track_patches
from sfr_loc_map.localisation.frontend.photometric_alignment import align_patches
from sfr_loc_map.localisation.frontend.plane_warp import plane_homographies
from sfr_loc_map.localisation.frontend.pose_solver import StereoObservations, solve_pose
from sfr_loc_map.localisation.frontend.pyramid import LEVELS, Pyramid
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.small_linalg import median_without_nan
from sfr_loc_map.parallel import both

LIMITS = TrackingLimits(max_shift=2.5, iterations=6, min_correlation=0.6)
"""Limits of a track: maximum shift from the projection, px, Gauss-Newton iterations, and minimum normalised
cross-correlation. Other values were tried: measurements/localiser_trials.md, "Limits of a track"."""
SEARCHED_OFFSET_PX = 0.5
"""Yaw of the right camera, px, above which tracking starts at the offset position. A smaller offset is within the
capture range of the tracker (`LIMITS`). Pitch and roll must always be within that range."""
ALIGNED_LEVELS = range(LEVELS - 1, 0, -1)
"""Pyramid levels of the alignment. Level 0 is omitted, because the tracking of single patches corrects the remaining
error."""
ALIGNMENT_ITERATIONS = (6, 4)
"""Gauss-Newton iterations of the alignment on the first level and on each further level, which starts closer to the
solution. With fewer iterations, large prediction errors are not corrected; more take more time."""
POSE_ITERATIONS = 10
"""Maximum number of Gauss-Newton iterations of the pose. The pose usually converges earlier
(`pose_solver.CONVERGED_STEP`)."""
INLIER_CHI2_PER_DOF = 9.0  #: Gate of an inlier: squared Mahalanobis residual per degree of freedom (3 sigma).
MIN_INLIER_RATIO = 0.5  #: Minimum ratio of inliers to found landmarks for a trusted pose: a majority.
MIN_FOUND_RATIO = 0.2
"""Minimum ratio of found to searched landmarks for a trusted pose. Below 0.2, most of the view has changed, and the
landmarks found may belong to a single object."""
SWAPPED_STEREO_FRACTION = 0.6
"""Minimum fraction of inliers observed in both images if the left and right images are swapped. It is a majority, and
twice the limit for one-sided pairs (`guards.MIN_STEREO_FRACTION`)."""


class InlierCounts(NamedTuple):
    """Numbers of landmarks of a stereo pair."""

    found: int  #: Landmarks with a residual.
    inliers: int  #: Landmarks whose residual passes the gate.
    in_left: int  #: Inliers that were observed in the left image.
    in_right: int  #: Inliers that were observed in the right image.
    in_both: int  #: Inliers that were observed in both images.


class Tracks(NamedTuple):
    """Observations of M landmarks in a stereo pair, and the pose estimated from them.

    Information, residuals and inliers are those of the last linearisation, which is at the pose before the last step.
    """

    pose: Pose  #: Left camera in the world.
    information: FloatArray  #: `(6, 6)` information of the pose given the keyframes; the landmarks are marginalised.
    landmarks: Landmarks  #: The M landmarks that were searched for.
    observations: FloatArray  #: `(M, 4)` u, v left, u, v right, px; NaN where a landmark was not found.
    variance: FloatArray  #: `(M, 2, 3)` uu, uv, vv of the left and right observations, px^2.
    chi2_per_dof: FloatArray  #: `(M,)` squared Mahalanobis residual per degree of freedom; NaN if not found.
    inliers: Mask  #: `(M,)` landmarks whose residual passes the gate.
    counts: InlierCounts  #: Numbers of the inliers.
    is_trusted: bool  #: Whether enough landmarks were found, and enough of these are inliers (`Tracker.solve`).

    @property
    def observed(self) -> StereoObservations:
        """The observations with their variances."""
        return StereoObservations(self.observations, self.variance)

    @property
    def chi_median(self) -> float:
        """Median squared Mahalanobis residual per degree of freedom; NaN without residuals."""
        return median_without_nan(self.chi2_per_dof)

    @property
    def median_residual_px(self) -> float:
        """Median residual of the inliers, px; NaN without inliers."""
        return _median_residual_px(self.chi2_per_dof, self.inliers, self.observed)

    @property
    def inlier_count(self) -> int:
        """Number of inliers."""
        return self.counts.inliers

    @property
    def is_left_fuller(self) -> bool:
        """Whether at least as many inliers were observed in the left image as in the right image."""
        return self.counts.in_left >= self.counts.in_right

    @property
    def stereo_fraction(self) -> float:
        """Ratio of the inliers observed in both images to the inliers observed in the image with more inliers."""
        return self.counts.in_both / max(self.counts.in_left, self.counts.in_right, 1)


@jit
def _median_residual_px(chi2_per_dof: FloatArray, inliers: Mask, observed: StereoObservations) -> float:
    """Return the median residual of the inliers, px, from chi-square and the mean variance of each landmark."""
    residual_px = np.full(len(inliers), np.nan)
    for n in range(len(inliers)):
        if inliers[n]:
            variance = 0.0
            images = 0  # at least 1 for an inlier
            for side in range(2):
                if not np.isnan(observed.uv[n, 2 * side]):
                    variance += 0.5 * (observed.variance[n, side, 0] + observed.variance[n, side, 2])
                    images += 1
            residual_px[n] = np.sqrt(chi2_per_dof[n] * (variance / images))
    return median_without_nan(residual_px)


@jit
def _gated(chi2_per_dof: FloatArray, uv: FloatArray) -> tuple[Mask, InlierCounts]:
    """Return the inliers `(M,)` by the residuals `(M,)` of landmarks, and their numbers by the pixels `(M, 4)`."""
    inliers = np.zeros(len(chi2_per_dof), np.bool_)
    found = 0
    count = 0
    in_left = 0
    in_right = 0
    in_both = 0
    for n in range(len(chi2_per_dof)):
        found += np.isfinite(chi2_per_dof[n])
        if chi2_per_dof[n] < INLIER_CHI2_PER_DOF:  # False for NaN
            is_in_left = not np.isnan(uv[n, 0])
            is_in_right = not np.isnan(uv[n, 2])
            inliers[n] = True
            count += 1
            in_left += is_in_left
            in_right += is_in_right
            in_both += is_in_left and is_in_right
    return inliers, InlierCounts(found, count, in_left, in_right, in_both)


class Tracker:
    """Tracker of landmarks in stereo pairs, without state between calls."""

    def __init__(self, min_tracked: int, camera: StereoCamera) -> None:
        """A trusted pose requires at least `min_tracked` inliers."""
        self._min_tracked = min_tracked
        self._camera = camera

    def align(
        self, left: Pyramid, landmarks: Landmarks, guesses: Sequence[Pose], levels: Sequence[int] = ALIGNED_LEVELS
    ) -> Pose:
        """Return the pose, accurate to a few hundredths of a pixel of the last level.

        After the first level, the alignment continues from the guess with the highest correlation.
        """
        iterations, next_iterations = ALIGNMENT_ITERATIONS
        planes = landmarks.planes
        for level in levels:
            patches = landmarks.patches.at(level)
            aligned = []
            for guess in guesses:
                homographies = plane_homographies(guess, planes, self._camera, 0.0)
                aligned.append(
                    align_patches(left[level], patches, homographies, planes, guess, self._camera, iterations)
                )
            guesses = [max(aligned, key=attrgetter("correlation")).pose]
            iterations = next_iterations
        return guesses[0]

    def observe(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightCameraOffset
    ) -> StereoObservations:
        """Track landmarks from their projections at a pose that is accurate to about two pixels.

        The offset of the right camera is subtracted from the right observations.
        """
        planes = landmarks.planes
        templates = landmarks.patches.at(0)
        in_left = plane_homographies(start, planes, self._camera, 0.0)
        in_right = plane_homographies(start, planes, self._camera, self._camera.baseline_m)
        if abs(offset.yaw_px) > SEARCHED_OFFSET_PX:
            # u' = (h_0 . p) / (h_2 . p) + offset, so that the first row becomes h_0 + offset h_2
            in_right[:, 0] += offset.yaw_px * in_right[:, 2]
        left, right = both(
            track_patches,  # only one kernel: a thread that waits for the interpreter lock is put to sleep
            (frame.left[0].image, templates, planes.uv, in_left, LIMITS),
            (frame.right[0].image, templates, planes.uv, in_right, LIMITS),
        )
        uv = np.empty((len(planes.uv), 4))
        uv[:, :2] = left.uv
        uv[:, 2:] = right.uv - offset.at(right.uv, self._camera)
        variance = np.empty((len(planes.uv), 2, 3))
        variance[:, 0] = position_variance(left.covariance, left.residual, self._camera.fx)
        variance[:, 1] = position_variance(right.covariance, right.residual, self._camera.fx)
        return StereoObservations(uv, variance)

    def solve(self, landmarks: Landmarks, observed: StereoObservations, start: Pose) -> Tracks:
        """Estimate the pose from observations of landmarks."""
        solution = solve_pose(start, landmarks.estimates, observed, self._camera, POSE_ITERATIONS)
        chi2_per_dof = solution.linearised.chi2_per_dof
        inliers, counts = _gated(chi2_per_dof, observed.uv)
        is_trusted = (
            counts.inliers >= self._min_tracked
            and counts.inliers > MIN_INLIER_RATIO * counts.found
            and counts.found > MIN_FOUND_RATIO * len(chi2_per_dof)
        )
        return Tracks(
            pose=solution.pose,
            information=solution.information,
            landmarks=landmarks,
            observations=observed.uv,
            variance=observed.variance,
            chi2_per_dof=chi2_per_dof,
            inliers=inliers,
            counts=counts,
            is_trusted=is_trusted,
        )

    def refine(self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightCameraOffset) -> Tracks:
        """Observe landmarks from a pose that is accurate to about two pixels, and solve for the pose."""
        return self.solve(landmarks, self.observe(frame, landmarks, start, offset), start)

    def refine_from_afar(
        self, frame: StereoFrame, landmarks: Landmarks, start: Pose, offset: RightCameraOffset
    ) -> Tracks:
        """Align a pose with an error of several pixels on level 0, then refine it."""
        return self.refine(frame, landmarks, self.align(frame.left, landmarks, [start], (0,)), offset)

    def complete(
        self, frame: StereoFrame, tracks: Tracks, landmarks: Landmarks, rest: Landmarks, offset: RightCameraOffset
    ) -> Tracks:
        """Solve for the pose with all `landmarks`. Tracked landmarks keep their observations, and `rest` is observed.

        Together, the tracked landmarks and `rest` contain all landmarks. Tracks of other landmarks are not used.
        """
        of_rest = self.observe(frame, rest, tracks.pose, offset)
        was_tracked = landmarks.among(tracks.landmarks)
        is_in_map = tracks.landmarks.among(landmarks)
        uv = np.empty((len(landmarks.rows), 4))
        uv[was_tracked] = tracks.observations[is_in_map]
        uv[~was_tracked] = of_rest.uv
        variance = np.empty((len(landmarks.rows), 2, 3))
        variance[was_tracked] = tracks.variance[is_in_map]
        variance[~was_tracked] = of_rest.variance
        return self.solve(landmarks, StereoObservations(uv, variance), tracks.pose)

    def fits_swapped(self, frame: StereoFrame, tracks: Tracks, offset: RightCameraOffset) -> bool:
        """Return whether the landmarks fit well if left and right image are swapped.

        The image with more inliers determined the pose. If the images are swapped, the other camera took this image, so
        that the swapped fit starts one baseline away from the pose.
        """
        rotation, position = tracks.pose
        baseline = rotation[:, 0] * self._camera.baseline_m
        start = Pose(rotation, position - baseline if tracks.is_left_fuller else position + baseline)
        swapped = self.refine(frame.swapped(), tracks.landmarks, start, offset)
        return swapped.is_trusted and swapped.stereo_fraction > SWAPPED_STEREO_FRACTION
