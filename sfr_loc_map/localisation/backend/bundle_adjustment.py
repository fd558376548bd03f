"""Bundle adjustment of a window of keyframes and landmarks.

A prior holds the information of what has left the window: keyframes that leave are marginalised (Leutenegger et al.
2015).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.small_linalg import fill_inverse_3, retract
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.projection import (
    Intrinsics,
    StereoProjection,
    intrinsics,
    linearise_in_host,
    linearise_landmark,
    new_projection,
)
from sfr_loc_map.localisation.frontend.robust_weights import geman_mcclure_weight
from sfr_loc_map.localisation.parallel import both


def motions_by_poses(keyframes: Poses) -> FloatArray:
    """Return how the motions of K keyframes against each host follow from the poses, `(K, 6 K + 1, 6 K + 1)`.

    What a keyframe sees stays where it is if the host moves as if the keyframe were fixed to it. A pose is a position
    and a rotation about the world's axes; the last unknown, which is no pose, follows from itself.
    """
    count = len(keyframes.positions)
    crosses = -np.cross(keyframes.positions[:, None], np.eye(3))
    out = np.tile(np.eye(6 * count + 1), (count, 1, 1))
    for h, cross in enumerate(crosses):
        by_host = out[h, :-1, 6 * h : 6 * h + 6].reshape(count, 6, 6)
        by_host[:] = -np.eye(6)
        by_host[:, :3, 3:] = crosses - cross
        by_host[h] = 0.0
    return out


KERNEL_CHI2 = 6.0
"""Squared Mahalanobis residual of a position at which its weight has fallen to a quarter (Geman-McClure)."""


class BundleProblem(NamedTuple):
    """K keyframes and N landmarks with their observations."""

    keyframes: Poses  #: `(K,)` left cameras.
    host: IntArray  #: `(N,)` keyframe of each landmark, before all others that observe it.
    uv_inverse_depth: FloatArray  #: `(N, 3)` host pixel and inverse depth, px and 1/m.
    observations: FloatArray  #: `(N, K, 4)` u, v left, u, v right, pixels; NaN where not observed.
    variance: FloatArray  #: `(N, K, 2, 3)` uu, uv, vv in the left and the right image, px^2.
    camera: StereoCamera  #: Camera of all keyframes.

    def landmarks(self, which: slice | Mask) -> BundleProblem:
        """Return the problem of some of the landmarks."""
        return self._replace(
            host=self.host[which],
            uv_inverse_depth=self.uv_inverse_depth[which],
            observations=self.observations[which],
            variance=self.variance[which],
        )


class LandmarkBlocks(NamedTuple):
    """What the elimination of N landmarks leaves, for S other unknowns."""

    covariance: FloatArray  #: `(N, 3, 3)` of each landmark given the other unknowns.
    rhs: FloatArray  #: `(N, 3)` right-hand side.
    coupling: FloatArray  #: `(N, 3, S)` to the motions of the keyframes against the landmark's host, and to the offset.


class _System(NamedTuple):
    """Upper half of a normal matrix `(S, S)` of motions and right-image offset, and right-hand side `(S,)`."""

    information: FloatArray
    rhs: FloatArray


class _LandmarkBlock(NamedTuple):
    """Information `(3, 3)` of one landmark, right-hand side `(3,)`, and coupling `(3, S)` to the other unknowns."""

    information: FloatArray
    rhs: FloatArray
    coupling: FloatArray


class _Residual(NamedTuple):
    """Residual `(2,)` of one position, its information, and robust weight; `row` is its first in the projection."""

    row: int
    px: FloatArray
    uu: float
    uv: float
    vv: float
    weight: float


class _Workspace(NamedTuple):
    """Arrays that all landmarks share: residual `(2,)`, weighted Jacobian `(2, 3)`, keyframes `(K,)`, ray `(3,)`.

    `reduced` `(3, S)` is a landmark's covariance times its coupling. What is read from an array the compiler takes as
    it is: scalars in place of `residual` and `weighted` would be summed in another order.
    """

    projection: StereoProjection
    residual: FloatArray
    weighted: FloatArray
    keyframes: IntArray
    reduced: FloatArray
    ray: FloatArray


@jit_fast_ir_inline
def _residual(problem: BundleProblem, n: int, k: int, side: int, work: _Workspace) -> _Residual:
    """Return the residual of the left (0) or right (1) position of landmark n in keyframe k."""
    observed, variance, out, residual = problem.observations, problem.variance, work.projection.uv, work.residual
    i = 2 * side
    residual[0], residual[1] = observed[n, k, i] - out[i], observed[n, k, i + 1] - out[i + 1]
    uu, uv, vv = variance[n, k, side, 0], variance[n, k, side, 1], variance[n, k, side, 2]
    det = uu * vv - uv * uv
    i00, i01, i11 = vv / det, -uv / det, uu / det
    chi2 = i00 * residual[0] ** 2 + 2.0 * i01 * residual[0] * residual[1] + i11 * residual[1] ** 2
    return _Residual(i, residual, i00, i01, i11, geman_mcclure_weight(chi2, KERNEL_CHI2))


@jit_fast_ir_inline
def _add_to_landmark(r: _Residual, j: FloatArray, weighted: FloatArray, own: _LandmarkBlock) -> None:
    i, residual, information, rhs = r.row, r.px, own.information, own.rhs
    for a in range(3):
        p, q = r.weight * j[i, a], r.weight * j[i + 1, a]
        weighted[0, a], weighted[1, a] = r.uu * p + r.uv * q, r.uv * p + r.vv * q
        rhs[a] += weighted[0, a] * residual[0] + weighted[1, a] * residual[1]
        for b in range(3):
            information[a, b] += weighted[0, a] * j[i, b] + weighted[1, a] * j[i + 1, b]


@jit_fast_ir_inline
def _add_offset(r: _Residual, j_mark: FloatArray, coupling: FloatArray, last: int) -> tuple[float, float]:
    """Add a right position to the coupling of the right-image offset; return the offset's information and rhs."""
    i, residual = r.row, r.px
    p, q = r.weight * r.uu, r.weight * r.uv
    for b in range(3):
        coupling[b, last] += p * j_mark[i, b] + q * j_mark[i + 1, b]
    return p, p * residual[0] + q * residual[1]


@jit_fast_ir_inline
def _add_motion(r: _Residual, projection: StereoProjection, k: int, system: _System, coupling: FloatArray) -> None:
    """Add a position to the terms of the motion of keyframe k."""
    i, h, g, residual = r.row, system.information, system.rhs, r.px
    j, j_mark, first, last = projection.by_target, projection.by_landmark, 6 * k, len(g) - 1
    for a in range(6):
        p, q = r.weight * j[i, a], r.weight * j[i + 1, a]
        p, q = r.uu * p + r.uv * q, r.uv * p + r.vv * q
        g[first + a] += p * residual[0] + q * residual[1]
        for b in range(3):
            coupling[b, first + a] += p * j_mark[i, b] + q * j_mark[i + 1, b]
        for b in range(a, 6):
            h[first + a, first + b] += p * j[i, b] + q * j[i + 1, b]
        if i == 2:
            h[first + a, last] += p


@jit_fast_ir_inline
def _add_landmark(
    problem: BundleProblem, n: int, camera: Intrinsics, system: _System, own: _LandmarkBlock, work: _Workspace
) -> tuple[int, float, float]:
    """Add all observations of a landmark; return how many keyframes but its host see it, and the offset's terms."""
    observed, ray, seen_by = problem.observations, work.ray, work.keyframes
    keyframes, projection, hk = problem.keyframes, work.projection, problem.host[n]
    landmarks, coupling = problem.uv_inverse_depth, own.coupling
    rotations, positions = keyframes.rotations, keyframes.positions
    ray[0] = (landmarks[n, 0] - camera.centre[0]) / camera.focal[0]
    ray[1] = (landmarks[n, 1] - camera.centre[1]) / camera.focal[1]
    count, offset_information, offset_rhs = 0, 0.0, 0.0
    for k in range(observed.shape[1]):
        left, right = not np.isnan(observed[n, k, 0]), not np.isnan(observed[n, k, 2])
        if not (left or right):
            continue
        if k == hk:
            linearise_in_host(landmarks[n], camera, projection)
        else:
            pose = Pose(rotations[k], positions[k])
            if linearise_landmark(pose, keyframes, hk, ray, landmarks[n, 2], camera, projection) <= 0.0:
                continue
            seen_by[count] = k
            count += 1
        for side in range(2):
            if not (left if side == 0 else right):
                continue
            r = _residual(problem, n, k, side, work)
            _add_to_landmark(r, projection.by_landmark, work.weighted, own)
            if side == 1:
                p, q = _add_offset(r, projection.by_landmark, coupling, len(system.rhs) - 1)
                offset_information += p
                offset_rhs += q
            if k != hk:  # the host observes its landmarks where they are, wherever it is
                _add_motion(r, projection, k, system, coupling)
    return count, offset_information, offset_rhs


@jit_fast_ir_inline
def _eliminate(li: FloatArray, own: _LandmarkBlock, count: int, work: _Workspace, system: _System) -> None:
    """Subtract what the elimination of a landmark of covariance `li` leaves, for the keyframes that see it."""
    h, g, rhs, coupling = system.information, system.rhs, own.rhs, own.coupling
    seen_by, reduced, last = work.keyframes, work.reduced, len(g) - 1
    for m in range(count):
        first = 6 * seen_by[m]
        for i in range(3):
            for a in range(first, first + 6):
                reduced[i, a] = li[i, 0] * coupling[0, a] + li[i, 1] * coupling[1, a] + li[i, 2] * coupling[2, a]
    for i in range(3):
        reduced[i, last] = li[i, 0] * coupling[0, last] + li[i, 1] * coupling[1, last] + li[i, 2] * coupling[2, last]
    for m in range(count):
        first = 6 * seen_by[m]
        for a in range(first, first + 6):
            p, q, r = coupling[0, a], coupling[1, a], coupling[2, a]
            g[a] -= reduced[0, a] * rhs[0] + reduced[1, a] * rhs[1] + reduced[2, a] * rhs[2]
            h[a, last] -= p * reduced[0, last] + q * reduced[1, last] + r * reduced[2, last]
            for o in range(m, count):
                for b in range(6 * seen_by[o], 6 * seen_by[o] + 6):
                    h[a, b] -= p * reduced[0, b] + q * reduced[1, b] + r * reduced[2, b]
    for i in range(3):
        g[last] -= reduced[i, last] * rhs[i]
        h[last, last] -= reduced[i, last] * coupling[i, last]


@jit_fast
def _linearise(problem: BundleProblem, blocks: LandmarkBlocks) -> tuple[FloatArray, FloatArray]:
    """Linearise landmarks and eliminate them; fill their blocks.

    Returns:
        Upper half of the reduced normal matrix `(K, 6 K + 1, 6 K + 1)` of each host's landmarks, and its right-hand
        side `(K, 6 K + 1)`; the lower half means nothing.
    """
    keyframes = problem.observations.shape[1]
    size = 6 * keyframes + 1
    h, g = np.zeros((keyframes, size, size)), np.zeros((keyframes, size))
    covariance, rhs, coupling, host = blocks.covariance, blocks.rhs, blocks.coupling, problem.host
    projection, camera = new_projection(), intrinsics(problem.camera)
    seen_by, reduced = np.zeros(keyframes, np.int64), np.zeros((3, size))
    work = _Workspace(projection, np.zeros(2), np.zeros((2, 3)), seen_by, reduced, np.ones(3))
    own_information = np.empty((3, 3))
    for n in range(len(host)):
        own = _LandmarkBlock(own_information, rhs[n], coupling[n])
        for i in range(3):
            for j in range(3):
                own_information[i, j] = 1e-6 if i == j else 0.0  # an unobserved landmark stays where it is
        system = _System(h[host[n]], g[host[n]])
        count, offset_information, offset_rhs = _add_landmark(problem, n, camera, system, own, work)
        fill_inverse_3(own.information, covariance[n])
        if count == 0:  # only the host observes it
            continue
        system.information[size - 1, size - 1] += offset_information
        system.rhs[size - 1] += offset_rhs
        _eliminate(covariance[n], own, count, work, system)
    return h, g


def linearise(problem: BundleProblem) -> tuple[FloatArray, FloatArray, LandmarkBlocks]:
    """Linearise landmarks and eliminate them, halves of the work in two threads.

    The unknowns are the poses (position and rotation about the world's axes) and, last, by how many pixels all
    positions in right images lie too far right: a calibration error that no single landmark shows, but all of them
    together do where depths differ, as their depths by motion must agree with those by stereo. Returns the reduced
    normal matrix `(6 K + 1, 6 K + 1)`, its right-hand side `(6 K + 1,)`, and the blocks of the landmarks.
    """
    count, size = len(problem.host), 6 * len(problem.keyframes.rotations) + 1
    blocks = LandmarkBlocks(np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3, size)))
    seen = np.cumsum(np.count_nonzero(np.isfinite(problem.observations[:, :, 0]), axis=1))
    middle = int(np.searchsorted(seen, seen[-1] // 2)) if count else 0  # old landmarks have been seen more often
    first, second = both(
        _linearise,
        *(
            (problem.landmarks(which), LandmarkBlocks(*(array[which] for array in blocks)))
            for which in (slice(middle), slice(middle, None))
        ),
    )
    # the normal equations of the poses, from those of the motions against each host, of which the upper half is right
    upper, rhs = first[0] + second[0], first[1] + second[1]
    to_motions = motions_by_poses(problem.keyframes)
    to_poses = to_motions.swapaxes(1, 2)
    information = np.triu(upper) + np.triu(upper, 1).swapaxes(1, 2)
    system = np.asarray((to_poses @ information @ to_motions).sum(axis=0))
    return system, np.asarray((to_poses @ rhs[:, :, None]).sum(axis=0)[:, 0]), blocks


class OffsetEstimate(NamedTuple):
    """Offset of positions in right images, to the right."""

    px: float  #: Pixels.
    variance: float  #: Of it, px^2; infinite where the window says nothing.


class Prior(NamedTuple):
    """What is known of the poses besides the landmarks in the window."""

    information: FloatArray  #: `(6 K, 6 K)`.
    information_vector: FloatArray  #: `(6 K,)`, right-hand side at the poses it was linearised at.
    keyframes: Poses  #: `(K,)` these poses.

    def rhs(self, keyframes: Poses) -> FloatArray:
        """Return the right-hand side `(6 K,)` at other poses."""
        rotation = keyframes.rotations @ self.keyframes.rotations.transpose(0, 2, 1)
        angles = 0.5 * np.stack(
            (
                rotation[:, 2, 1] - rotation[:, 1, 2],
                rotation[:, 0, 2] - rotation[:, 2, 0],
                rotation[:, 1, 0] - rotation[:, 0, 1],
            ),
            axis=1,
        )
        difference = np.concatenate((keyframes.positions - self.keyframes.positions, angles), axis=1).ravel()
        return np.asarray(self.information_vector - self.information @ difference)


class Adjustment(NamedTuple):
    """Keyframes and landmarks after an adjustment."""

    problem: BundleProblem  #: The same with the new poses and landmarks.
    covariance: FloatArray  #: `(N, 3, 3)` of the landmarks, given the poses.
    pose_covariance: FloatArray  #: `(6 K, 6 K)` of all poses, position and rotation about the world's axes.
    right_offset: OffsetEstimate  #: Offset of right positions beyond what was corrected.


def adjust(problem: BundleProblem, prior: Prior, iterations: int) -> Adjustment:
    """Adjust keyframes and landmarks by at most so many Gauss-Newton iterations with robust weights."""
    for _ in range(iterations):
        keyframes = problem.keyframes
        system, rhs, blocks = linearise(problem)
        information = system[:-1, :-1] + prior.information
        update = np.asarray(np.linalg.solve(information, rhs[:-1] + prior.rhs(keyframes)), dtype=np.float64)
        # the changes of the landmarks that belong to those of the poses
        motions = motions_by_poses(keyframes)[:, :-1, :-1] @ update
        of_marks = blocks.rhs - np.einsum("nij,nj->ni", blocks.coupling[:, :, :-1], motions[problem.host])
        covariance = blocks.covariance
        landmarks = problem.uv_inverse_depth + np.asarray(np.einsum("nij,nj->ni", covariance, of_marks))
        del blocks  # the largest arrays of a keyframe: those of the next iteration take their place
        step = update.reshape(-1, 6)
        rotations = [retract(old, *angles) for old, angles in zip(keyframes.rotations, step[:, 3:], strict=True)]
        problem = problem._replace(
            keyframes=Poses(np.stack(rotations), keyframes.positions + step[:, :3]), uv_inverse_depth=landmarks
        )
        if np.abs(update).max() < 1e-6:
            break
    pose_covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    # The offset of right positions. A step falls short where weights are robust, by up to a third; the rest shows when
    # this much is corrected. The poses are solved for as well, without the prior, which is of the old offset.
    poses = system[:-1, :-1]
    free = poses + np.diag(1e-9 + 1e-9 * np.diag(poses))  # the window as a whole may be anywhere
    solved = np.linalg.solve(free, np.column_stack((system[:-1, -1], rhs[:-1])))
    own, offset = float(system[-1, -1] - system[-1, :-1] @ solved[:, 0]), OffsetEstimate(0.0, np.inf)
    if own > 1e-6:
        offset = OffsetEstimate(float(rhs[-1] - system[-1, :-1] @ solved[:, 1]) / own, 1.0 / own)
    return Adjustment(problem, covariance, pose_covariance, offset)


def marginalise_oldest(problem: BundleProblem, prior: Prior) -> Prior:
    """Return the prior of all keyframes but the oldest: what it, its landmarks and the old prior say of the others."""
    system, vector, _ = linearise(problem.landmarks(problem.host == 0))
    h = system[:-1, :-1] + prior.information
    g = vector[:-1] + prior.rhs(problem.keyframes)
    gain = np.linalg.solve(h[:6, :6], h[:6, 6:]).T
    rest = h[6:, 6:] - gain @ h[:6, 6:]
    keyframes = Poses(*(array[1:].copy() for array in problem.keyframes))
    return Prior(0.5 * (rest + rest.T), g[6:] - gain @ g[:6], keyframes)
