"""Normalised estimation error squared (NEES) of sub-trajectories, which tests the covariance. See docs/metrics.md.

Q is the covariance of the end j given the start i. It is the sum of the uncertainties of the steps between them. A step
is the motion since the previous pose. The localiser states

- S: the covariance of a step, which is independent from step to step,
- g: vectors, each one standard deviation of an error that all steps share,
- N: the covariance of the white noise of a pose.

F propagates an error at a pose to the origin of DS (`to_origin`), or from the origin of DS to the end p_j
(`geometry.transform.propagation`). With the sums over the steps up to a pose, C = sum F S F^T and G = sum F g, and with
W = F N F^T of a pose,

    Q(i, j) = F(p_j) (C_j - C_i + W_i + W_j + (G_j - G_i) (G_j - G_i)^T) F(p_j)^T

If the steps are unknown, Q is the growth of the published covariance, `P_end - F P_start F^T`. Q is not usable if the
covariance shrank, for example because a calibration was estimated.

Only sub-trajectories that do not overlap are used, because they share no step. Two of them may have a common end. The
noise of this pose enters both errors, and the correlation is neglected.

The noise s of the truth at both ends is added: `2 s^2` for positions, `s^2` for the attitude at the end, and
`F s^2 F^T` for the attitude at the start, which rotates the displacement.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import matrix_from_quat, quat_conjugate, quat_multiply, quat_normalised, quat_rotate
from sfr_loc_map.geometry.transform import propagated_covariance, propagation
from sfr_loc_map.metrics.figures.rows import Figure, figure_row, nees_row
from sfr_loc_map.metrics.frames.association import Estimates, Frames, StampedPoses, unique_rows
from sfr_loc_map.metrics.frames.covariance import DIAGONAL, propagated, symmetric
from sfr_loc_map.metrics.trajectory.truth_error import truth_noise

PARTS = {"pose": slice(0, 6), "position": slice(0, 3), "attitude": slice(3, 6)}
"""Components of a pose's error, in ROS order."""
WITHOUT_NOISE: Final = 27  #: Number of values of a step without the noise of its pose.
SYSTEMATIC: Final = slice(21, 27)
Span = tuple[int, int]  #: First and last frame of a sub-trajectory.


class StepSums(NamedTuple):
    """The sums of steps up to a pose, propagated to the origin of DS. The module's docstring gives the equation."""

    covariance: FloatArray  #: C `(6, 6)`.
    systematic: FloatArray  #: G `(6, 6)`, one column for each error that all steps share.
    unknown_steps: int  #: Number of steps whose covariance is unknown.
    noise: FloatArray  #: W `(6, 6)` of the pose.


def sums_of_steps(estimates: Estimates, steps: FloatArray, wanted: IntArray) -> dict[int, StepSums]:
    """Return, for each row in `wanted`, the sums of the steps `(E, 48)` of the estimates up to this row.

    A lost pose repeats the previous pose and has no step.
    """
    poses = estimates.trajectory
    order = unique_rows(poses.stamps_ns)
    given, lost = steps[order], estimates.lost[order]
    is_known = np.isfinite(given).all(axis=1) & ~lost
    counted = np.where(is_known[:, None], given, 0.0)
    positions = poses.positions[order]
    turns = matrix_from_quat(poses.quats_xyzw[order])
    turns_before = np.concatenate((np.eye(3)[None], turns[:-1]))
    of_step, of_pose = to_origin(turns_before, positions), to_origin(turns, positions)
    covariance = np.cumsum(propagated(of_step, symmetric(counted[:, : SYSTEMATIC.start])), axis=0)
    systematic = np.cumsum(of_step * counted[:, None, SYSTEMATIC], axis=0)
    unknown_steps = np.cumsum(~is_known & ~lost)
    noise = propagated(of_pose, symmetric(counted[:, WITHOUT_NOISE:]))
    indices = np.searchsorted(poses.stamps_ns[order], poses.stamps_ns[wanted])
    return {
        int(row): StepSums(covariance[at], systematic[at], int(unknown_steps[at]), noise[at])
        for row, at in zip(wanted.tolist(), indices.tolist(), strict=True)
    }


def to_origin(rotations: FloatArray, positions: FloatArray) -> FloatArray:
    """Return F `(N, 6, 6)`, which propagates errors at positions, in axes with these rotations, to the origin of DS."""
    x, y, z = positions.T
    nothing = np.zeros(len(positions))
    cross = np.stack((nothing, -z, y, z, nothing, -x, -y, x, nothing), axis=-1).reshape(-1, 3, 3)
    carry = np.zeros((len(positions), 6, 6))
    carry[:, :3, :3] = carry[:, 3:, 3:] = rotations
    carry[:, :3, 3:] = cross @ rotations
    return carry


def nees_rows(
    condition: str,
    estimates: Estimates,
    frames: Frames,
    sums: Mapping[int, StepSums],
    starts: IntArray,
    ends: IntArray,
    truth_sigmas: tuple[float, float] = (0.0, 0.0),
) -> Iterator[Figure]:
    """Yield the mean NEES of sub-trajectories that do not overlap; nothing if no covariance is known.

    `truth_sigmas` are the standard deviations of the truth in position (m) and attitude (deg) along each axis.
    """
    if estimates.covariance is None:
        return
    squares: dict[str, list[float]] = {name: [] for name in PARTS}
    from_steps = not_usable = 0
    pairs = independent_pairs(estimates.covariance, frames, starts, ends)
    errors = relative_errors(frames.estimate, frames.truth, pairs[:, 0], pairs[:, 1])
    for (start, end), error in zip(pairs.tolist(), errors, strict=True):
        first, last = int(frames.estimate_rows[start]), int(frames.estimate_rows[end])
        move = frames.position[end] - frames.position[start]
        growth = relative_covariance(sums[first], sums[last], frames.position[end]) if sums else None
        is_of_steps = growth is not None
        if growth is None:
            before, after = symmetric(estimates.covariance[[first, last]])
            growth = published_growth(before, after, move)
        growth = growth + truth_noise(truth_sigmas, move)
        found = {name: normalised_square(error[part], growth[part, part]) for name, part in PARTS.items()}
        usable = {name: value for name, value in found.items() if value is not None}
        if len(usable) < len(found):
            not_usable += 1
            continue
        from_steps += is_of_steps
        for name, value in usable.items():
            squares[name].append(value)
    if not squares["pose"] and not not_usable:
        return
    for name, part in PARTS.items():
        yield nees_row("nees", np.array(squares[name]), part.stop - part.start, condition, name)
    yield figure_row("nees_not_usable", condition, value=not_usable)
    yield figure_row("nees_from_steps", condition, value=from_steps)


def independent_pairs(covariance: FloatArray, frames: Frames, starts: IntArray, ends: IntArray) -> IntArray:
    """Return starts and ends `(M, 2)` of sub-trajectories that do not overlap and whose covariances are known."""
    is_finite = np.isfinite(covariance).all(axis=1)
    is_known = np.asarray(is_finite & (covariance[:, DIAGONAL] < LOST_VARIANCE).all(axis=1))
    has_both = is_known[frames.estimate_rows[starts]] & is_known[frames.estimate_rows[ends]]
    spans = zip(starts[has_both].tolist(), ends[has_both].tolist(), strict=True)
    return np.array(list(without_overlap(spans)), np.intp).reshape(-1, 2)


def without_overlap(spans: Iterable[Span]) -> Iterator[Span]:
    """Yield the sub-trajectories that do not overlap, selected greedily from the first; two may have a common end."""
    free_from = 0
    for start, end in spans:
        if start >= free_from:
            yield start, end
            free_from = end


def published_growth(before: FloatArray, after: FloatArray, move: FloatArray) -> FloatArray:
    """Return the growth of a published covariance over a displacement: `P_end - F P_start F^T`."""
    growth = after - propagated_covariance(before, move)
    return np.asarray(0.5 * (growth + growth.T))


def normalised_square(error: FloatArray, covariance: FloatArray) -> float | None:
    """Return `e^T Q^-1 e`; None if the covariance is not usable, because it is not positive definite.

    A covariance that shrank is not positive definite, for example because a calibration was estimated.
    """
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    whitened = np.linalg.solve(root, error)
    return float(whitened @ whitened)


def relative_errors(estimate: StampedPoses, reference: StampedPoses, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the differences `(M, 6)` of position (m) and attitude (rad) over sub-trajectories: estimate - reference.

    The reference is the ground truth or another estimate. Its motion is first rotated by the attitude difference at the
    start, so that both motions start with the same attitude.
    """
    to_estimate = quat_multiply(estimate.attitude[starts], quat_conjugate(reference.attitude[starts]))
    move = quat_rotate(to_estimate, reference.position[ends] - reference.position[starts])
    position = (estimate.position[ends] - estimate.position[starts]) - move
    attitude = quat_multiply(to_estimate, reference.attitude[ends])
    turn = quat_normalised(quat_multiply(estimate.attitude[ends], quat_conjugate(attitude)))
    turn = np.where(turn[:, 3:] < 0.0, -turn, turn)
    sine = np.linalg.norm(turn[:, :3], axis=1)
    is_small = sine < 1e-9
    scale = np.where(is_small, 2.0, 2.0 * np.arctan2(sine, turn[:, 3]) / np.where(is_small, 1.0, sine))
    return np.concatenate((position, scale[:, None] * turn[:, :3]), axis=1)


def relative_covariance(start: StepSums, end: StepSums, position: FloatArray) -> FloatArray | None:
    """Return Q `(6, 6)`, the covariance of the end given the start; None if a step between them is unknown.

    Q is defined in the module's docstring. `position` is the position of the end.
    """
    if end.unknown_steps > start.unknown_steps:
        return None
    carry = propagation(position)
    systematic = carry @ (end.systematic - start.systematic)
    parts = (end.covariance - start.covariance) + start.noise + end.noise
    covariance = carry @ parts @ carry.T + systematic @ systematic.T
    return np.asarray(0.5 * (covariance + covariance.T))
