"""Bundle adjustment of a window of keyframes and landmarks.

The unknowns are the poses of K keyframes (position and rotation about the world's axes), an offset of all right image
positions, and N landmarks. Each landmark is eliminated by its Schur complement (Triggs et al. 2000, section 6.1). The
observations of a landmark depend only on the motion of a keyframe relative to the landmark's host. The normal equations
are therefore summed per host in terms of these motions, and transformed to poses at the end.

A prior holds the information of marginalised keyframes, which have left the window (Leutenegger et al. 2015). The
information matrix of the prior is not linearised again, but all observations are linearised at the present poses.
First-estimate Jacobians are not used. `error_sources.ErrorSources` was tuned to the NEES of drives with this choice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.transform import symmetric
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.pose_solver import geman_mcclure_weight
from sfr_loc_map.localisation.frontend.projection import (
    Intrinsics,
    StereoProjection,
    intrinsics,
    linearise_in_host,
    linearise_landmark,
    new_projection,
)
from sfr_loc_map.localisation.small_linalg import fill_inverse_3, retract
from sfr_loc_map.parallel import both

ADJUSTMENT_SCALE = 6.0
"""Scale of the Geman-McClure weight: the squared Mahalanobis residual of a position (two degrees of freedom) at which
the weight is a quarter. A scale of 20 was tried: measurements/localiser_trials.md, "What limits it, and what was
tried"."""
LANDMARK_PRIOR = 1e-6
"""Value added to the diagonal of a landmark's information, 1/px^2 and m^2. An unobserved landmark keeps its value."""
GAUGE_PRIOR = 1e-9
"""Absolute and relative increase of the diagonal of the poses' information where the prior does not fix the pose of the
window (`_right_offset`). The increase makes the matrix positive definite. The absolute part corresponds to standard
deviations of 30 km in position and 3e4 rad in rotation, which have no effect. The relative part limits the condition
number to about 1e9, which leaves seven digits."""
MIN_OFFSET_INFORMATION = 1e-6
"""Minimum information of the right-image offset for an estimate, 1/px^2. The standard deviation is at most 1000 px."""
CONVERGED_STEP = 1e-6  #: Step of the poses, metres and radians, below which the iterations end.


class BundleProblem(NamedTuple):
    """K keyframes and N landmarks with their observations."""

    keyframes: Poses  #: `(K,)` left cameras.
    host: IntArray  #: `(N,)` index of each landmark's host, the first keyframe that observes the landmark.
    uv_inverse_depth: FloatArray  #: `(N, 3)` host pixel and inverse depth, px and 1/m.
    observations: FloatArray  #: `(N, K, 4)` u, v left, u, v right, pixels; NaN where not observed.
    variance: FloatArray  #: `(N, K, 2, 3)` uu, uv, vv in the left and the right image, px^2.
    camera: StereoCamera  #: Camera of all keyframes.

    def with_landmarks(self, chosen: slice | Mask) -> BundleProblem:
        """Return the problem with the chosen landmarks only."""
        return self._replace(
            host=self.host[chosen],
            uv_inverse_depth=self.uv_inverse_depth[chosen],
            observations=self.observations[chosen],
            variance=self.variance[chosen],
        )


class LandmarkBlocks(NamedTuple):
    """Blocks of the normal equations of N landmarks, with S other unknowns."""

    covariance: FloatArray  #: `(N, 3, 3)` covariance of each landmark given the other unknowns.
    rhs: FloatArray  #: `(N, 3)` right-hand side.
    #: `(N, 3, S)` coupling with the motions of the keyframes relative to the landmark's host, and with the offset.
    coupling: FloatArray


class NormalEquations(NamedTuple):
    """Normal equations of the poses and the right-image offset after the elimination of the landmarks."""

    information: FloatArray  #: `(6 K + 1, 6 K + 1)`.
    rhs: FloatArray  #: `(6 K + 1,)`.
    blocks: LandmarkBlocks  #: Blocks of the landmarks.
    motions_by_poses: FloatArray  #: `(K, 6 K + 1, 6 K + 1)` Jacobians of the motions relative to each host.


class _System(NamedTuple):
    """Normal equations of the motions relative to one host, with the right-image offset as the last unknown."""

    information: FloatArray  #: `(S, S)`, upper half.
    rhs: FloatArray  #: `(S,)`.


class _LandmarkBlock(NamedTuple):
    """Blocks of one landmark."""

    information: FloatArray  #: `(3, 3)`.
    rhs: FloatArray  #: `(3,)`.
    coupling: FloatArray  #: `(3, S)` coupling with the other unknowns.


class _Residual(NamedTuple):
    """Residual of one position with its robust weight."""

    row: int  #: First of the position's two rows in the projection: 0 left, 2 right.
    px: FloatArray  #: `(2,)` observation minus projection, pixels.
    uu: float  #: Information, 1/px^2.
    uv: float
    vv: float
    weight: float


class _OffsetTerms(NamedTuple):
    """Terms of the right-image offset in the normal equations."""

    information: float
    rhs: float


class _Landmark(NamedTuple):
    """Sums over the observations of a landmark."""

    observer_count: int  #: Number of keyframes except the host that observe the landmark.
    offset: _OffsetTerms


class _Workspace(NamedTuple):
    """Arrays that are reused for each landmark.

    The compiler may reorder sums, and the order depends on which values are read from arrays. Replacing `residual` and
    `weighted` by scalars would therefore change the results in the last digits.
    """

    projection: StereoProjection
    residual: FloatArray  #: `(2,)` pixels.
    weighted: FloatArray  #: `(2, 3)` weighted Jacobian with respect to the landmark.
    observers: IntArray  #: `(K,)` keyframes except the host that observe the landmark.
    reduced: FloatArray  #: `(3, S)` covariance of the landmark times its coupling.
    ray: FloatArray  #: `(3,)` host ray.


def motions_by_poses(keyframes: Poses) -> FloatArray:
    """Return the derivatives of the motions relative to each host with respect to the poses, `(K, 6 K + 1, 6 K + 1)`.

    The projection of a landmark does not change if keyframe and host move as one rigid body. The motion m of a keyframe
    k is therefore the change (t, w) of position and rotation, minus the change of a keyframe that is rigidly attached
    to the host h:

        m_t = t_k - t_h + [p_k - p_h]x w_h
        m_w = w_k - w_h

    with the positions p, and the matrix [a]x that maps b to a x b. The last unknown is the offset, which is left
    unchanged.
    """
    count = len(keyframes.positions)
    crosses = -np.cross(keyframes.positions[:, None], np.eye(3))  # [p]x of each keyframe
    motions = np.tile(np.eye(6 * count + 1), (count, 1, 1))
    for host, cross in enumerate(crosses):
        by_host = motions[host, :-1, 6 * host : 6 * host + 6].reshape(count, 6, 6)
        by_host[:] = -np.eye(6)
        by_host[:, :3, 3:] = crosses - cross
        by_host[host] = 0.0
    return motions


@jit_fast_ir_inline
def _residual(problem: BundleProblem, n: int, k: int, side: int, work: _Workspace) -> _Residual:
    """Return the residual of the left (0) or right (1) position of landmark n in keyframe k."""
    observed = problem.observations
    variance = problem.variance
    uv = work.projection.uv
    residual = work.residual
    row = 2 * side
    residual[0] = observed[n, k, row] - uv[row]
    residual[1] = observed[n, k, row + 1] - uv[row + 1]
    cov_uu, cov_uv, cov_vv = variance[n, k, side, 0], variance[n, k, side, 1], variance[n, k, side, 2]
    det = cov_uu * cov_vv - cov_uv * cov_uv
    info_uu = cov_vv / det
    info_uv = -cov_uv / det
    info_vv = cov_uu / det
    chi2 = info_uu * residual[0] ** 2 + 2.0 * info_uv * residual[0] * residual[1] + info_vv * residual[1] ** 2
    return _Residual(row, residual, info_uu, info_uv, info_vv, geman_mcclure_weight(chi2, ADJUSTMENT_SCALE))


@jit_fast_ir_inline
def _add_to_landmark(r: _Residual, jacobian: FloatArray, weighted: FloatArray, own: _LandmarkBlock) -> None:
    """Add an observed image position to the information matrix and the right-hand side of its landmark."""
    row = r.row
    residual = r.px
    information = own.information
    rhs = own.rhs
    for a in range(3):
        p = r.weight * jacobian[row, a]
        q = r.weight * jacobian[row + 1, a]
        weighted[0, a] = r.uu * p + r.uv * q
        weighted[1, a] = r.uv * p + r.vv * q
        rhs[a] += weighted[0, a] * residual[0] + weighted[1, a] * residual[1]
        for b in range(3):
            information[a, b] += weighted[0, a] * jacobian[row, b] + weighted[1, a] * jacobian[row + 1, b]


@jit_fast_ir_inline
def _add_offset(r: _Residual, by_landmark: FloatArray, coupling: FloatArray, last: int) -> _OffsetTerms:
    """Add an observation in the right image to the coupling with the right-image offset.

    Return the contribution of the observation to the offset terms.
    """
    row = r.row
    residual = r.px
    weighted_u = r.weight * r.uu
    weighted_v = r.weight * r.uv
    for b in range(3):
        coupling[b, last] += weighted_u * by_landmark[row, b] + weighted_v * by_landmark[row + 1, b]
    return _OffsetTerms(weighted_u, weighted_u * residual[0] + weighted_v * residual[1])


@jit_fast_ir_inline
def _add_motion(r: _Residual, projection: StereoProjection, k: int, system: _System, coupling: FloatArray) -> None:
    """Add a position to the terms of the motion of keyframe k."""
    row = r.row
    information = system.information
    rhs = system.rhs
    residual = r.px
    jacobian = projection.by_target
    by_landmark = projection.by_landmark
    first = 6 * k
    last = len(rhs) - 1
    for a in range(6):
        p = r.weight * jacobian[row, a]
        q = r.weight * jacobian[row + 1, a]
        weighted_u = r.uu * p + r.uv * q
        weighted_v = r.uv * p + r.vv * q
        rhs[first + a] += weighted_u * residual[0] + weighted_v * residual[1]
        for b in range(3):
            coupling[b, first + a] += weighted_u * by_landmark[row, b] + weighted_v * by_landmark[row + 1, b]
        for b in range(a, 6):
            information[first + a, first + b] += weighted_u * jacobian[row, b] + weighted_v * jacobian[row + 1, b]
        if row == 2:
            information[first + a, last] += weighted_u


@jit_fast_ir_inline
def _add_landmark(
    problem: BundleProblem, n: int, camera: Intrinsics, system: _System, own: _LandmarkBlock, work: _Workspace
) -> _Landmark:
    """Add all observations of a landmark to the system and to its own blocks."""
    observed = problem.observations
    landmarks = problem.uv_inverse_depth
    keyframes = problem.keyframes
    host = problem.host[n]
    ray = work.ray
    observers = work.observers
    projection = work.projection
    coupling = own.coupling
    rotations = keyframes.rotations
    positions = keyframes.positions
    ray[0] = (landmarks[n, 0] - camera.centre[0]) / camera.focal[0]
    ray[1] = (landmarks[n, 1] - camera.centre[1]) / camera.focal[1]
    count = 0
    offset_information = 0.0
    offset_rhs = 0.0
    for k in range(observed.shape[1]):
        in_left = not np.isnan(observed[n, k, 0])
        in_right = not np.isnan(observed[n, k, 2])
        if not (in_left or in_right):
            continue
        if k == host:
            linearise_in_host(landmarks[n], camera, projection)
        else:
            pose = Pose(rotations[k], positions[k])
            if linearise_landmark(pose, keyframes, host, ray, landmarks[n, 2], camera, projection) <= 0.0:
                continue
            observers[count] = k
            count += 1
        for side in range(2):
            if not (in_left if side == 0 else in_right):
                continue
            r = _residual(problem, n, k, side, work)
            _add_to_landmark(r, projection.by_landmark, work.weighted, own)
            if side == 1:
                offset = _add_offset(r, projection.by_landmark, coupling, len(system.rhs) - 1)
                offset_information += offset.information
                offset_rhs += offset.rhs
            if k != host:  # the host observes its landmarks at the same pixels, whatever its pose
                _add_motion(r, projection, k, system, coupling)
    return _Landmark(count, _OffsetTerms(offset_information, offset_rhs))


@jit_fast_ir_inline
def _eliminate(covariance: FloatArray, own: _LandmarkBlock, count: int, work: _Workspace, system: _System) -> None:
    """Eliminate a landmark: subtract its terms of the Schur complement from the system.

    The terms of the keyframes that observe the landmark, and of the right-image offset, are `B^T C B` and `B^T C r`,
    with covariance C, coupling B and right-hand side r of the landmark.
    """
    information = system.information
    rhs = system.rhs
    landmark_rhs = own.rhs
    coupling = own.coupling
    observers = work.observers
    reduced = work.reduced
    last = len(rhs) - 1
    for m in range(count):
        first = 6 * observers[m]
        for i in range(3):
            c0, c1, c2 = covariance[i, 0], covariance[i, 1], covariance[i, 2]
            for a in range(first, first + 6):
                reduced[i, a] = c0 * coupling[0, a] + c1 * coupling[1, a] + c2 * coupling[2, a]
    for i in range(3):
        c0, c1, c2 = covariance[i, 0], covariance[i, 1], covariance[i, 2]
        reduced[i, last] = c0 * coupling[0, last] + c1 * coupling[1, last] + c2 * coupling[2, last]
    for m in range(count):
        first = 6 * observers[m]
        for a in range(first, first + 6):
            p, q, r = coupling[0, a], coupling[1, a], coupling[2, a]
            rhs[a] -= (
                reduced[0, a] * landmark_rhs[0] + reduced[1, a] * landmark_rhs[1] + reduced[2, a] * landmark_rhs[2]
            )
            information[a, last] -= p * reduced[0, last] + q * reduced[1, last] + r * reduced[2, last]
            for o in range(m, count):
                for b in range(6 * observers[o], 6 * observers[o] + 6):
                    information[a, b] -= p * reduced[0, b] + q * reduced[1, b] + r * reduced[2, b]
    for i in range(3):
        rhs[last] -= reduced[i, last] * landmark_rhs[i]
        information[last, last] -= reduced[i, last] * coupling[i, last]


@jit_fast
def _linearise(problem: BundleProblem, blocks: LandmarkBlocks) -> tuple[FloatArray, FloatArray]:
    """Linearise the landmarks and eliminate them; fill their blocks.

    Returns:
        Upper half of the reduced normal matrix of the motions relative to each host, `(K, 6 K + 1, 6 K + 1)`, and its
        right-hand side `(K, 6 K + 1)`. The lower half is undefined.
    """
    keyframes = problem.observations.shape[1]
    size = 6 * keyframes + 1
    last = size - 1
    information = np.zeros((keyframes, size, size))
    system_rhs = np.zeros((keyframes, size))
    covariance = blocks.covariance
    rhs = blocks.rhs
    coupling = blocks.coupling
    host = problem.host
    projection = new_projection()
    camera = intrinsics(problem.camera)
    observers = np.zeros(keyframes, np.int64)
    reduced = np.zeros((3, size))
    work = _Workspace(projection, np.zeros(2), np.zeros((2, 3)), observers, reduced, np.ones(3))
    own_information = np.empty((3, 3))
    for n in range(len(host)):
        own = _LandmarkBlock(own_information, rhs[n], coupling[n])
        for i in range(3):
            for j in range(3):
                own_information[i, j] = LANDMARK_PRIOR if i == j else 0.0
        system = _System(information[host[n]], system_rhs[host[n]])
        landmark = _add_landmark(problem, n, camera, system, own, work)
        fill_inverse_3(own.information, covariance[n])
        if landmark.observer_count == 0:  # An observation by the host alone does not constrain motions.
            continue
        system.information[last, last] += landmark.offset.information
        system.rhs[last] += landmark.offset.rhs
        _eliminate(covariance[n], own, landmark.observer_count, work, system)
    return information, system_rhs


def linearise(problem: BundleProblem) -> NormalEquations:
    """Linearise the landmarks and eliminate them, half of the observations in each of two threads.

    With the Jacobian J_h of the motions relative to the host h (`motions_by_poses`), and the information I_h and the
    right-hand side r_h that the landmarks of this host give to these motions, the equations of the poses are

        information = sum_h J_h^T I_h J_h
        rhs         = sum_h J_h^T r_h

    The unknowns are the poses and, last, the offset in pixels by which all positions in right images are displaced to
    the right. A single landmark does not show this calibration error. Landmarks at different depths show the offset,
    because depths from motion must agree with depths from stereo.
    """
    count = len(problem.host)
    size = 6 * len(problem.keyframes.rotations) + 1
    blocks = LandmarkBlocks(np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3, size)))
    observations = np.cumsum(np.count_nonzero(np.isfinite(problem.observations[:, :, 0]), axis=1))
    middle = int(np.searchsorted(observations, observations[-1] // 2)) if count else 0
    first, second = both(
        _linearise, _part_of(problem, blocks, slice(middle)), _part_of(problem, blocks, slice(middle, None))
    )
    upper = first[0] + second[0]
    rhs = first[1] + second[1]
    information = np.triu(upper) + np.triu(upper, 1).swapaxes(1, 2)
    to_motions = motions_by_poses(problem.keyframes)
    to_poses = to_motions.swapaxes(1, 2)
    information_of_poses = np.asarray((to_poses @ information @ to_motions).sum(axis=0))
    rhs_of_poses = np.asarray((to_poses @ rhs[:, :, None]).sum(axis=0)[:, 0])
    return NormalEquations(information_of_poses, rhs_of_poses, blocks, to_motions)


def _part_of(problem: BundleProblem, blocks: LandmarkBlocks, chosen: slice) -> tuple[BundleProblem, LandmarkBlocks]:
    """Return the problem and the blocks of the chosen landmarks."""
    return problem.with_landmarks(chosen), LandmarkBlocks(*(array[chosen] for array in blocks))


class OffsetEstimate(NamedTuple):
    """Offset of positions in right images, positive to the right."""

    px: float  #: Pixels.
    variance: float  #: Variance of the offset, px^2; infinite if the offset is not observable in the window.


class Prior(NamedTuple):
    """Information of the poses that does not come from the landmarks in the window."""

    information: FloatArray  #: `(6 K, 6 K)`.
    information_vector: FloatArray  #: `(6 K,)` right-hand side at the poses of the linearisation.
    keyframes: Poses  #: `(K,)` poses of the linearisation.

    def rhs(self, keyframes: Poses) -> FloatArray:
        """Return the right-hand side `(6 K,)` at other poses, which must be rotated little from `self.keyframes`."""
        rotation = keyframes.rotations @ self.keyframes.rotations.transpose(0, 2, 1)
        x = rotation[:, 2, 1] - rotation[:, 1, 2]
        y = rotation[:, 0, 2] - rotation[:, 2, 0]
        z = rotation[:, 1, 0] - rotation[:, 0, 1]
        angles = 0.5 * np.stack((x, y, z), axis=1)
        difference = np.concatenate((keyframes.positions - self.keyframes.positions, angles), axis=1).ravel()
        return np.asarray(self.information_vector - self.information @ difference)


class Adjustment(NamedTuple):
    """Keyframes and landmarks after an adjustment.

    Both covariances and the offset belong to the last linearisation, at the poses and landmarks before the last step.
    """

    problem: BundleProblem  #: The problem at the estimated poses and landmarks.
    covariance: FloatArray  #: `(N, 3, 3)` of the landmarks, given the poses.
    pose_covariance: FloatArray  #: `(6 K, 6 K)` of all poses, position and rotation about the world's axes.
    right_offset: OffsetEstimate  #: Remaining offset of right positions after earlier corrections.


def adjust(problem: BundleProblem, prior: Prior, iterations: int) -> Adjustment:
    """Adjust keyframes and landmarks by Gauss-Newton with robust weights; `iterations` (>= 1) is the maximum number."""
    assert iterations >= 1, "at least one iteration is required for an adjustment"
    for _ in range(iterations):
        keyframes = problem.keyframes
        system, system_rhs, blocks, to_motions = linearise(problem)
        information = system[:-1, :-1] + prior.information
        rhs = system_rhs[:-1] + prior.rhs(keyframes)
        update = np.asarray(np.linalg.solve(information, rhs), dtype=np.float64)
        landmarks = _updated_landmarks(problem, blocks, to_motions, update)
        covariance = blocks.covariance
        del blocks  # These are the largest arrays; the next iteration reuses their memory.
        problem = problem._replace(keyframes=_updated_poses(keyframes, update), uv_inverse_depth=landmarks)
        if np.abs(update).max() < CONVERGED_STEP:
            break
    pose_covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return Adjustment(problem, covariance, pose_covariance, _right_offset(system, system_rhs))


def _updated_poses(keyframes: Poses, update: FloatArray) -> Poses:
    """Return keyframes after a step `(6 K,)`."""
    step = update.reshape(-1, 6)
    rotations = [retract(rotation, *w) for rotation, w in zip(keyframes.rotations, step[:, 3:], strict=True)]
    return Poses(np.stack(rotations), keyframes.positions + step[:, :3])


def _updated_landmarks(
    problem: BundleProblem, blocks: LandmarkBlocks, to_motions: FloatArray, update: FloatArray
) -> FloatArray:
    """Return the landmarks `(N, 3)` after a step `(6 K,)` of the poses.

    Back substitution gives their step `C (r - B m)` with the motions m.
    """
    motions = to_motions[:, :-1, :-1] @ update
    rhs = blocks.rhs - np.einsum("nij,nj->ni", blocks.coupling[:, :, :-1], motions[problem.host])
    step = np.einsum("nij,nj->ni", blocks.covariance, rhs)
    return np.asarray(problem.uv_inverse_depth + np.asarray(step))


def _right_offset(system: FloatArray, rhs: FloatArray) -> OffsetEstimate:
    """Estimate the offset of right positions by one Gauss-Newton step, with the poses eliminated.

    The prior is not used, because it was computed with the earlier correction of the offset. Robust weights shorten the
    step by up to a third. Later adjustments estimate the remainder, after the online calibration has corrected the
    right positions by the offset found here.
    """
    poses = system[:-1, :-1]
    coupling = system[-1, :-1]
    regularised = poses + np.diag(GAUGE_PRIOR + GAUGE_PRIOR * np.diag(poses))
    eliminated = np.linalg.solve(regularised, np.column_stack((system[:-1, -1], rhs[:-1])))
    offset_information = float(system[-1, -1] - coupling @ eliminated[:, 0])
    offset_rhs = float(rhs[-1] - coupling @ eliminated[:, 1])
    if offset_information > MIN_OFFSET_INFORMATION:
        return OffsetEstimate(offset_rhs / offset_information, 1.0 / offset_information)
    return OffsetEstimate(0.0, np.inf)


def marginalise_oldest(problem: BundleProblem, prior: Prior) -> Prior:
    """Return the prior of all keyframes except the oldest, which is marginalised with the landmarks that it hosts."""
    equations = linearise(problem.with_landmarks(problem.host == 0))
    information = equations.information[:-1, :-1] + prior.information
    vector = equations.rhs[:-1] + prior.rhs(problem.keyframes)
    coupling = information[:6, 6:]
    gain = np.linalg.solve(information[:6, :6], coupling).T
    remaining = information[6:, 6:] - gain @ coupling
    keyframes = Poses(*(array[1:].copy() for array in problem.keyframes))
    return Prior(symmetric(remaining), vector[6:] - gain @ vector[:6], keyframes)
