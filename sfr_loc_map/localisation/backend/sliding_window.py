"""Sliding window: the keyframes that are adjusted together, their landmarks and observations, and the prior.

A window is immutable. Each operation returns a new window, which shares the unchanged arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.transform import propagation
from sfr_loc_map.localisation.backend.bundle_adjustment import (
    BundleProblem,
    OffsetEstimate,
    Prior,
    adjust,
    marginalise_oldest,
)
from sfr_loc_map.localisation.config import TRACKED_LANDMARKS
from sfr_loc_map.localisation.frontend.landmarks import (
    ALIGNED_LANDMARKS,
    NO_PATCHES,
    HostPatches,
    Landmarks,
    LandmarkTemplates,
)
from sfr_loc_map.localisation.frontend.patch import Templates
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates, StereoObservations
from sfr_loc_map.localisation.frontend.pyramid import LEVELS, Pyramid
from sfr_loc_map.localisation.motion_size import MotionSize, size_between

START_VARIANCE = 1e-10  #: Variance of the first pose, m^2 and rad^2. The first pose is an input, not an estimate.


class KeyframeMotion(NamedTuple):
    """Motion from the previous keyframe to the newest keyframe."""

    covariance: FloatArray  #: `(6, 6)` of the left camera, position and rotation about the world's axes.
    size: MotionSize


class NewLandmarks(NamedTuple):
    """M landmarks that a keyframe hosts at whole pixels."""

    uv: FloatArray  #: `(M, 2)` host pixels.
    inverse_depth: FloatArray  #: `(M,)` 1/m.
    slopes: FloatArray  #: `(M, 2)` change of the inverse depth per pixel along u and v, 1/m.
    patches: Templates  #: Templates at full size.
    observed: StereoObservations  #: Observations in the host keyframe.


@dataclass(frozen=True, eq=False)
class SlidingWindow:
    """K keyframes that are adjusted together, oldest first, and the N landmarks that they host."""

    size: int  #: Maximum number of keyframes.
    problem: BundleProblem  #: Keyframes, landmarks and observations.
    active: Mask  #: `(N,)` landmarks that are still tracked.
    uv: FloatArray  #: `(N, 2)` host pixels where the patches were cut.
    slopes: FloatArray  #: `(N, 2)` change of the inverse depth per pixel, 1/m.
    landmark_covariance: FloatArray  #: `(N, 3, 3)` of the landmarks given the poses, px and 1/m.
    patches: tuple[HostPatches, ...]  #: Patches by keyframe; the large arrays are shared between windows.
    prior: Prior  #: Information of the keyframes and landmarks that have left the window.

    @classmethod
    def empty(cls, camera: StereoCamera, size: int) -> SlidingWindow:
        """Return a window without keyframes."""
        keyframes = Poses(np.zeros((0, 3, 3)), np.zeros((0, 3)))
        host = np.zeros(0, np.int64)
        observations = np.zeros((0, 0, 4))
        problem = BundleProblem(keyframes, host, np.zeros((0, 3)), observations, np.zeros((0, 0, 2, 3)), camera)
        return cls(
            size=size,
            problem=problem,
            active=np.zeros(0, np.bool_),
            uv=np.zeros((0, 2)),
            slopes=np.zeros((0, 2)),
            landmark_covariance=np.zeros((0, 3, 3)),
            patches=(),
            prior=Prior(np.zeros((0, 0)), np.zeros(0), keyframes),
        )

    @property
    def keyframe_count(self) -> int:
        """Number of keyframes in the window."""
        return len(self.patches)

    @property
    def newest_pose(self) -> Pose:
        """Pose of the newest keyframe's left camera in the world."""
        rotations, positions = self.problem.keyframes
        return Pose(rotations[-1], positions[-1])

    def landmarks(self) -> Landmarks:
        """Return the active landmarks of a window with at least one keyframe."""
        rows = np.flatnonzero(self.active)
        problem = self.problem
        uv_inverse_depth = problem.uv_inverse_depth.take(rows, axis=0)
        rays = np.column_stack((problem.camera.normalised(uv_inverse_depth[:, :2]), np.ones(len(rows))))
        host = problem.host[rows]
        keyframes = problem.keyframes
        hosts = keyframes.take(host)
        inverse_depth = uv_inverse_depth[:, 2].copy()
        return Landmarks(
            rows=rows,
            host=host,
            planes=LocalPlanes(hosts, self.uv.take(rows, axis=0), inverse_depth, self.slopes.take(rows, axis=0)),
            estimates=LandmarkEstimates(hosts, rays, inverse_depth, self.landmark_covariance.take(rows, axis=0)),
            patches=LandmarkTemplates(self.patches, rows),
            last_seen=problem.observations[rows, -1],
        )

    def deactivated(self, rows: NDArray[np.intp]) -> SlidingWindow:
        """Return the window in which some landmarks are no longer tracked.

        Their earlier observations remain in the adjustment, with a robust weight. A trial without the observations of
        landmarks that do not move with the ground: measurements/localiser_trials.md, "Observations of excluded
        landmarks".
        """
        active = self.active.copy()
        active[rows] = False
        return replace(self, active=active)

    def with_yaw_corrected(self, yaw_px: float) -> SlidingWindow:
        """Return the window with all right observations corrected along the rows for a yaw of the right camera, px.

        The v coordinates are not corrected. The yaw changes them by `x y yaw_px`, and later observations are corrected
        for this change (`RightCameraOffset.at`). A trial that also corrected the v coordinates:
        measurements/localiser_trials.md, "Yaw of the right camera as a flow field in the adjustment".
        """
        camera = self.problem.camera
        observations = self.problem.observations.copy()
        x = (observations[:, :, 2] - camera.cx) / camera.fx
        observations[:, :, 2] -= yaw_px * (1.0 + x * x)
        return replace(self, problem=self.problem._replace(observations=observations))

    def with_keyframe(self, pose: Pose, rows: NDArray[np.intp], observed: StereoObservations) -> SlidingWindow:
        """Return the window with a further keyframe that observes the landmarks in given rows `(M,)`.

        If the window is full, its oldest keyframe is marginalised.
        """
        problem = self.problem
        count = len(self.active)
        new_uv = np.full((count, 1, 4), np.nan)
        new_uv[rows, 0] = observed.uv
        new_variance = np.ones((count, 1, 2, 3))
        new_variance[rows, 0] = observed.variance
        problem = problem._replace(
            keyframes=_appended(problem.keyframes, pose),
            observations=np.concatenate((problem.observations, new_uv), axis=1),
            variance=np.concatenate((problem.variance, new_variance), axis=1),
        )
        if self.keyframe_count > 0:
            information = np.pad(self.prior.information, (0, 6))
        else:
            information = np.diag(np.full(6, 1.0 / START_VARIANCE))
        vector = np.pad(self.prior.information_vector, (0, 6))
        prior = Prior(information, vector, _appended(self.prior.keyframes, pose))
        window = replace(self, problem=problem, prior=prior, patches=(*self.patches, NO_PATCHES))
        return window._oldest_marginalised() if window.keyframe_count > self.size else window

    def _oldest_marginalised(self) -> SlidingWindow:
        """Return the window without its oldest keyframe and the landmarks that this keyframe hosts.

        Their information remains in the prior.
        """
        problem = self.problem
        prior = marginalise_oldest(problem, self.prior)
        kept = problem.host > 0
        return replace(
            self,
            problem=BundleProblem(
                keyframes=prior.keyframes,
                host=problem.host[kept] - 1,
                uv_inverse_depth=problem.uv_inverse_depth[kept],
                observations=np.ascontiguousarray(problem.observations[kept, 1:]),
                variance=np.ascontiguousarray(problem.variance[kept, 1:]),
                camera=problem.camera,
            ),
            active=self.active[kept],
            uv=self.uv[kept],
            slopes=self.slopes[kept],
            landmark_covariance=self.landmark_covariance[kept],
            patches=self.patches[1:],
            prior=prior,
        )

    def with_landmarks(self, left: Pyramid, new: NewLandmarks) -> SlidingWindow:
        """Return the window with the landmarks that the newest keyframe hosts. It must not host landmarks already."""
        assert not len(self.patches[-1].uv), "a keyframe hosts its landmarks from one call"
        problem = self.problem
        count = len(new.uv)
        keyframes = self.keyframe_count
        new_uv = np.full((count, keyframes, 4), np.nan)
        new_uv[:, -1] = new.observed.uv
        new_variance = np.ones((count, keyframes, 2, 3))
        new_variance[:, -1] = new.observed.variance
        uv_inverse_depth = np.column_stack((new.uv, new.inverse_depth))
        return replace(
            self,
            problem=problem._replace(
                host=np.concatenate((problem.host, np.full(count, keyframes - 1, np.int64))),
                uv_inverse_depth=np.concatenate((problem.uv_inverse_depth, uv_inverse_depth)),
                observations=np.concatenate((problem.observations, new_uv)),
                variance=np.concatenate((problem.variance, new_variance)),
            ),
            active=np.concatenate((self.active, np.ones(count, np.bool_))),
            uv=np.concatenate((self.uv, new.uv)),
            slopes=np.concatenate((self.slopes, new.slopes)),
            landmark_covariance=np.concatenate((self.landmark_covariance, np.zeros((count, 3, 3)))),
            patches=(*self.patches[:-1], HostPatches(new.uv, new.patches, left[1:])),
        )

    def adjusted(self, iterations: int) -> LandmarkMap:
        """Return the map of the window with all keyframes and landmarks adjusted together."""
        result = adjust(self.problem, self.prior, iterations)
        return LandmarkMap(
            window=replace(self, problem=result.problem, landmark_covariance=result.covariance),
            covariance=result.pose_covariance[-6:, -6:],
            last_motion=_last_motion(result.problem.keyframes, result.pose_covariance),
            right_offset=result.right_offset,
        )


def _appended(poses: Poses, pose: Pose) -> Poses:
    rotations = np.concatenate((poses.rotations, pose.rotation[None]))
    return Poses(rotations, np.concatenate((poses.positions, pose.position[None])))


def _last_motion(keyframes: Poses, pose_covariance: FloatArray) -> KeyframeMotion | None:
    """Return the motion to the newest of K keyframes; `(6 K, 6 K)` is the covariance of all poses."""
    rotations, positions = keyframes
    if len(positions) < 2:
        return None
    displacement = positions[-1] - positions[-2]
    # an error of the previous keyframe displaces the newest keyframe as if both were rigidly attached
    relative = np.hstack((-propagation(displacement), np.eye(6)))
    covariance = np.asarray(relative @ pose_covariance[-12:, -12:] @ relative.T)
    size = size_between(Pose(rotations[-2], positions[-2]), Pose(rotations[-1], positions[-1]))
    return KeyframeMotion(covariance, size)


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """A sliding window after its adjustment, and its active landmarks.

    The landmarks of a stage are selected, and their templates copied (`LandmarkTemplates.at`), at the first use.
    `prepare` does this for the next pairs in the background thread of a keyframe, which saves time in the next call.
    """

    window: SlidingWindow  #: The adjusted window.
    covariance: FloatArray  #: `(6, 6)` of the newest pose (`Adjustment`), position and rotation about the world's axes.
    last_motion: KeyframeMotion | None  #: Motion to the newest keyframe; None with fewer than two keyframes.
    right_offset: OffsetEstimate  #: Offset of the right observations along the rows.

    def prepare(self) -> None:
        """Select the landmarks and copy the templates for the next pairs."""
        for landmarks in (self.tracked, self.rest):
            _ = landmarks.patches.at(0)
        _ = self.landmarks.median_depth
        _ = self.tracked.median_depth
        for level in range(1, LEVELS):
            _ = self.aligned.patches.at(level)

    @cached_property
    def landmarks(self) -> Landmarks:
        """All active landmarks."""
        return self.window.landmarks()

    @cached_property
    def tracked(self) -> Landmarks:
        """Landmarks that are tracked in each pair."""
        return self.landmarks.thinned(TRACKED_LANDMARKS)

    @cached_property
    def rest(self) -> Landmarks:
        """Landmarks that are tracked only in pairs that become keyframes."""
        return self.landmarks.subset(~self.landmarks.among(self.tracked))

    def rest_of(self, tracked: Landmarks) -> Landmarks:
        """Return the active landmarks that are not among some tracked landmarks."""
        if np.array_equal(tracked.rows, self.tracked.rows):
            return self.rest  # the patches of these landmarks are already copied
        return self.landmarks.subset(~self.landmarks.among(tracked))

    @cached_property
    def aligned(self) -> Landmarks:
        """Landmarks used in the alignment of the initial guesses of a pose."""
        return self.tracked.thinned(ALIGNED_LANDMARKS)

    def deactivated(self, rows: NDArray[np.intp]) -> LandmarkMap:
        """Return the map in which some landmarks are no longer tracked, or this map if `rows` is empty."""
        return replace(self, window=self.window.deactivated(rows)) if len(rows) else self
