"""Sliding window: keyframes adjusted together, the landmarks they host, their observations, and the prior."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.localisation.backend.bundle_adjustment import (
    BundleProblem,
    OffsetEstimate,
    Prior,
    adjust,
    marginalise_oldest,
)
from sfr_loc_map.localisation.frontend.landmarks import NO_PATCHES, HostPatches, Landmarks, Patches
from sfr_loc_map.localisation.frontend.patch import LocalPlanes, Pyramid, Templates
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates

START_VARIANCE = 1e-10  #: Variance of the first pose (m^2, rad^2): it is given, not estimated.


class KeyframeDrift(NamedTuple):
    """How well the newest keyframe is known from the one before."""

    covariance: FloatArray  #: `(6, 6)` of the left camera, position and rotation about the world's axes.
    metres: float  #: Length of the motion between them.
    radians: float  #: Angle of it.


class SlidingWindow:
    """K keyframes adjusted together, oldest first, and their N landmarks, of which `active` `(N,)` are still tracked.

    `covariance` `(6, 6)` is of the newest pose, position and rotation about the world's axes; `drift` how well it was
    known from the one before, None without one; `right_offset` the offset of right positions along the rows.
    """

    def __init__(self, camera: StereoCamera, size: int) -> None:
        """Start empty; size is the maximum number of keyframes."""
        self._camera, self._size = camera, size
        keyframes, none = Poses(np.zeros((0, 3, 3)), np.zeros((0, 3))), np.zeros((0, 0, 4))
        host = np.zeros(0, np.int64)
        self.problem = BundleProblem(keyframes, host, np.zeros((0, 3)), none, np.zeros((0, 0, 2, 3)), camera)
        self.active = np.zeros(0, np.bool_)
        self._uv, self._slopes = np.zeros((0, 2)), np.zeros((0, 2))
        self._landmark_covariance = np.zeros((0, 3, 3))
        # by keyframe: what is large is copied neither when landmarks are added nor when they leave
        self._patches: list[HostPatches] = []
        self._prior = Prior(np.zeros((0, 0)), np.zeros(0), keyframes)
        self.covariance = np.zeros((0, 0))
        self.right_offset = OffsetEstimate(0.0, np.inf)
        self.drift: KeyframeDrift | None = None

    def landmarks(self) -> Landmarks:
        """Return the active landmarks of a window with at least one keyframe."""
        rows, problem = np.flatnonzero(self.active), self.problem
        rays = np.column_stack((self._camera.normalised(problem.uv_inverse_depth[rows, :2]), np.ones(len(rows))))
        hosts = Poses(*(array[problem.host[rows]] for array in problem.keyframes))
        inverse_depth = problem.uv_inverse_depth[rows, 2]
        return Landmarks(
            rows,
            LocalPlanes(hosts, self._uv[rows], inverse_depth, self._slopes[rows]),
            LandmarkEstimates(hosts, rays, inverse_depth, self._landmark_covariance[rows]),
            Patches(tuple(self._patches), rows),
            problem.observations[rows, -1],
        )

    def add_keyframe(self, pose: Pose, rows: NDArray[np.intp], uv: FloatArray, variance: FloatArray) -> None:
        """Append a keyframe that observes landmarks `(M,)` at `(M, 4)`, u, v left, u, v right, of variance `(M, 2, 3)`.

        The oldest leaves a full window.
        """
        problem, prior = self.problem, self._prior
        new_uv, new_variance = np.full((len(self.active), 1, 4), np.nan), np.ones((len(self.active), 1, 2, 3))
        new_uv[rows, 0], new_variance[rows, 0] = uv, variance
        keyframes, reference = (
            Poses(*(np.concatenate((array, one[None])) for array, one in zip(poses, pose, strict=True)))
            for poses in (problem.keyframes, prior.keyframes)
        )
        self.problem = problem._replace(
            keyframes=keyframes,
            observations=np.concatenate((problem.observations, new_uv), axis=1),
            variance=np.concatenate((problem.variance, new_variance), axis=1),
        )
        self._patches.append(NO_PATCHES)
        information = np.pad(prior.information, (0, 6))
        if len(self._patches) == 1:
            information = np.diag(np.full(6, 1.0 / START_VARIANCE))
        self._prior = Prior(information, np.pad(prior.information_vector, (0, 6)), reference)
        if len(self._patches) > self._size:
            # the information of the oldest keyframe and its landmarks about the others becomes the prior
            self._prior, problem = marginalise_oldest(self.problem, self._prior), self.problem
            kept = problem.host > 0
            self.problem = BundleProblem(
                self._prior.keyframes,
                problem.host[kept] - 1,
                problem.uv_inverse_depth[kept],
                problem.observations[kept, 1:].copy(),
                problem.variance[kept, 1:].copy(),
                self._camera,
            )
            self.active, self._uv, self._slopes = self.active[kept], self._uv[kept], self._slopes[kept]
            self._landmark_covariance = self._landmark_covariance[kept]
            del self._patches[0]

    def add_landmarks(
        self,
        left: Pyramid,
        uv: FloatArray,
        inverse_depth: FloatArray,
        slopes: FloatArray,
        patches: Templates,
        observed: FloatArray,
        variance: FloatArray,
    ) -> None:
        """Add the landmarks that the newest keyframe hosts at whole pixels `(M, 2)`, once per keyframe.

        Inverse depth is 1/m, a slope its change per pixel; it observes them at `(M, 4)`, u, v left, u, v right, of
        variance `(M, 2, 3)`; patches are of full size.
        """
        problem, count = self.problem, len(uv)
        new_uv = np.full((count, len(self._patches), 4), np.nan)
        new_variance = np.ones((count, len(self._patches), 2, 3))
        new_uv[:, -1], new_variance[:, -1] = observed, variance
        self.problem = problem._replace(
            host=np.concatenate((problem.host, np.full(count, len(self._patches) - 1, np.int64))),
            uv_inverse_depth=np.concatenate((problem.uv_inverse_depth, np.column_stack((uv, inverse_depth)))),
            observations=np.concatenate((problem.observations, new_uv)),
            variance=np.concatenate((problem.variance, new_variance)),
        )
        self.active = np.concatenate((self.active, np.ones(count, np.bool_)))
        self._uv, self._slopes = np.concatenate((self._uv, uv)), np.concatenate((self._slopes, slopes))
        self._landmark_covariance = np.concatenate((self._landmark_covariance, np.zeros((count, 3, 3))))
        self._patches[-1] = HostPatches(uv, patches, left[1:])

    def adjust(self, iterations: int) -> None:
        """Adjust all keyframes and landmarks together."""
        result = adjust(self.problem, self._prior, iterations)
        self.problem = result.problem
        self._landmark_covariance, self.right_offset = result.covariance, result.right_offset
        self.covariance, self.drift = result.pose_covariance[-6:, -6:], None
        if len(self._patches) > 1:
            rotations, positions = self.problem.keyframes
            displacement = positions[-1] - positions[-2]
            turn = rotvec_from_matrix(rotations[-2].T @ rotations[-1])
            relative = np.hstack((-np.eye(6), np.eye(6)))
            relative[:3, 3:6] = -np.cross(displacement, np.eye(3))
            covariance = np.asarray(relative @ result.pose_covariance[-12:, -12:] @ relative.T)
            self.drift = KeyframeDrift(covariance, float(np.linalg.norm(displacement)), float(np.linalg.norm(turn)))
