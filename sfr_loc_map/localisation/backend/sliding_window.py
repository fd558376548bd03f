"""Sliding window: keyframes adjusted together, the landmarks they host, their observations, and the prior."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import propagation
from sfr_loc_map.localisation.backend.bundle_adjustment import OffsetEstimate, Prior, adjust, marginalise_oldest
from sfr_loc_map.localisation.backend.linearisation import BundleProblem
from sfr_loc_map.localisation.frontend.image_pyramid import Pyramid
from sfr_loc_map.localisation.frontend.landmarks import HostPatches, Landmarks, Patches
from sfr_loc_map.localisation.frontend.patch import Templates

START_VARIANCE = 1e-10
"""Variance of the first pose (m^2, rad^2): it is given, not estimated."""


@dataclass(frozen=True, slots=True, eq=False)
class HostedLandmarks:
    """The N landmarks of a window.

    Attributes:
        host: `(N,)` int64 keyframe that hosts each one.
        active: `(N,)` whether it is still tracked.
        uv: `(N, 2)` host pixel of its patch, whole pixels.
        uv_inverse_depth: `(N, 3)` its estimated host pixel and inverse depth (1/m).
        slopes: `(N, 2)` change of the inverse depth per pixel, of its local plane.
        covariance: `(N, 3, 3)` of `uv_inverse_depth` given the poses.
    """

    host: NDArray[np.int64]
    active: Mask
    uv: FloatArray
    uv_inverse_depth: FloatArray
    slopes: FloatArray
    covariance: FloatArray

    @classmethod
    def new(cls, host: int, uv: FloatArray, inverse_depth: FloatArray, slopes: FloatArray) -> HostedLandmarks:
        """Return landmarks at their host pixels, active, with nothing known of their covariance."""
        count = len(uv)
        hosts, active = np.full(count, host, np.int64), np.ones(count, np.bool_)
        return cls(hosts, active, uv, np.column_stack((uv, inverse_depth)), slopes, np.zeros((count, 3, 3)))

    def with_more(self, other: HostedLandmarks) -> HostedLandmarks:
        """Return these landmarks and other ones after them."""
        arrays = ((getattr(self, item.name), getattr(other, item.name)) for item in fields(self))
        return HostedLandmarks(*map(np.concatenate, arrays))

    def without_oldest_host(self) -> HostedLandmarks:
        """Return the landmarks of the other keyframes, whose numbers are one less."""
        kept = self.host > 0
        arrays = [getattr(self, item.name)[kept] for item in fields(self)]
        return HostedLandmarks(arrays[0] - 1, *arrays[1:])

    def without(self, rows: NDArray[np.intp]) -> HostedLandmarks:
        """Return the same landmarks, some of them no longer active."""
        active = self.active.copy()
        active[rows] = False
        return replace(self, active=active)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Where K keyframes observed N landmarks.

    Attributes:
        uv: `(N, K, 4)` u, v left, u, v right, pixels; NaN where not observed.
        variance: `(N, K, 2, 3)` uu, uv, vv of left and right, px^2.
    """

    uv: FloatArray
    variance: FloatArray

    def with_keyframe(self, rows: NDArray[np.intp], uv: FloatArray, variance: FloatArray) -> Observations:
        """Return the observations with those of one more keyframe: landmarks `(M,)`, `(M, 4)`, `(M, 2, 3)`."""
        count = len(self.uv)
        new_uv, new_variance = np.full((count, 1, 4), np.nan), np.ones((count, 1, 2, 3))
        new_uv[rows, 0], new_variance[rows, 0] = uv, variance
        return Observations(
            np.concatenate((self.uv, new_uv), axis=1), np.concatenate((self.variance, new_variance), axis=1)
        )

    def with_landmarks(self, uv: FloatArray, variance: FloatArray) -> Observations:
        """Return the observations with those of more landmarks, `(M, 4)`, `(M, 2, 3)`, in the newest keyframe alone."""
        count, keyframes = len(uv), self.uv.shape[1]
        new_uv, new_variance = np.full((count, keyframes, 4), np.nan), np.ones((count, keyframes, 2, 3))
        new_uv[:, -1], new_variance[:, -1] = uv, variance
        return Observations(np.concatenate((self.uv, new_uv)), np.concatenate((self.variance, new_variance)))

    def without_oldest(self, kept: Mask) -> Observations:
        """Return those of the kept landmarks `(N,)` in all keyframes but the oldest."""
        return Observations(self.uv[kept, 1:].copy(), self.variance[kept, 1:].copy())

    def shifted_right(self, columns: float, camera: StereoCamera) -> Observations:
        """Return them with right positions moved as by a yaw of the right camera, by `columns` at the image centre."""
        uv = self.uv.copy()
        x = (uv[:, :, 2] - camera.cx) / camera.fx
        uv[:, :, 2] += columns * (1.0 + x * x)
        return replace(self, uv=uv)


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeDrift:
    """How well the newest keyframe is known from the one before.

    Attributes:
        covariance: `(6, 6)` of the left camera, position and rotation about the world's axes.
        metres: Length of the motion between them.
        radians: Angle of it.
    """

    covariance: FloatArray
    metres: float
    radians: float


class SlidingWindow:
    """Keyframes adjusted together, oldest first, and their landmarks.

    Attributes:
        keyframes: `(K,)` left cameras.
        hosted: The landmarks.
        observations: Where the keyframes observed them.
        pose_covariance: `(6 K, 6 K)` of all poses, position and rotation about the world's axes.
        right_offset: Offset of right positions along the rows.
        drift: How well the newest keyframe was known from the one before when they were adjusted; None without one.
    """

    def __init__(self, camera: StereoCamera, size: int) -> None:
        """Start empty; size is the maximum number of keyframes."""
        self._camera, self._size = camera, size
        self.keyframes = Poses(np.zeros((0, 3, 3)), np.zeros((0, 3)))
        self.hosted = HostedLandmarks.new(0, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)))
        self.observations = Observations(np.zeros((0, 0, 4)), np.zeros((0, 0, 2, 3)))
        # by keyframe: what is large is copied neither when landmarks are added nor when they leave
        self._patches: list[HostPatches] = []
        self.pose_covariance = np.zeros((0, 0))
        self.right_offset = OffsetEstimate(0.0, np.inf)
        self.drift: KeyframeDrift | None = None
        self._prior = Prior(np.zeros((0, 0)), np.zeros(0), self.keyframes)

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.keyframes.rotations)

    @property
    def last_covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the newest keyframe's pose."""
        return self.pose_covariance[-6:, -6:]

    def _drift(self) -> KeyframeDrift | None:
        """Return how well the newest keyframe is known from the one before, None where there is none."""
        if len(self) < 2:
            return None
        displacement = self.keyframes.positions[-1] - self.keyframes.positions[-2]
        turn = rotvec_from_matrix(self.keyframes.rotations[-2].T @ self.keyframes.rotations[-1])
        relative = np.hstack((-propagation(displacement), np.eye(6)))
        covariance = np.asarray(relative @ self.pose_covariance[-12:, -12:] @ relative.T)
        return KeyframeDrift(covariance, float(np.linalg.norm(displacement)), float(np.linalg.norm(turn)))

    @property
    def newest_observations(self) -> FloatArray:
        """Where the newest keyframe observed the active landmarks, `(M, 4)`."""
        return np.asarray(self.observations.uv[self.hosted.active, -1])

    def landmarks(self) -> Landmarks:
        """Return the active landmarks of a window with at least one keyframe."""
        rows, hosted = np.flatnonzero(self.hosted.active), self.hosted
        rays = np.column_stack((self._camera.normalised(hosted.uv_inverse_depth[rows, :2]), np.ones(len(rows))))
        return Landmarks(
            rows,
            Poses(*(array[hosted.host[rows]] for array in self.keyframes)),
            hosted.uv[rows],
            rays,
            hosted.uv_inverse_depth[rows, 2],
            hosted.slopes[rows],
            hosted.covariance[rows],
            Patches(tuple(self._patches), rows),
            self.observations.uv[rows, -1],
        )

    def deactivate(self, rows: NDArray[np.intp]) -> None:
        """Stop tracking some landmarks."""
        self.hosted = self.hosted.without(rows)

    def add_keyframe(
        self,
        pose: Pose,
        rows: NDArray[np.intp],
        uv: FloatArray,
        variance: FloatArray,
    ) -> None:
        """Append a keyframe with its observations; the oldest leaves a full window.

        Args:
            pose: Left camera.
            rows: `(M,)` landmarks it observes.
            uv: `(M, 4)` where, u, v left, u, v right.
            variance: `(M, 2, 3)` of these.
        """
        self.observations = self.observations.with_keyframe(rows, uv, variance)
        self.keyframes = _with_pose(self.keyframes, pose)
        self._patches.append(HostPatches.none())
        self._prior = Prior(
            np.pad(self._prior.information, (0, 6)),
            np.pad(self._prior.information_vector, (0, 6)),
            _with_pose(self._prior.keyframes, pose),
        )
        if len(self) == 1:
            self._prior = replace(self._prior, information=np.diag(np.full(6, 1.0 / START_VARIANCE)))
        if len(self) > self._size:
            self._marginalise_oldest()

    def add_landmarks(
        self, left: Pyramid, new: HostedLandmarks, patches: Templates, uv: FloatArray, variance: FloatArray
    ) -> None:
        """Add the landmarks that the newest keyframe hosts, once per keyframe.

        Args:
            left: Left pyramid of the keyframe.
            new: M landmarks.
            patches: Their templates at full size.
            uv: `(M, 4)` where the keyframe itself observes them.
            variance: `(M, 2, 3)` of these.
        """
        self.hosted = self.hosted.with_more(new)
        self._patches[-1] = HostPatches(new.uv, patches, left.levels[1:])
        self.observations = self.observations.with_landmarks(uv, variance)

    def adjust(self, iterations: int) -> None:
        """Adjust all keyframes and landmarks together."""
        result = adjust(self._problem(), self._prior, iterations)
        self.keyframes = result.keyframes
        self.hosted = replace(self.hosted, uv_inverse_depth=result.uv_inverse_depth, covariance=result.covariance)
        self.pose_covariance = result.pose_covariance
        self.right_offset = result.right_offset
        self.drift = self._drift()

    def shift_right_observations(self, columns: float) -> None:
        """Move all right positions as by a yaw of the right camera, by `columns` pixels at the image centre."""
        if columns != 0.0:
            self.observations = self.observations.shifted_right(columns, self._camera)

    def _problem(self) -> BundleProblem:
        hosted, seen = self.hosted, self.observations
        landmarks = (hosted.host, hosted.uv_inverse_depth, seen.uv, seen.variance)
        return BundleProblem(self.keyframes, *landmarks, self._camera)

    def _marginalise_oldest(self) -> None:
        """Turn the information of the oldest keyframe and its landmarks about the others into the prior."""
        self._prior = marginalise_oldest(self._problem(), self._prior)
        self.keyframes = self._prior.keyframes
        self.observations = self.observations.without_oldest(self.hosted.host > 0)
        self.hosted = self.hosted.without_oldest_host()
        del self._patches[0]


def _with_pose(poses: Poses, pose: Pose) -> Poses:
    return Poses(*(np.concatenate((array, one[None])) for array, one in zip(poses, pose, strict=True)))
