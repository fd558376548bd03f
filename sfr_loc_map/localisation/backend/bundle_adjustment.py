"""Bundle adjustment of a window of keyframes and landmarks.

A prior holds the information of what has left the window: keyframes that leave are marginalised (Leutenegger et al.
2015).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.geometry.small_linalg import retract
from sfr_loc_map.localisation.backend.linearisation import BundleProblem, landmark_steps, linearise


class OffsetEstimate(NamedTuple):
    """Offset of positions in right images, to the right.

    Attributes:
        px: Pixels.
        variance: Of it, px^2; infinite where the window says nothing.
    """

    px: float
    variance: float


@dataclass(frozen=True, slots=True, eq=False)
class BundleAdjustmentResult:
    """Keyframes and landmarks after an adjustment.

    Attributes:
        keyframes: `(K,)` left cameras.
        uv_inverse_depth: `(N, 3)` host pixels and inverse depths, px and 1/m.
        covariance: `(N, 3, 3)` of them, given the poses.
        pose_covariance: `(6 K, 6 K)` of all poses, position and rotation about the world's axes.
        right_offset: Offset of right positions beyond what was corrected.
    """

    keyframes: Poses
    uv_inverse_depth: FloatArray
    covariance: FloatArray
    pose_covariance: FloatArray
    right_offset: OffsetEstimate


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the poses besides the landmarks in the window.

    Attributes:
        information: `(6 K, 6 K)`.
        information_vector: `(6 K,)`, right-hand side at the poses it was linearised at.
        keyframes: `(K,)` these poses.
    """

    information: FloatArray
    information_vector: FloatArray
    keyframes: Poses

    def rhs(self, keyframes: Poses) -> FloatArray:
        """Return the right-hand side `(6 K,)` at other poses."""
        return np.asarray(self.information_vector - self.information @ pose_difference(keyframes, self.keyframes))


def pose_difference(poses: Poses, reference: Poses) -> FloatArray:
    """Return how far poses are from others, `(6 K,)`: metres and radians, world axes."""
    rotation = poses.rotations @ reference.rotations.transpose(0, 2, 1)
    angles = 0.5 * np.stack(
        (
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ),
        axis=1,
    )
    return np.concatenate((poses.positions - reference.positions, angles), axis=1).ravel()


def right_image_offset(information: FloatArray, rhs: FloatArray) -> OffsetEstimate:
    """Return the offset of right positions, from the normal equations of `linearise`.

    A step falls short where weights are robust, by up to a third; the rest shows when this much is corrected.
    The poses are solved for as well, without the prior: that was estimated with the old offset.
    """
    poses = information[:-1, :-1]
    free = poses + np.diag(1e-9 + 1e-9 * np.diag(poses))  # the window as a whole may be anywhere
    solved = np.linalg.solve(free, np.column_stack((information[:-1, -1], rhs[:-1])))
    own = float(information[-1, -1] - information[-1, :-1] @ solved[:, 0])
    if not own > 1e-6:
        return OffsetEstimate(0.0, np.inf)
    return OffsetEstimate(float(rhs[-1] - information[-1, :-1] @ solved[:, 1]) / own, 1.0 / own)


def adjust(problem: BundleProblem, prior: Prior, iterations: int) -> BundleAdjustmentResult:
    """Adjust keyframes and landmarks by at most so many Gauss-Newton iterations with robust weights."""
    for _ in range(iterations):
        keyframes = problem.keyframes
        system, rhs, blocks = linearise(problem)
        information = system[:-1, :-1] + prior.information
        update = np.asarray(np.linalg.solve(information, rhs[:-1] + prior.rhs(keyframes)), dtype=np.float64)
        landmarks, covariance = problem.uv_inverse_depth + landmark_steps(problem, blocks, update), blocks.covariance
        del blocks  # the largest arrays of a keyframe: those of the next iteration take their place
        step = update.reshape(-1, 6)
        rotations = [retract(old, *angles) for old, angles in zip(keyframes.rotations, step[:, 3:], strict=True)]
        problem = problem._replace(
            keyframes=Poses(np.stack(rotations), keyframes.positions + step[:, :3]),
            uv_inverse_depth=landmarks,
        )
        if np.abs(update).max() < 1e-6:
            break
    return BundleAdjustmentResult(
        problem.keyframes,
        problem.uv_inverse_depth,
        covariance,
        np.asarray(np.linalg.inv(information), dtype=np.float64),
        right_image_offset(system, rhs),
    )


def marginalise_oldest(problem: BundleProblem, prior: Prior) -> Prior:
    """Return the prior of all keyframes but the oldest: what it, its landmarks and the old prior say of the others."""
    system, vector, _ = linearise(problem.landmarks(problem.host == 0))
    h = system[:-1, :-1] + prior.information
    g = vector[:-1] + prior.rhs(problem.keyframes)
    gain = np.linalg.solve(h[:6, :6], h[:6, 6:]).T
    rest = h[6:, 6:] - gain @ h[:6, 6:]
    keyframes = Poses(*(array[1:].copy() for array in problem.keyframes))
    return Prior(0.5 * (rest + rest.T), g[6:] - gain @ g[:6], keyframes)
