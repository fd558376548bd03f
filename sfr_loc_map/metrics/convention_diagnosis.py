"""Which single mistake of convention would explain that an estimate and the truth disagree?

Each mistake is undone in turn and the disagreement measured again: the mean over sub-trajectories of the position error
as a share of the way and the attitude error in radians, root of the sum of squares, re-based by the whole pose (so that
the placing of the world frame plays no part). A mistake is named only if undoing it leaves a half or less of the
disagreement (a third, if numbers are fitted to undo it); a pair that agrees is never far from the best it can be,
whatever is undone, and is left in peace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat, quat_conjugate, quat_from_matrix, quat_multiply, quat_rotate
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.association import Estimates, associate, slerp, unique_rows, unit_quats
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.trajectory_error import sub_trajectory_errors

GAIN = 2.0
"""Undoing a mistake must make the disagreement this many times smaller."""
GAIN_FITTED = 3.0
"""The same where numbers were fitted to undo it."""
AGREES = 1e-3
"""A disagreement below this (a thousandth of the way, or 0.06 degrees) needs no explanation."""
EXPLAINED = 0.25
"""What is left must be less than this (a quarter of the way, or 14 degrees)."""
SIMPLER = 2.0
"""A mistake with numbers that were fitted must explain this many times more than one without."""
MIN_LEVER_M = 0.05
MAX_POSES = 20_000
SUB_TRAJECTORIES = 400
MIN_POSES = 8
OFFSET_STEPS = 200
OPTICAL_IN_RB = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
MIRROR = np.array([1.0, -1.0, 1.0])

Poses = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One mistake and what undoing it does.

    Attributes:
        mistake: Short name.
        sentence: What is wrong with the estimate, and what to do.
        disagreement: What is left when it is undone.
        fitted: Whether numbers were fitted to undo it.
    """

    mistake: str
    sentence: str
    disagreement: float
    fitted: bool = False


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found.

    Attributes:
        disagreement: As the estimate stands; None where estimate and truth have no stamp in common.
        suspicions: All mistakes looked into, the best explanation first.
        found: The mistake that explains the disagreement, None if none does or there is nothing to explain.
    """

    disagreement: float | None
    suspicions: tuple[Hypothesis, ...]
    found: Hypothesis | None


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """True and estimated poses side by side, and the sub-trajectories that are looked at."""

    gt: Poses
    est: Poses
    starts: IntArray
    ends: IntArray


def diagnose(
    estimate: Trajectory, truth: Trajectory, config: AssociationConfig, T_rb_left: Transform | None = None
) -> Diagnosis:
    """Find the single mistake that explains how estimate and truth disagree.

    Args:
        estimate: Estimated poses of RB in DS.
        truth: True poses of RB in DS.
        config: How estimates find their truth.
        T_rb_left: Place of the left camera on the rover, where it is known.
    """
    thin = max(1, len(estimate) // MAX_POSES)
    rows = unique_rows(estimate.stamps_ns)[::thin]
    estimate = Trajectory(estimate.stamps_ns[rows], estimate.positions[rows], estimate.quats_xyzw[rows])
    frames = associate(Estimates.of(estimate), truth, config)[0]
    suspicions: list[Hypothesis] = []
    before = None
    if len(frames) >= MIN_POSES:
        case = _case((frames.gt_pos, frames.gt_quat), (frames.est_pos, frames.est_quat))
        before = _disagreement(case, case.est)
        suspicions += _conventions(case)
        suspicions += _other_frames(case, T_rb_left)
    suspicions += _time_offset(estimate, truth, before)
    suspicions.sort(key=lambda item: item.disagreement)
    return Diagnosis(before, tuple(suspicions), _verdict(before, suspicions))


def _verdict(before: float | None, suspicions: list[Hypothesis]) -> Hypothesis | None:
    if before is not None and before < AGREES:
        return None
    most = np.inf if before is None else before
    possible = [
        item
        for item in suspicions
        if item.disagreement <= min(EXPLAINED, most / (GAIN_FITTED if item.fitted else GAIN))
    ]
    if not possible:
        return None
    plain = [item for item in possible if not item.fitted]
    if plain and plain[0].disagreement <= SIMPLER * possible[0].disagreement:
        return plain[0]
    return possible[0]


def _case(gt: Poses, est: Poses) -> _Case:
    count = len(gt[0])
    span = max(2, count // 8)
    starts = np.unique(np.linspace(0, count - 1 - span, SUB_TRAJECTORIES).astype(np.int64))
    return _Case(gt, est, starts, starts + span)


def _disagreement(case: _Case, est: Poses) -> float:
    """Return the disagreement of estimated poses, see above."""
    no_length = np.zeros((len(case.gt[0]), 2))
    poses = (*case.gt, np.ascontiguousarray(est[0]), np.ascontiguousarray(est[1]), no_length)
    errors = sub_trajectory_errors(*poses, case.starts, *poses, case.ends, True)
    way = _way(case)
    position = np.sqrt(np.square(errors[:, :3]).sum(axis=1)) / way
    return float(np.mean(np.sqrt(np.square(position) + np.square(np.radians(errors[:, 3])))))


def _way(case: _Case) -> FloatArray:
    """Return the length of the way of each sub-trajectory, never much less than the mean."""
    steps = np.sqrt(np.square(np.diff(case.gt[0], axis=0)).sum(axis=1))
    until = np.concatenate(([0.0], np.cumsum(steps)))
    way = until[case.ends] - until[case.starts]
    return np.asarray(np.maximum(way, max(0.1 * float(way.mean()), 1e-9)))


def _conventions(case: _Case) -> Iterator[Hypothesis]:
    """Yield the mistakes that need no number to undo."""
    undo: list[tuple[str, str, Callable[[FloatArray, FloatArray], Poses]]] = [
        (
            "conjugated quaternion",
            "its attitudes are conjugated (att_q_DsToRb written as the orientation of RB in DS): conjugate them",
            lambda p, q: (p, quat_conjugate(q)),
        ),
        (
            "scalar first",
            "its quaternions are written scalar first (w x y z): write them scalar last (x y z w)",
            lambda p, q: (p, q[:, [1, 2, 3, 0]]),
        ),
        (
            "inverted poses",
            "its poses are inverted (DS in RB in place of RB in DS): invert them",
            lambda p, q: (-quat_rotate(quat_conjugate(q), p), quat_conjugate(q)),
        ),
        (
            "optical axes",
            "its attitudes are those of the optical axes (x right, y down, z forward) in place of RB: turn them to RB",
            lambda p, q: (p, _turned(q, OPTICAL_IN_RB.T)),
        ),
        (
            "millimetres",
            "its positions are in millimetres: write metres",
            lambda p, q: (p * 1e-3, q),
        ),
        (
            "kilometres",
            "its positions are a thousand times too small (the truth in millimetres, or kilometres): write metres",
            lambda p, q: (p * 1e3, q),
        ),
        (
            "swapped left and right pictures",
            "it moves backwards where the truth moves forwards: the left and right pictures are swapped",
            lambda p, q: (-p, q),
        ),
        (
            "mirrored left and right",
            "left and right are mirrored (y points right): negate y, and x and z of the quaternions",
            lambda p, q: (p * MIRROR, q * np.array([-1.0, 1.0, -1.0, 1.0])),
        ),
    ]
    for mistake, sentence, corrected in undo:
        yield Hypothesis(mistake, f"the estimate looks wrong: {sentence}", _disagreement(case, corrected(*case.est)))


def _turned(quats: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the attitudes of a frame that is turned on the rover: `R_ds_rb R_rb_other`."""
    return quat_multiply(quats, quat_from_matrix(rotation))


def _other_frames(case: _Case, T_rb_left: Transform | None) -> Iterator[Hypothesis]:
    """Yield the mistake of another frame of the rover: its turn known or guessed, its place known or fitted."""
    camera = "the estimate looks wrong: it is the pose of the left camera in place of RB"
    remedy = "carry it over by the place of the camera on the rover"
    if T_rb_left is not None:
        for rotation, axes in ((T_rb_left.rotation, "optical axes"), (np.eye(3), "axes of RB")):
            corrected = _moved(case.est, rotation, T_rb_left.translation)
            yield Hypothesis("left camera", f"{camera} ({axes}): {remedy}", _disagreement(case, corrected))
    for rotation, axes in (
        (np.eye(3), "axes of RB"),
        (OPTICAL_IN_RB, "optical axes"),
        (_fitted_turn(case), "tilted optical axes"),
    ):
        turned = case.est[0], _turned(case.est[1], rotation.T)
        lever = _fitted_lever(case, turned)
        tilt = _angle_deg(rotation @ OPTICAL_IN_RB.T)
        if float(np.sqrt(lever @ lever)) < MIN_LEVER_M or (axes.startswith("tilted") and tilt > 60.0):
            continue
        place = ", ".join(f"{value:.2f}" for value in lever)
        corrected = _moved(case.est, rotation, lever)
        sentence = f"{camera} or of another point ({axes}, at {place} m in RB): {remedy}"
        yield Hypothesis("left camera", sentence, _disagreement(case, corrected), fitted=True)


def _moved(est: Poses, rotation: FloatArray, lever: FloatArray) -> Poses:
    """Return the poses of RB of estimates of a frame at `rotation`, `lever` in RB."""
    quats = _turned(est[1], rotation.T)
    return est[0] - quat_rotate(quats, np.broadcast_to(lever, est[0].shape)), quats


def _motions(case: _Case, poses: Poses) -> tuple[FloatArray, FloatArray]:
    """Return rotations `(M, 3, 3)` and displacements `(M, 3)` of the sub-trajectories, in the frame of the start."""
    start, end = poses[1][case.starts], poses[1][case.ends]
    move = quat_rotate(quat_conjugate(start), poses[0][case.ends] - poses[0][case.starts])
    return matrix_from_quat(quat_multiply(quat_conjugate(start), end)), move


def _fitted_lever(case: _Case, turned: Poses) -> FloatArray:
    """Return the place `(3,)` in RB of the point whose positions are given: `R l - l` is what its moves differ by."""
    turn, move = _motions(case, case.gt)
    _, seen = _motions(case, turned)
    matrix = (turn - np.eye(3)).reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(matrix, (seen - move).ravel(), rcond=1e-3)[0])


def _fitted_turn(case: _Case) -> FloatArray:
    """Return the turn `(3, 3)` of the estimated frame on the rover: it takes directions of motion to the true ones.

    Axes of rotation and directions of displacement, weighted by their size (Kabsch 1976).
    """
    pairs = []
    for poses in (case.gt, case.est):
        turn, move = _motions(case, poses)
        quats = quat_from_matrix(turn)
        size = float(np.sqrt(np.square(move).sum(axis=1).mean())) or 1.0
        pairs.append(np.concatenate((quats[:, :3], move / size)))
    u, _, vt = np.linalg.svd(pairs[0].T @ pairs[1])
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _angle_deg(rotation: FloatArray) -> float:
    return float(np.degrees(2.0 * np.arccos(np.clip(quat_from_matrix(rotation)[3], -1.0, 1.0))))


def _time_offset(estimate: Trajectory, truth: Trajectory, before: float | None) -> Iterator[Hypothesis]:
    """Yield the mistake of a clock that is off: truth is interpolated at shifted stamps, the best shift searched."""
    rows = unique_rows(truth.stamps_ns)
    truth = Trajectory(truth.stamps_ns[rows], truth.positions[rows], truth.quats_xyzw[rows])
    if min(len(estimate), len(truth)) < MIN_POSES:
        return
    step = int(np.median(np.diff(estimate.stamps_ns)))
    base = 0 if before is not None else int(truth.stamps_ns[0] - estimate.stamps_ns[0])
    reach = max(20 * step, 2 * NS_PER_S)
    best, least = base, np.inf
    while reach >= max(step // 500, 1000):
        for shift in np.linspace(best - reach, best + reach, OFFSET_STEPS + 1).astype(np.int64).tolist():
            value = _shifted(estimate, truth, shift)
            if value < least:
                best, least = shift, value
        reach = reach * 4 // OFFSET_STEPS
    if np.isfinite(least):
        sentence = f"the estimate looks wrong: its stamps are {best / NS_PER_S:+.3f} s off, add this to them"
        yield Hypothesis("time offset", sentence, least, fitted=True)


def _shifted(estimate: Trajectory, truth: Trajectory, shift: int) -> float:
    """Return the disagreement if the estimate's stamps are moved; infinite where less than half have a truth."""
    stamps = estimate.stamps_ns + shift
    inside = (stamps >= truth.stamps_ns[0]) & (stamps < truth.stamps_ns[-1])
    chosen = np.flatnonzero(inside)
    if len(chosen) < max(MIN_POSES, len(estimate) // 2):
        return float("inf")
    chosen = chosen[:: max(1, len(chosen) // 800)]
    after = np.searchsorted(truth.stamps_ns, stamps[chosen], side="right")
    begin = truth.stamps_ns[after - 1]
    share = (stamps[chosen] - begin) / (truth.stamps_ns[after] - begin)
    step = truth.positions[after] - truth.positions[after - 1]
    positions = truth.positions[after - 1] + share[:, None] * step
    quats = slerp(unit_quats(truth.quats_xyzw[after - 1]), unit_quats(truth.quats_xyzw[after]), share)
    est = estimate.positions[chosen], unit_quats(estimate.quats_xyzw[chosen])
    case = _case((positions, quats), est)
    return _disagreement(case, est)
