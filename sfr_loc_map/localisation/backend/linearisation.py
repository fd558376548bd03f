"""Normal equations of a window of keyframes and landmarks, with the landmarks eliminated.

A landmark is a host pixel and its inverse depth: a stereo measurement is linear in it, and it may be infinitely far.
Landmarks are eliminated by the Schur complement (Triggs et al. 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.small_linalg import inverse
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.parallel import both
from sfr_loc_map.localisation.projection import Intrinsics, Projection, intrinsics, linearise_landmark, new_projection

KERNEL_CHI2 = 6.0
"""Squared Mahalanobis residual of a position at which its weight has fallen to a quarter (Geman-McClure)."""
ALL_HOSTS = -1


class BundleProblem(NamedTuple):
    """K keyframes and N landmarks with their observations.

    Attributes:
        keyframes: `(K,)` left cameras.
        host: `(N,)` keyframe of each landmark, before all others that observe it.
        uv_inverse_depth: `(N, 3)` host pixel and inverse depth, px and 1/m.
        observations: `(N, K, 4)` u, v left, u, v right, pixels; NaN where not observed.
        variance: `(N, K, 2, 3)` uu, uv, vv in the left and the right image, px^2.
        camera: Camera of all keyframes.
    """

    keyframes: Poses
    host: IntArray
    uv_inverse_depth: FloatArray
    observations: FloatArray
    variance: FloatArray
    camera: StereoCamera


class LandmarkBlocks(NamedTuple):
    """What the elimination of N landmarks leaves, for S other unknowns.

    Attributes:
        covariance: `(N, 3, 3)` of each landmark given the other unknowns.
        rhs: `(N, 3)` right-hand side.
        coupling: `(N, 3, S)` to the other unknowns.
    """

    covariance: FloatArray
    rhs: FloatArray
    coupling: FloatArray


class _System(NamedTuple):
    """Upper half of the normal matrix `(S, S)` of poses and right-image offset, and right-hand side `(S,)`."""

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
    """Arrays that all landmarks share: residual `(2,)`, weighted Jacobian `(2, 3)`, columns `(S,)`, ray `(3,)`.

    `reduced` `(3, S)` is a landmark's covariance times its coupling. What is read from an array the compiler takes as
    it is: scalars in place of `residual` and `weighted` would be summed in another order.
    """

    projection: Projection
    residual: FloatArray
    weighted: FloatArray
    columns: IntArray
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
    return _Residual(i, residual, i00, i01, i11, 1.0 / (1.0 + chi2 / KERNEL_CHI2) ** 2)


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
def _add_offset(
    r: _Residual, projection: Projection, k: int, hk: int, h: FloatArray, coupling: FloatArray
) -> tuple[float, float]:
    """Add a right position to the coupling of the right-image offset; return the offset's information and rhs."""
    i, last, residual = r.row, len(h) - 1, r.px
    j_pose, j_host, j_mark = projection.by_target, projection.by_host, projection.by_landmark
    p, q = r.weight * r.uu, r.weight * r.uv
    for b in range(3):
        coupling[b, last] += p * j_mark[i, b] + q * j_mark[i + 1, b]
    if k != hk:
        for b in range(6):
            h[6 * k + b, last] += p * j_pose[i, b] + q * j_pose[i + 1, b]
            h[6 * hk + b, last] += p * j_host[i, b] + q * j_host[i + 1, b]
    return p, p * residual[0] + q * residual[1]


@jit_fast_ir_inline
def _add_pose_row(
    r: _Residual, a: int, j: FloatArray, k: int, j_mark: FloatArray, system: _System, coupling: FloatArray
) -> tuple[float, float]:
    """Add a position to the terms of unknown a of keyframe k alone; return its weighted Jacobian by that unknown."""
    i, h, g, residual = r.row, system.information, system.rhs, r.px
    p, q = r.weight * j[i, a], r.weight * j[i + 1, a]
    p, q = r.uu * p + r.uv * q, r.uv * p + r.vv * q
    g[6 * k + a] += p * residual[0] + q * residual[1]
    for b in range(3):
        coupling[b, 6 * k + a] += p * j_mark[i, b] + q * j_mark[i + 1, b]
    for b in range(a, 6):
        h[6 * k + a, 6 * k + b] += p * j[i, b] + q * j[i + 1, b]
    return p, q


@jit_fast_ir_inline
def _add_poses(r: _Residual, projection: Projection, k: int, hk: int, system: _System, coupling: FloatArray) -> None:
    """Add a position to the terms of the target keyframe k and the host keyframe hk."""
    j_pose, j_host, j_mark = projection.by_target, projection.by_host, projection.by_landmark
    i, h = r.row, system.information
    for a in range(6):
        _add_pose_row(r, a, j_pose, k, j_mark, system, coupling)
        p, q = _add_pose_row(r, a, j_host, hk, j_mark, system, coupling)
        for b in range(6):
            h[6 * hk + a, 6 * k + b] += p * j_pose[i, b] + q * j_pose[i + 1, b]


@jit_fast_ir_inline
def _add_columns(columns: IntArray, used: int, k: int) -> int:
    """Append the columns of keyframe k; return the number of columns."""
    for a in range(6):
        columns[used + a] = 6 * k + a
    return used + 6


@jit_fast_ir_inline
def _add_landmark(
    problem: BundleProblem, n: int, camera: Intrinsics, system: _System, own: _LandmarkBlock, work: _Workspace
) -> tuple[int, float, float]:
    """Add all observations of a landmark; return its number of columns, and the offset's information and rhs."""
    observed, ray = problem.observations, work.ray
    keyframes, projection, columns, hk = problem.keyframes, work.projection, work.columns, problem.host[n]
    landmarks, coupling, h = problem.uv_inverse_depth, own.coupling, system.information
    rotations, positions = keyframes.rotations, keyframes.positions
    ray[0], ray[1] = (
        (landmarks[n, 0] - camera.centre[0]) / camera.focal[0],
        (landmarks[n, 1] - camera.centre[1]) / camera.focal[1],
    )
    used = _add_columns(columns, 0, hk)
    offset_information, offset_rhs = 0.0, 0.0
    for k in range(observed.shape[1]):
        left, right = not np.isnan(observed[n, k, 0]), not np.isnan(observed[n, k, 2])
        if not (left or right):
            continue
        pose = Pose(rotations[k], positions[k])
        if linearise_landmark(pose, keyframes, hk, ray, landmarks[n, 2], camera, projection) <= 0.0:
            continue
        if k != hk:
            used = _add_columns(columns, used, k)
        for side in range(2):
            if not (left if side == 0 else right):
                continue
            r = _residual(problem, n, k, side, work)
            _add_to_landmark(r, projection.by_landmark, work.weighted, own)
            if side == 1:
                p, q = _add_offset(r, projection, k, hk, h, coupling)
                offset_information += p
                offset_rhs += q
            if k != hk:  # the host observes its landmarks where they are, wherever it is
                _add_poses(r, projection, k, hk, system, coupling)
    return used, offset_information, offset_rhs


@jit_fast_ir_inline
def _eliminate(
    li: FloatArray, own: _LandmarkBlock, used: int, columns: IntArray, reduced: FloatArray, system: _System
) -> None:
    """Subtract what the elimination of a landmark of covariance `li` leaves, in its first `used` columns."""
    h, g, rhs, coupling = system.information, system.rhs, own.rhs, own.coupling
    for m in range(used):
        a = columns[m]
        for i in range(3):
            reduced[i, a] = li[i, 0] * coupling[0, a] + li[i, 1] * coupling[1, a] + li[i, 2] * coupling[2, a]
    for m in range(used):
        a = columns[m]
        g[a] -= reduced[0, a] * rhs[0] + reduced[1, a] * rhs[1] + reduced[2, a] * rhs[2]
        for o in range(m, used):
            b = columns[o]
            h[a, b] -= coupling[0, a] * reduced[0, b] + coupling[1, a] * reduced[1, b] + coupling[2, a] * reduced[2, b]


@jit_fast
def _linearise(problem: BundleProblem, only_host: int, blocks: LandmarkBlocks) -> tuple[FloatArray, FloatArray]:
    """Linearise landmarks and eliminate them; fill their blocks.

    Returns:
        Upper half of the reduced normal matrix `(6 K + 1, 6 K + 1)` and its right-hand side `(6 K + 1,)`.
    """
    last = 6 * problem.observations.shape[1]
    size = last + 1
    h, g = np.zeros((size, size)), np.zeros(size)
    covariance, rhs, coupling, host = blocks.covariance, blocks.rhs, blocks.coupling, problem.host
    covariance[:], rhs[:], coupling[:] = 0.0, 0.0, 0.0
    projection, camera = new_projection(), intrinsics(problem.camera)
    columns, reduced = np.zeros(size, np.int64), np.zeros((3, size))
    work = _Workspace(projection, np.zeros(2), np.zeros((2, 3)), columns, reduced, np.ones(3))
    system = _System(h, g)
    for n in range(len(host)):
        if only_host >= 0 and host[n] != only_host:
            continue
        own = _LandmarkBlock(np.zeros((3, 3)), rhs[n], coupling[n])
        own.information[2, 2] = 1e-6  # an unobserved landmark stays where it is
        used, offset_information, offset_rhs = _add_landmark(problem, n, camera, system, own, work)
        li = inverse(own.information)
        for i in range(3):
            for j in range(3):
                covariance[n, i, j] = li[i, j]
        if used == 6:  # only the host observes it
            continue
        columns[used] = last
        h[last, last] += offset_information
        g[last] += offset_rhs
        _eliminate(li, own, used + 1, columns, reduced, system)
    return h, g


def linearise(problem: BundleProblem, only_host: int = ALL_HOSTS) -> tuple[FloatArray, FloatArray, LandmarkBlocks]:
    """Linearise landmarks and eliminate them, each half in a thread of its own.

    The unknowns are the poses (position and rotation about the world's axes) and, last, by how many pixels all
    positions in right images lie too far right: a calibration error that no single landmark shows, but all of them
    together do where depths differ, as their depths by motion must agree with those by stereo.

    Args:
        problem: K keyframes and N landmarks.
        only_host: Take only the landmarks of this keyframe.

    Returns:
        Reduced normal matrix `(6 K + 1, 6 K + 1)`, its right-hand side `(6 K + 1,)`, and the blocks of the landmarks.
    """
    count, size = len(problem.host), 6 * len(problem.keyframes.rotations) + 1
    blocks = LandmarkBlocks(np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3, size)))

    def part(which: slice) -> tuple[FloatArray, FloatArray]:
        some = problem._replace(
            host=problem.host[which],
            uv_inverse_depth=problem.uv_inverse_depth[which],
            observations=problem.observations[which],
            variance=problem.variance[which],
        )
        return _linearise(some, only_host, LandmarkBlocks(*(array[which] for array in blocks)))

    first, second = both(part, (slice(count // 2),), (slice(count // 2, None),))
    upper = first[0] + second[0]
    return upper + np.triu(upper, 1).T, first[1] + second[1], blocks
