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
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.parallel import both
from sfr_loc_map.localisation.projection import HOST, LANDMARK, TARGET, UNKNOWNS, Projection, linearise_landmark

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


class _Residual(NamedTuple):
    """Residual of one position, its information, and its robust weight; `row` is its first row in the projection."""

    row: int
    u: float
    v: float
    uu: float
    uv: float
    vv: float
    weight: float


class _Workspace(NamedTuple):
    """Projection, information of a landmark `(3, 3)` and of the offset `(2,)`, columns `(S,)`, `(3, S)`, ray `(3,)`."""

    projection: Projection
    landmark: FloatArray
    offset: FloatArray
    columns: IntArray
    reduced: FloatArray
    ray: FloatArray


@jit_fast_inline
def _residual(observed: FloatArray, variance: FloatArray, n: int, k: int, side: int, uv: FloatArray) -> _Residual:
    """Return the residual of the left (0) or right (1) position of landmark n in keyframe k."""
    i = 2 * side
    u, v = observed[n, k, i] - uv[i], observed[n, k, i + 1] - uv[i + 1]
    var_u, cov, var_v = variance[n, k, side, 0], variance[n, k, side, 1], variance[n, k, side, 2]
    det = var_u * var_v - cov * cov
    i00, i01, i11 = var_v / det, -cov / det, var_u / det
    chi2 = i00 * u**2 + 2.0 * i01 * u * v + i11 * v**2
    return _Residual(i, u, v, i00, i01, i11, 1.0 / (1.0 + chi2 / KERNEL_CHI2) ** 2)


@jit_fast_inline
def _add_to_landmark(r: _Residual, j: FloatArray, information: FloatArray, rhs: FloatArray) -> None:
    i = r.row
    for a in range(3):
        p, q = r.weight * j[i, LANDMARK + a], r.weight * j[i + 1, LANDMARK + a]
        wu, wv = r.uu * p + r.uv * q, r.uv * p + r.vv * q
        rhs[a] += wu * r.u + wv * r.v
        for b in range(3):
            information[a, b] += wu * j[i, LANDMARK + b] + wv * j[i + 1, LANDMARK + b]


@jit_fast_inline
def _add_offset(
    r: _Residual, j: FloatArray, k: int, hk: int, h: FloatArray, coupling: FloatArray, offset: FloatArray
) -> None:
    """Add a right position to the terms of the right-image offset, the last unknown."""
    i, last = r.row, len(h) - 1
    p, q = r.weight * r.uu, r.weight * r.uv
    offset[0] += p
    offset[1] += p * r.u + q * r.v
    for b in range(3):
        coupling[b, last] += p * j[i, LANDMARK + b] + q * j[i + 1, LANDMARK + b]
    if k != hk:
        for b in range(6):
            h[6 * k + b, last] += p * j[i, TARGET + b] + q * j[i + 1, TARGET + b]
            h[6 * hk + b, last] += p * j[i, HOST + b] + q * j[i + 1, HOST + b]


@jit_fast_inline
def _add_poses(
    r: _Residual, j: FloatArray, k: int, hk: int, h: FloatArray, g: FloatArray, coupling: FloatArray
) -> None:
    """Add a position to the terms of the target keyframe k and the host keyframe hk."""
    i = r.row
    for a in range(6):
        p, q = r.weight * j[i, TARGET + a], r.weight * j[i + 1, TARGET + a]
        p, q = r.uu * p + r.uv * q, r.uv * p + r.vv * q
        g[6 * k + a] += p * r.u + q * r.v
        for b in range(3):
            coupling[b, 6 * k + a] += p * j[i, LANDMARK + b] + q * j[i + 1, LANDMARK + b]
        for b in range(a, 6):
            h[6 * k + a, 6 * k + b] += p * j[i, TARGET + b] + q * j[i + 1, TARGET + b]
        p, q = r.weight * j[i, HOST + a], r.weight * j[i + 1, HOST + a]
        p, q = r.uu * p + r.uv * q, r.uv * p + r.vv * q
        g[6 * hk + a] += p * r.u + q * r.v
        for b in range(3):
            coupling[b, 6 * hk + a] += p * j[i, LANDMARK + b] + q * j[i + 1, LANDMARK + b]
        for b in range(a, 6):
            h[6 * hk + a, 6 * hk + b] += p * j[i, HOST + b] + q * j[i + 1, HOST + b]
        for b in range(6):
            h[6 * hk + a, 6 * k + b] += p * j[i, TARGET + b] + q * j[i + 1, TARGET + b]


@jit_fast_inline
def _add_columns(columns: IntArray, used: int, k: int) -> int:
    """Append the columns of keyframe k; return the number of columns."""
    for a in range(6):
        columns[used + a] = 6 * k + a
    return used + 6


@jit_fast_inline
def _add_landmark(
    problem: BundleProblem, n: int, system: _System, rhs: FloatArray, coupling: FloatArray, work: _Workspace
) -> int:
    """Add all observations of a landmark; return the number of its pose unknowns, whose columns are filled."""
    observed, variance, camera, ray = problem.observations, problem.variance, problem.camera, work.ray
    keyframes, projection, columns, hk = problem.keyframes, work.projection, work.columns, problem.host[n]
    landmarks, rotations, positions = problem.uv_inverse_depth, keyframes.rotations, keyframes.positions
    h, g, j, uv = system.information, system.rhs, projection.jacobian, projection.uv
    information, offset = work.landmark, work.offset
    ray[0], ray[1] = (landmarks[n, 0] - camera.cx) / camera.fx, (landmarks[n, 1] - camera.cy) / camera.fy
    used = _add_columns(columns, 0, hk)
    for k in range(observed.shape[1]):
        left, right = not np.isnan(observed[n, k, 0]), not np.isnan(observed[n, k, 2])
        if not (left or right):
            continue
        target = Pose(rotations[k], positions[k])
        if linearise_landmark(target, keyframes, hk, ray, landmarks[n, 2], camera, projection) <= 0.0:
            continue
        if k != hk:
            used = _add_columns(columns, used, k)
        for side in range(2):
            if not (left if side == 0 else right):
                continue
            r = _residual(observed, variance, n, k, side, uv)
            _add_to_landmark(r, j, information, rhs)
            if side == 1:
                _add_offset(r, j, k, hk, h, coupling, offset)
            if k != hk:  # the host observes its landmarks where they are, wherever it is
                _add_poses(r, j, k, hk, h, g, coupling)
    return used


@jit_fast_inline
def _eliminate(
    covariance: FloatArray, rhs: FloatArray, coupling: FloatArray, used: int, system: _System, work: _Workspace
) -> None:
    """Subtract from the system what the elimination of a landmark leaves, in its first `used` columns."""
    h, g, columns, reduced = system.information, system.rhs, work.columns, work.reduced
    for m in range(used):
        a = columns[m]
        for i in range(3):
            reduced[i, a] = (
                covariance[i, 0] * coupling[0, a]
                + covariance[i, 1] * coupling[1, a]
                + covariance[i, 2] * coupling[2, a]
            )
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
    system = _System(h, g)
    covariance, rhs, coupling = blocks.covariance, blocks.rhs, blocks.coupling
    covariance[:], rhs[:], coupling[:] = 0.0, 0.0, 0.0
    projection = Projection(np.zeros(4), np.zeros((4, UNKNOWNS)))
    landmark, offset, columns = np.zeros((3, 3)), np.zeros(2), np.zeros(size, np.int64)
    work = _Workspace(projection, landmark, offset, columns, np.zeros((3, size)), np.ones(3))
    for n in range(len(problem.host)):
        if only_host >= 0 and problem.host[n] != only_host:
            continue
        landmark[:], offset[:] = 0.0, 0.0
        landmark[2, 2] = 1e-6  # an unobserved landmark stays where it is
        used = _add_landmark(problem, n, system, rhs[n], coupling[n], work)
        li = inverse(landmark)
        for i in range(3):
            for j in range(3):
                covariance[n, i, j] = li[i, j]
        if used == 6:  # only the host observes it
            continue
        columns[used] = last
        h[last, last] += offset[0]
        g[last] += offset[1]
        _eliminate(li, rhs[n], coupling[n], used + 1, system, work)
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
