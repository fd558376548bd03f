"""Which single convention mismatch would explain that an estimate and the truth disagree? And its correction.

Each is undone in turn and the disagreement measured again. One is named only if undoing it leaves a half or less of the
disagreement (a third, if numbers are fitted to undo it), explains nine tenths of all sub-trajectories, and is better
than the plain reading by that factor on the median of them. A few outliers explain nothing, frames that are omitted
are not explained, and what a scale error of the estimate explains as well is no mismatch of a convention.

The disagreement does not depend on the world frame: the mean over sub-trajectories of the position error
as a share of the path and the attitude error in radians, root of the sum of squares, re-based by the whole pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    quat_angle,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_normalised,
    quat_rotate,
    slerp,
    unit_quats,
)
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, propagation
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.association import COVARIANCE_SIZE, UPPER, Estimates, associate, unique_rows
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.formulas import pose_reading
from sfr_loc_map.metrics.pose_convention import FIRST_POSE, MIRROR, PoseConvention, aligned, converted
from sfr_loc_map.metrics.records import Record

GAIN, GAIN_FITTED = 2.0, 3.0
"""Undoing a mismatch must make the disagreement this many times smaller; the second where numbers were fitted."""
AGREES = 1e-3  #: A disagreement below this (a thousandth of the path, or 0.06 degrees) needs no explanation.
EXPLAINED = 0.25  #: What is left must be less than this (a quarter of the path, or 14 degrees).
EXPLAINED_SHARE = 0.9  #: So many of all sub-trajectories must be explained; those that are omitted are not.
HONEST_SCALES = (0.8, 1.25)  #: Scales of an estimate that are an error of its method, not of its unit.
LATE_GAIN, LATE_POSES = 2.0, 30
"""So many times smaller are the squared differences of rotations from pose to pose if each is compared with that of the
pair before, at so many poses, where an estimate lags behind by one pair."""
SIMPLER = 2.0  #: A mismatch with fitted numbers must explain this many times more than one without.
MAX_POSES, MIN_POSES = 20_000, 8
SUB_TRAJECTORIES = 400
MIN_LEVER_M, MAX_TILT_DEG = 0.05, 60.0
ALIKE = 0.5  #: A unit explains displacements only if this is their correlation with the true ones; noise has about 0.
OFFSET_STEPS = 200
AS_GOOD = 1.1  #: An offset to the stamps of the truth themselves is taken for the best one if it is this near to it.
STAMP_NOISE_NS = 1_000
LOOKS_WRONG = "the estimate looks wrong:"
Poses = tuple[FloatArray, FloatArray]  #: Positions `(N, 3)` and unit quaternions `(N, 4)`.


class Tried(NamedTuple):
    """A hypothesis, and what it leaves of the disagreement of each sub-trajectory, infinite where it leaves it out."""

    hypothesis: Hypothesis
    left: FloatArray


class Hypothesis(Record, frozen=True, kw_only=True):
    """One convention mismatch and what undoing it does."""

    mismatch: str  #: Short name.
    sentence: str  #: What is wrong with the estimate, and what to do.
    disagreement: float  #: What is left when it is undone.
    fitted: bool = False  #: Whether numbers were fitted to undo it.
    setting: str = ""  #: What corrects it as `NAME=VALUE` of `PoseConvention`; empty where none does.


class Diagnosis(Record, frozen=True, kw_only=True):
    """What was found."""

    disagreement: float | None  #: Of the estimate as given; None where both have no stamp in common.
    hypotheses: tuple[Hypothesis, ...]  #: Mismatches, the best explanation first.
    found: Hypothesis | None  #: Mismatch that explains the disagreement; None without a disagreement or an explanation.


def diagnose(
    estimate: Trajectory,
    truth: Trajectory,
    config: AssociationConfig,
    rig: StereoRig | None = None,
    *,
    every: bool = True,
) -> Diagnosis:
    """Find the single convention mismatch that explains how estimate and truth (poses of RB in DS) disagree.

    Where they agree every hypothesis is tried all the same, unless `every` is false: a score needs none then.
    """
    if not truth.has_attitude:  # every hypothesis is judged by attitudes too
        return Diagnosis(disagreement=None, hypotheses=(), found=None)
    estimate = _in_order(estimate, max(1, len(estimate.stamps_ns) // MAX_POSES))
    truth = _in_order(truth, 1)
    frames = associate(estimate, truth, config)[0]
    true, found = (frames.true_position, frames.true_attitude), (frames.position, frames.attitude)
    has_frames = len(frames.stamps_ns) >= MIN_POSES
    plain = disagreements(true, found) if has_frames else None
    before = None if plain is None else float(np.mean(plain))
    if before is not None and before < AGREES and not every:
        return Diagnosis(disagreement=before, hypotheses=(), found=None)
    tried: list[Tried] = []
    for item in [*MISMATCHES, *frame_mismatches(true, found, rig)] if has_frames else []:
        if item.applies(true, found):
            left = disagreements(true, item.undo(*found))
            hypothesis = Hypothesis(
                mismatch=item.name,
                sentence=f"{LOOKS_WRONG} {item.sentence}",
                disagreement=float(np.mean(left)),
                fitted=item.is_fitted,
                setting=item.setting,
            )
            tried.append(Tried(hypothesis, left))
    tried += [_truth_scalar_first(true, found)] if has_frames else []
    tried += _time_offset(estimate, truth, before)
    tried.sort(key=lambda item: item.hypothesis.disagreement)
    best = _best_of(tried, plain)
    if best is not None and plain is not None and _is_scale_error(true, found, best):
        best = None
    if best is None and before is not None and before >= AGREES:
        best = _one_pair_late(true, found, frames.stamps_ns, before)
    return Diagnosis(disagreement=before, hypotheses=tuple(item.hypothesis for item in tried), found=best)


def _truth_scalar_first(true: Poses, found: Poses) -> Tried:
    """Return the hypothesis that the truth is written scalar first, which no setting of the estimate corrects."""
    positions, quats = true
    left = disagreements((positions, quats[:, WXYZ]), found)
    sentence = (
        "the truth looks wrong: its quaternions are scalar first: name its columns, as "
        "--columns 'truth:t,x,y,z,qw,qx,qy,qz', or write them scalar last"
    )
    return Tried(Hypothesis(mismatch="truth scalar first", sentence=sentence, disagreement=float(np.mean(left))), left)


def _in_order(poses: Trajectory, step: int) -> Trajectory:
    """Return one pose per `step` poses in the order of their stamps, each stamp once."""
    rows = unique_rows(poses.stamps_ns)[::step]
    return Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quats_xyzw[rows])


def _best_of(tried: Sequence[Tried], plain: FloatArray | None) -> Hypothesis | None:
    """Return the hypothesis that explains a disagreement, a simpler one rather than one with fitted numbers."""
    if plain is not None and np.mean(plain) < AGREES:
        return None
    possible = [item.hypothesis for item in tried if _explains(item, plain)]
    simple = [item for item in possible if not item.fitted]
    best = next(iter(possible), None)
    if best is not None and simple and simple[0].disagreement <= SIMPLER * best.disagreement:
        return simple[0]
    return best


def _explains(tried: Tried, plain: FloatArray | None) -> bool:
    """Return whether a hypothesis explains the disagreement of nearly all sub-trajectories, not that of a few."""
    gain = GAIN_FITTED if tried.hypothesis.fitted else GAIN
    most = EXPLAINED if plain is None else min(EXPLAINED, float(np.mean(plain)) / gain)
    usual = EXPLAINED if plain is None else float(np.mean(plain))
    if tried.hypothesis.disagreement > most or np.mean(tried.left <= usual) < EXPLAINED_SHARE:
        return False
    return plain is None or bool(np.median(plain) >= gain * np.median(tried.left))


def _is_scale_error(true: Poses, found: Poses, best: Hypothesis) -> bool:
    """Return whether the estimate's own scale explains the disagreement about as well as a hypothesis does."""
    starts, ends = _eighths(len(true[0]))
    true_m, found_m = (np.linalg.norm(p[ends] - p[starts], axis=1) for p in (true[0], found[0]))
    scale = float(true_m @ found_m) / max(float(found_m @ found_m), 1e-12)
    if not HONEST_SCALES[0] <= scale <= HONEST_SCALES[1]:
        return False
    return disagreement(true, (scale * found[0], found[1])) <= SIMPLER * best.disagreement


def _one_pair_late(true: Poses, found: Poses, stamps_ns: IntArray, before: float) -> Hypothesis | None:
    """Return the hypothesis that each pose is that of the pair before, if the rotations from pose to pose show it."""
    if len(stamps_ns) < LATE_POSES:
        return None
    true_turns, turns = (
        _upright(quat_multiply(quat_conjugate(each[:-1]), each[1:]))[:, :3] for each in (true[1], found[1])
    )
    now = np.square(turns[1:] - true_turns[1:]).sum()
    late = np.square(turns[1:] - true_turns[:-1]).sum()
    left = disagreement((true[0][:-1], true[1][:-1]), (found[0][1:], found[1][1:]))
    if late * LATE_GAIN >= now or left >= before:
        return None
    step = int(np.median(np.diff(stamps_ns)))
    return _of_offset(-step, step, left)


def disagreement(truth: Poses, estimate: Poses) -> float:
    """Return the disagreement of estimated poses with the truth, both in time order."""
    return float(np.mean(disagreements(truth, estimate)))


def disagreements(truth: Poses, estimate: Poses) -> FloatArray:
    """Return the disagreement of each sub-trajectory."""
    starts, ends = _eighths(len(truth[0]))
    errors = pose_reading(formulas.Poses(*truth, *estimate), starts, ends)
    until_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth[0], axis=0), axis=1)))
    lengths_m = until_m[ends] - until_m[starts]
    lengths_m = np.maximum(lengths_m, max(0.1 * float(lengths_m.mean()), 1e-9))  # never much less than the mean
    of_path = np.linalg.norm(errors.position_m, axis=1) / lengths_m
    return np.asarray(np.hypot(of_path, np.radians(errors.attitude_deg)))


def _eighths(count: int) -> tuple[IntArray, IntArray]:
    """Return starts and ends of sub-trajectories of an eighth of the poses."""
    span = max(2, count // 8)
    starts = np.unique(np.linspace(0, count - 1 - span, SUB_TRAJECTORIES).astype(np.int64))
    return starts, starts + span


# ---- the hypotheses


class Mismatch(NamedTuple):
    """One hypothesis: what is wrong with the estimate, and what undoes it."""

    name: str
    setting: str  #: What corrects it as `NAME=VALUE` of `PoseConvention`; empty where none does.
    sentence: str
    undo: Callable[[FloatArray, FloatArray], Poses]
    is_fitted: bool = False  #: Whether numbers were fitted to undo it.
    applies: Callable[[Poses, Poses], bool] = lambda true, found: True  #: Whether these poses can show it.


def _motions_inverted(p: FloatArray, q: FloatArray) -> Poses:
    back = quat_conjugate(q)
    return quat_rotate(back, p[0] - p), quat_multiply(back, q[0])


def _begins_elsewhere(true: Poses, found: Poses) -> bool:
    """Return whether the first pose is not the identity: else inverted motions are inverted poses."""
    positions, quats = found
    return bool(np.abs(positions[0]).max() + quat_angle(quats[0]) > 1e-9)


def _moves_alike(true: Poses, found: Poses) -> bool:
    """Return whether displacements have the directions of the true ones; those of a rover that stands are noise.

    Without this condition, millimetres would explain the noise of any estimate at standstill, because they remove it.
    """
    starts, ends = _eighths(len(true[0]))
    moves = [quat_rotate(quat_conjugate(q[starts]), p[ends] - p[starts]) for p, q in (true, found)]
    size = float(np.linalg.norm(moves[0]) * np.linalg.norm(moves[1]))
    return bool((moves[0] * moves[1]).sum() > ALIKE * size)


WXYZ = [1, 2, 3, 0]  #: Columns x, y, z, w of a quaternion that was read as x, y, z, w but was written w, x, y, z.
OPTICAL = quat_from_matrix(OPTICAL_IN_BODY)
MISMATCHES = (
    Mismatch(
        "conjugated quaternion",
        "quaternion=conjugated",
        "its attitudes are conjugated (orientation of RB in DS in place of DsToRb): conjugate them",
        lambda p, q: (p, quat_conjugate(q)),
    ),
    Mismatch(
        "scalar first",
        "quaternion=wxyz",
        "its quaternions are scalar first: write them scalar last",
        lambda p, q: (p, q[:, WXYZ]),
    ),
    Mismatch(
        "scalar first",
        "quaternion=wxyz_ds_to_rb",
        "its quaternions are scalar first in the columns att_q_DsToRb: write them scalar last",
        lambda p, q: (p, quat_conjugate(quat_conjugate(q)[:, WXYZ])),
    ),
    Mismatch(
        "scalar first",
        "quaternion=conjugated_wxyz",
        "its quaternions are scalar first and conjugated: write them scalar last",
        lambda p, q: (p, quat_conjugate(q[:, WXYZ])),
    ),
    Mismatch(
        "inverted poses",
        "inverse=true",
        "its poses are inverted (DS in RB): invert them",
        lambda p, q: (-quat_rotate(quat_conjugate(q), p), quat_conjugate(q)),
    ),
    Mismatch(
        "inverted motions",
        "inverse_motion=true",
        "its motions since the first pose are inverted: invert them",
        _motions_inverted,
        applies=_begins_elsewhere,
    ),
    Mismatch(
        "optical axes",
        "frame=rb_optical",
        "its attitudes are those of the optical axes (x right, y down, z forward): rotate them to RB",
        lambda p, q: (p, quat_multiply(q, quat_conjugate(OPTICAL))),
    ),
    Mismatch(
        "millimetres",
        "metres_per_unit=0.001",
        "its positions are in millimetres: write metres",
        lambda p, q: (p * 1e-3, q),
        applies=_moves_alike,
    ),
    Mismatch(
        "kilometres",
        "metres_per_unit=1000",
        "its positions are a thousand times too small (the truth in millimetres, or kilometres): write metres",
        lambda p, q: (p * 1e3, q),
        applies=_moves_alike,
    ),
    Mismatch(
        "swapped left and right images",
        "",
        "it moves backwards where the truth moves forwards: the left and right images are swapped",
        lambda p, q: (-p, q),
    ),
    Mismatch(
        "mirrored left and right",
        "mirrored=true",
        "left and right are mirrored (y points right): negate y, and x and z of the quaternions",
        lambda p, q: (p * MIRROR, q * np.array([-1.0, 1.0, -1.0, 1.0])),
    ),
)
"""The mismatches whose correction has no numbers."""


def frame_mismatches(truth: Poses, estimate: Poses, rig: StereoRig | None) -> Iterator[Mismatch]:
    """Yield that the poses are of another frame of the rover: rotation known or presumed, position known or fitted."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    if rig is not None and rig.T_rb_sb is not None:
        left_in_sb = np.array([0.0, 0.5 * rig.baseline_m, 0.0])
        lever = rig.T_rb_sb.apply(left_in_sb)
        known = quat_from_matrix(rig.T_rb_sb.rotation.dot(OPTICAL_IN_BODY))
        yield _left_camera(known, lever, "in place of RB (optical axes)", "frame=left_optical")
        yield _left_camera(upright, lever, "in place of RB (axes of RB)", "")
    # motions of the sub-trajectories in the frame of their start, and the rotation that takes their directions to the
    # true ones (Kabsch 1976): axes of rotation and directions of displacement, weighted by their size
    starts, ends = _eighths(len(estimate[0]))
    turns, moves, directions = [], [], []
    for positions, attitudes in (truth, estimate):
        back = quat_conjugate(attitudes[starts])
        turns.append(_upright(quat_multiply(back, attitudes[ends])))
        moves.append(quat_rotate(back, positions[ends] - positions[starts]))
        size = float(np.sqrt(np.square(moves[-1]).sum(axis=1).mean())) or 1.0
        directions.append(np.concatenate((turns[-1][:, :3], moves[-1] / size)))
    u, _, vt = np.linalg.svd(directions[0].T @ directions[1])
    fitted = quat_from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
    for turn, axes in ((upright, "axes of RB"), (OPTICAL, "optical axes"), (fitted, "tilted optical axes")):
        # the point whose poses are given: its displacements differ by `R l - l`
        matrix = (matrix_from_quat(turns[0]) - np.eye(3)).reshape(-1, 3)
        lever = np.asarray(np.linalg.lstsq(matrix, (quat_rotate(turn, moves[1]) - moves[0]).ravel(), rcond=1e-3)[0])
        tilt_deg = float(np.degrees(quat_angle(quat_multiply(turn, quat_conjugate(OPTICAL)))))
        is_camera = turn is not fitted or tilt_deg <= MAX_TILT_DEG
        if float(np.sqrt(lever @ lever)) >= MIN_LEVER_M and is_camera:
            position = ", ".join(f"{value:.2f}" for value in lever)
            words = f"in place of RB or of another point ({axes}, at {position} m in RB)"
            yield _left_camera(turn, lever, words, "", is_fitted=True)


def _left_camera(
    turn: FloatArray, lever_m: FloatArray, words: str, setting: str, *, is_fitted: bool = False
) -> Mismatch:
    """Return that poses are those of a camera at a point of RB."""
    if not setting:
        numbers = (*lever_m.tolist(), *turn.tolist())
        setting = "extrinsics=" + ",".join(repr(round(number, 9)) for number in numbers)

    def undo(p: FloatArray, q: FloatArray) -> Poses:
        of_rb = quat_multiply(q, quat_conjugate(turn))
        return p - quat_rotate(of_rb, lever_m), of_rb

    sentence = f"it is the pose of the left camera {words}: transform it by the extrinsics of the camera"
    return Mismatch("left camera", setting, sentence, undo, is_fitted)


def _upright(quats: FloatArray) -> FloatArray:
    """Return quaternions of the same rotations, scalar >= 0."""
    return np.where(quats[:, 3:] < 0.0, -quats, quats)


def _time_offset(estimate: Trajectory, truth: Trajectory, before: float | None) -> Iterator[Tried]:
    est_ns, gt_ns = estimate.stamps_ns, truth.stamps_ns
    if min(len(est_ns), len(gt_ns)) < MIN_POSES:
        return
    step = int(np.median(np.diff(est_ns)))
    base = 0 if before is not None else int(gt_ns[0]) - int(est_ns[0])
    reach = max(20 * step, 2 * NS_PER_S)
    best, least, explained = base, np.inf, np.full(1, np.inf)
    while True:
        is_last = reach < max(step // 500, 1000)
        if not is_last:
            shifts = np.linspace(best - reach, best + reach, OFFSET_STEPS + 1).astype(np.int64).tolist()
        elif np.isfinite(least):  # what takes most stamps to those of the truth themselves, else the best one once more
            stamps = est_ns + best
            after = np.clip(np.searchsorted(gt_ns, stamps), 1, len(gt_ns) - 1)
            around = np.stack((gt_ns[after - 1] - stamps, gt_ns[after] - stamps))
            left = around[np.abs(around).argmin(axis=0), np.arange(len(stamps))]
            middle = int(np.median(left))
            shifts = [best + (middle if (np.abs(left - middle) <= STAMP_NOISE_NS).mean() > 0.5 else 0)]
        else:
            return
        for shift in shifts:
            first, last = np.searchsorted(est_ns, gt_ns[[0, -1]] - shift).tolist()
            if last - first < max(MIN_POSES, round(EXPLAINED_SHARE * len(est_ns))):
                continue  # nothing is explained by leaving frames out
            chosen = slice(first, last, max(1, (last - first) // 800))
            stamps = est_ns[chosen] + shift
            after = np.searchsorted(gt_ns, stamps, side="right")
            share = (stamps - gt_ns[after - 1]) / (gt_ns[after] - gt_ns[after - 1])
            start = truth.positions[after - 1]
            true = (
                start + share[:, None] * (truth.positions[after] - start),
                slerp(unit_quats(truth.quats_xyzw[after - 1]), unit_quats(truth.quats_xyzw[after]), share),
            )
            left_of_each = disagreements(true, (estimate.positions[chosen], unit_quats(estimate.quats_xyzw[chosen])))
            value = float(np.mean(left_of_each))
            if is_last and value <= AS_GOOD * least:
                best = shift
            elif value < least:
                best, least, explained = shift, value, left_of_each
        if is_last:
            break
        reach = reach * 4 // OFFSET_STEPS
    yield Tried(_of_offset(best, step, least), explained)


def _of_offset(offset_ns: int, step_ns: int, left: float) -> Hypothesis:
    is_late = abs(offset_ns + step_ns) < 0.02 * step_ns
    late = "; each pose is that of the pair before" if is_late else ""
    return Hypothesis(
        mismatch="time offset",
        sentence=f"{LOOKS_WRONG} its stamps are {offset_ns / NS_PER_S:+.3f} s off, add this to them{late}",
        disagreement=left,
        fitted=not is_late,
        setting=f"time_offset_ns={offset_ns}",
    )


def converted_estimates(
    estimates: Estimates, convention: PoseConvention, T_rb_child: Transform, truth: Trajectory | None
) -> Estimates:
    """Return estimates (of a child frame of RB, as they were written) as poses of RB in DS.

    A world frame that is the first pose is aligned there with the truth; without one the first pose is the identity. A
    covariance is propagated; where poses are inverted or mirrored it is removed. Steps (`step_cov`) are motions of
    RB: they stay only where nothing but the world frame or the stamps differ. MetricsError if no pose has a true pose.
    """
    poses = converted(estimates.trajectory, convention, T_rb_child)
    is_turned = convention.inverse or convention.inverse_motion or convention.mirrored
    covariance = None if is_turned else estimates.covariance
    if covariance is not None and (convention.metres_per_unit != 1.0 or convention.of_another_frame):
        unit = np.diag([convention.metres_per_unit] * 3 + [1.0] * 3)
        arms = -quat_rotate(quat_normalised(poses.quats_xyzw), T_rb_child.translation)
        carry = np.array([propagation(arm) @ unit for arm in arms]).reshape(-1, 6, 6)
        covariance = _carried(covariance, carry)
    plain = convention == PoseConvention(world=convention.world, time_offset_ns=convention.time_offset_ns)
    result = replace(estimates, trajectory=poses, covariance=covariance, steps=estimates.steps if plain else None)
    if convention.world != FIRST_POSE:
        return result
    return aligned_estimates(result, world_at_first_pose(result, truth))


def aligned_estimates(estimates: Estimates, T_ds_world: Transform) -> Estimates:
    """Return estimates in DS, with their covariances, from estimates in another world frame."""
    covariance = estimates.covariance
    if covariance is not None:
        covariance = _carried(covariance, np.asarray(np.kron(np.eye(2), T_ds_world.rotation), np.float64))
    return replace(estimates, trajectory=aligned(estimates.trajectory, T_ds_world), covariance=covariance)


def world_at_first_pose(estimates: Estimates, truth: Trajectory | None) -> Transform:
    """Return `T_ds_world` that takes the first pose that has a truth to it; without a truth, to the identity."""
    if truth is None:
        if not len(estimates.trajectory):
            raise MetricsError("there is no pose to align the world frame at: give an estimate with poses")
        return estimates.trajectory.pose(0).inverse()
    frames = associate(estimates.trajectory, truth, AssociationConfig())[0]
    known = np.flatnonzero(~estimates.lost[frames.estimate_rows])
    if not len(known):
        raise MetricsError("no pose has a true pose to align the world frame with: check the stamps, or world=ds")
    first = int(known[0])
    true = Transform.from_quat(frames.true_position[first], frames.true_attitude[first])
    return true @ Transform.from_quat(frames.position[first], frames.attitude[first]).inverse()


def _carried(covariance: FloatArray, carry: FloatArray) -> FloatArray:
    full = np.empty((len(covariance), 6, 6))
    full[:, UPPER[0], UPPER[1]] = full[:, UPPER[1], UPPER[0]] = covariance
    moved = carry @ full @ np.swapaxes(carry, -1, -2)
    return np.ascontiguousarray(moved[:, UPPER[0], UPPER[1]]).reshape(-1, COVARIANCE_SIZE)
