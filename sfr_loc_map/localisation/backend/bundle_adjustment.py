"""Adjustment of a window of keyframes and landmarks (bundle adjustment with a prior from what left the window).

A landmark is a host pixel and its inverse depth: a stereo measurement is linear in it, and it may be infinitely far.
Landmarks are eliminated by the Schur complement (Triggs et al. 2000); keyframes that leave are marginalised, so that
their information stays (Leutenegger et al. 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.small_linalg import inverse, turned
from sfr_loc_map.jit import jit_fast
from sfr_loc_map.localisation.backend.projection import linearise_landmark
from sfr_loc_map.localisation.parallel import both

KERNEL = 6.0
"""Squared Mahalanobis residual of a position at which its weight has fallen to a quarter (Geman-McClure)."""


@jit_fast
def _linearise(  # noqa: C901 - one loop of machine code
    rotations: FloatArray,
    positions: FloatArray,
    host: NDArray[np.int64],
    uvrho: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    only_host: int,
    inverses: FloatArray,
    right_side: FloatArray,
    coupling: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Linearise landmarks and eliminate them.

    The unknowns are the poses (position and rotation about the world's axes) and, last, by how many pixels all
    positions in right pictures lie too far right: an error of calibration that no landmark shows alone, but all of them
    together do where depths differ, as their depths by motion must agree with those by stereo.

    Args:
        rotations: `(K, 3, 3)` cameras to world.
        positions: `(K, 3)` metres.
        host: `(N,)` int64, keyframe of each landmark, before all others that see it.
        uvrho: `(N, 3)` host pixel and inverse depth.
        observed: `(N, K, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(N, K, 2, 3)` uu, uv, vv, px^2.
        camera: `(4,)` fx, fy, cx, cy.
        baseline: Metres.
        only_host: Take only the landmarks of this keyframe; -1 for all.
        inverses: `(N, 3, 3)`, filled with the inverse of each landmark's own block.
        right_side: `(N, 3)`, filled with its right side.
        coupling: `(N, 3, 6 K + 1)`, filled with its coupling to the other unknowns.

    Returns:
        Upper half of the reduced normal matrix `(6 K + 1, 6 K + 1)` and its right side `(6 K + 1,)`.
    """
    count, window = observed.shape[0], observed.shape[1]
    last = 6 * window
    size = last + 1
    h, g = np.zeros((size, size)), np.zeros(size)
    inverses[:], right_side[:], coupling[:] = 0.0, 0.0, 0.0
    j_mark, out = np.zeros((4, 3)), np.zeros(4)
    j_pose, j_host = np.zeros((4, 6)), np.zeros((4, 6))
    ray, residual, columns = np.ones(3), np.zeros(2), np.zeros(size, np.int64)
    weighted = np.zeros((2, 15))
    reduced = np.zeros((3, size))
    for n in range(count):
        hk = host[n]
        if only_host >= 0 and hk != only_host:
            continue
        ll, rl, cl = np.zeros((3, 3)), right_side[n], coupling[n]
        ll[2, 2] = 1e-6  # a landmark that nothing is known of stays where it is
        ray[0], ray[1] = (uvrho[n, 0] - camera[2]) / camera[0], (uvrho[n, 1] - camera[3]) / camera[1]
        for a in range(6):
            columns[a] = 6 * hk + a
        used = 6
        own_h, own_g = 0.0, 0.0
        for k in range(window):
            left, right = not np.isnan(observed[n, k, 0]), not np.isnan(observed[n, k, 2])
            if not (left or right):
                continue
            z = linearise_landmark(
                rotations[k], positions[k], rotations[hk], positions[hk], ray, uvrho[n, 2], camera, baseline,
                out, j_pose, j_host, j_mark,
            )  # fmt: skip
            if z <= 0.0:
                continue
            if k != hk:
                for a in range(6):
                    columns[used + a] = 6 * k + a
                used += 6
            for side in range(2):
                if not (left if side == 0 else right):
                    continue
                i = 2 * side
                residual[0], residual[1] = observed[n, k, i] - out[i], observed[n, k, i + 1] - out[i + 1]
                uu, uv, vv = variance[n, k, side, 0], variance[n, k, side, 1], variance[n, k, side, 2]
                det = uu * vv - uv * uv
                i00, i01, i11 = vv / det, -uv / det, uu / det
                chi = i00 * residual[0] ** 2 + 2.0 * i01 * residual[0] * residual[1] + i11 * residual[1] ** 2
                weight = 1.0 / (1.0 + chi / KERNEL) ** 2
                for a in range(3):
                    p, q = weight * j_mark[i, a], weight * j_mark[i + 1, a]
                    weighted[0, 12 + a], weighted[1, 12 + a] = i00 * p + i01 * q, i01 * p + i11 * q
                    rl[a] += weighted[0, 12 + a] * residual[0] + weighted[1, 12 + a] * residual[1]
                    for b in range(3):
                        ll[a, b] += weighted[0, 12 + a] * j_mark[i, b] + weighted[1, 12 + a] * j_mark[i + 1, b]
                if side == 1:
                    p, q = weight * i00, weight * i01
                    own_h += p
                    own_g += p * residual[0] + q * residual[1]
                    for b in range(3):
                        cl[b, last] += p * j_mark[i, b] + q * j_mark[i + 1, b]
                    if k != hk:
                        for b in range(6):
                            h[6 * k + b, last] += p * j_pose[i, b] + q * j_pose[i + 1, b]
                            h[6 * hk + b, last] += p * j_host[i, b] + q * j_host[i + 1, b]
                if k == hk:
                    continue  # the host sees its landmarks where they are, wherever it is
                for a in range(6):
                    p, q = weight * j_pose[i, a], weight * j_pose[i + 1, a]
                    p, q = i00 * p + i01 * q, i01 * p + i11 * q
                    g[6 * k + a] += p * residual[0] + q * residual[1]
                    for b in range(3):
                        cl[b, 6 * k + a] += p * j_mark[i, b] + q * j_mark[i + 1, b]
                    for b in range(a, 6):
                        h[6 * k + a, 6 * k + b] += p * j_pose[i, b] + q * j_pose[i + 1, b]
                    p, q = weight * j_host[i, a], weight * j_host[i + 1, a]
                    p, q = i00 * p + i01 * q, i01 * p + i11 * q
                    g[6 * hk + a] += p * residual[0] + q * residual[1]
                    for b in range(3):
                        cl[b, 6 * hk + a] += p * j_mark[i, b] + q * j_mark[i + 1, b]
                    for b in range(a, 6):
                        h[6 * hk + a, 6 * hk + b] += p * j_host[i, b] + q * j_host[i + 1, b]
                    for b in range(6):
                        h[6 * hk + a, 6 * k + b] += p * j_pose[i, b] + q * j_pose[i + 1, b]
        li = inverse(ll)
        for i in range(3):
            for j in range(3):
                inverses[n, i, j] = li[i, j]
        if used == 6:  # only the host sees it
            continue
        columns[used] = last
        used += 1
        h[last, last] += own_h
        g[last] += own_g
        for m in range(used):
            a = columns[m]
            for i in range(3):
                reduced[i, a] = li[i, 0] * cl[0, a] + li[i, 1] * cl[1, a] + li[i, 2] * cl[2, a]
        for m in range(used):
            a = columns[m]
            g[a] -= reduced[0, a] * rl[0] + reduced[1, a] * rl[1] + reduced[2, a] * rl[2]
            for o in range(m, used):
                b = columns[o]
                h[a, b] -= cl[0, a] * reduced[0, b] + cl[1, a] * reduced[1, b] + cl[2, a] * reduced[2, b]
    return h, g


def linearise(
    rotations: FloatArray,
    positions: FloatArray,
    host: NDArray[np.int64],
    uvrho: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    only_host: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Linearise landmarks and eliminate them, each half in a thread of its own; arguments as `_linearise`.

    Returns:
        Reduced normal matrix and right side as `_linearise`; what it fills.
    """
    count, size = len(host), 6 * len(rotations) + 1
    filled = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3, size))

    def part(which: slice) -> tuple[FloatArray, FloatArray]:
        marks = (host[which], uvrho[which], observed[which], variance[which])
        outputs = (array[which] for array in filled)
        upper, g = _linearise(rotations, positions, *marks, camera, baseline, only_host, *outputs)
        return upper, g

    first, second = both(part, (slice(count // 2),), (slice(count // 2, None),))
    upper = first[0] + second[0]
    return upper + np.triu(upper, 1).T, first[1] + second[1], *filled


def right_offset(h: FloatArray, g: FloatArray) -> tuple[float, float]:
    """Return by how many pixels right pictures are off, and the variance of that, px^2, from `linearise`.

    A step falls short where weights are robust, by up to a third; what is left shows when this much is corrected.
    The poses are solved for as well, without what is known of them from before: that was found with the old offset.
    The variance is infinite where the window says nothing.
    """
    free = h[:-1, :-1] + np.diag(1e-9 + 1e-9 * np.diag(h)[:-1])  # the window as a whole may be anywhere
    solved = np.linalg.solve(free, np.column_stack((h[:-1, -1], g[:-1])))
    information = float(h[-1, -1] - h[-1, :-1] @ solved[:, 0])
    if not information > 1e-6:
        return 0.0, np.inf
    return float(g[-1] - h[-1, :-1] @ solved[:, 1]) / information, 1.0 / information


def pose_difference(
    rotations: FloatArray, positions: FloatArray, rotations_0: FloatArray, positions_0: FloatArray
) -> FloatArray:
    """Return how far poses are from where a prior was linearised, `(6 K,)`: metres and radians, world axes."""
    turn = rotations @ rotations_0.transpose(0, 2, 1)
    angles = 0.5 * np.stack(
        (turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]), axis=1
    )
    return np.concatenate((positions - positions_0, angles), axis=1).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Keyframes and landmarks after an adjustment.

    Attributes:
        rotations: `(K, 3, 3)` cameras to world.
        positions: `(K, 3)` metres.
        uvrho: `(N, 3)` host pixels and inverse depths.
        covariance: `(N, 3, 3)` of them, given the poses.
        pose_covariance: `(6 K, 6 K)` of all poses.
        right_offset: By how many pixels right pictures are off beyond what was said, and the variance of that, px^2.
    """

    rotations: FloatArray
    positions: FloatArray
    uvrho: FloatArray
    covariance: FloatArray
    pose_covariance: FloatArray
    right_offset: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the poses besides the landmarks in the window.

    Attributes:
        h: Normal matrix `(6 K, 6 K)`.
        g: Right side `(6 K,)` at the poses it was linearised at.
        rotations: `(K, 3, 3)` of these poses.
        positions: `(K, 3)` of these poses, metres.
    """

    h: FloatArray
    g: FloatArray
    rotations: FloatArray
    positions: FloatArray

    def right_side(self, rotations: FloatArray, positions: FloatArray) -> FloatArray:
        """Return the right side `(6 K,)` at other poses."""
        moved = pose_difference(rotations, positions, self.rotations, self.positions)
        return np.asarray(self.g - self.h @ moved)


def adjust(
    rotations: FloatArray,
    positions: FloatArray,
    host: NDArray[np.int64],
    uvrho: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    prior: Prior,
    rounds: int,
) -> Adjusted:
    """Adjust keyframes and landmarks by Gauss-Newton with robust weights; arguments as `linearise`."""
    for _ in range(rounds):
        system, g, inverses, right_side, coupling = linearise(
            rotations, positions, host, uvrho, observed, variance, camera, baseline, -1
        )
        h = system[:-1, :-1] + prior.h
        update = np.linalg.solve(h, g[:-1] + prior.right_side(rotations, positions))
        uvrho = uvrho + np.einsum("nij,nj->ni", inverses, right_side - coupling[:, :, :-1] @ update)
        step = update.reshape(-1, 6)
        positions = positions + step[:, :3]
        rotations = np.stack([turned(old, *angles) for old, angles in zip(rotations, step[:, 3:], strict=True)])
        if np.abs(update).max() < 1e-6:
            break
    covariance = np.asarray(np.linalg.inv(h), dtype=np.float64)
    return Adjusted(rotations, positions, uvrho, inverses, covariance, right_offset(system, g))
