"""Diagnosis of the single convention mismatch that explains the disagreement of estimate and truth, and its correction.

Each mismatch of the table is undone, and the disagreement is computed for the corrected estimate:

| mismatch | numbers fitted to the truth | is found by |
|---|---|---|
| quaternion order, inverted poses, axes, swapped or mirrored sides | none | `MISMATCHES` |
| unit of the estimate or of the truth | none | `_of_units` |
| poses of the left camera of the rig | none | `_of_left_camera` |
| poses of a camera or of another point of the rover | lever arm, rotation | `_of_fitted_point` |
| stamps | offset | `_of_stamps` |

One rule decides whether a mismatch is found (`_explains`). A mismatch competes with the hypotheses that presume less:
that the estimate is correct as delivered, that it has the scale error of a method, and, if numbers were fitted for the
mismatch, each mismatch without fitted numbers. In nine tenths of the sub-trajectories, the mismatch must leave at most
`EXPLAINED`, and at most a fraction (1 / `GAIN`) of the median that each of these hypotheses leaves. If one of them
leaves less than `NEGLIGIBLE`, no mismatch is needed. An offset of the stamps must keep nine tenths of the poses.

The module `disagreement` defines the disagreement, and `offset_search` searches for an offset of the stamps.

To add a mismatch, add its line to `MISMATCHES`. If its correction needs fitted numbers or the rig, yield the mismatch
in a function of `HYPOTHESES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    quat_angle,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
)
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.conventions.pose_convention import FRD_IN_BODY, MIRROR, MIRROR_QUAT
from sfr_loc_map.metrics.diagnosis.disagreement import MIN_POSES, PoseArrays, disagreements, eighths
from sfr_loc_map.metrics.diagnosis.offset_search import best_offset, period_ns
from sfr_loc_map.metrics.frames.association import associate, unique_rows
from sfr_loc_map.metrics.table.records import Record

NEGLIGIBLE = 1e-3
"""Disagreement that requires no explanation: 0.1 % of the path, or 0.06 deg. The drift of visual odometry is larger
(about 0.5 % for the best methods of the KITTI benchmark)."""
EXPLAINED = 0.25
"""Maximum disagreement after the correction: 25 % of the path, or 14 deg. Chosen by hand, because methods err less, and
wrong axes or units leave about 1."""
NEARLY_ALL = 0.9  #: Minimum fraction of explained sub-trajectories. Chosen by hand.
GAIN, GAIN_FITTED = 2.0, 3.0
"""Minimum factors by which a mismatch, without and with fitted numbers, must reduce the median disagreement that
simpler hypotheses leave. Chosen by hand; no honest random drive has a diagnosis (`python -m campaigns honest-drives`).
"""
HONEST_SCALES = (0.8, 1.25)
"""Range of scales that are attributed to the method. Chosen by hand; units differ by a factor of ten or more."""
MIN_LEVER_M = 0.05  #: Minimum fitted lever arm. Smaller lever arms are errors of extrinsics, and no other point.
MAX_TILT_DEG = 60.0  #: Maximum rotation of a fitted camera from forward-looking optical axes. Chosen by hand.
MIN_CORRELATION = 0.5  #: Minimum correlation of estimated and true displacements for a wrong unit; noise has about 0.
SPEEDS = (0.005, 40.0)  #: Range of the speed of a vehicle, from a slow rover to a car, m/s. Chosen by hand.
SPEED_QUANTILE = 0.9  #: Quantile of the speeds that is compared, because a rover may often be stationary.
MAX_POSES = 20_000  #: Maximum number of estimates, which bounds the time of a diagnosis to about 0.1 s.
TIME_OFFSET = "time offset"  #: Name of the mismatch that the stamps are offset.


class ComparedPoses(NamedTuple):
    """The poses by which hypotheses are evaluated."""

    estimate: Trajectory  #: In the order of the stamps, each stamp once.
    truth: Trajectory  #: In the order of the stamps, each stamp once.
    found: PoseArrays  #: Estimated poses of the frames.
    true: PoseArrays  #: True poses of the frames.
    rig: StereoRig | None  #: Rig of the localisation cameras; None if it is unknown.
    #: Disagreement of each sub-trajectory before a correction; None with fewer than `MIN_POSES` frames.
    plain: FloatArray | None

    @property
    def before(self) -> float | None:
        """The mean disagreement before a correction; None with too few frames."""
        return None if self.plain is None else float(np.mean(self.plain))


class Tried(NamedTuple):
    """A hypothesis, and the remaining disagreement of each sub-trajectory."""

    hypothesis: Hypothesis
    left: FloatArray


class Hypothesis(Record, frozen=True, kw_only=True):
    """One mismatch and the result of its correction."""

    mismatch: str  #: Short name.
    sentence: str  #: Fault of the estimate, and its correction.
    disagreement: float  #: Mean disagreement that remains after the correction.
    fitted: bool = False  #: Whether numbers were fitted for the correction.
    setting: str = ""  #: Setting `NAME=VALUE` of `PoseConvention` for the correction; empty if there is none.

    @property
    def prevents_verdict(self) -> bool:
        """Whether the figures are meaningless, because estimate and truth use different conventions.

        An offset of the stamps does not change the meaning of the figures, because the method under test may be late.
        """
        return self.mismatch != TIME_OFFSET


class Diagnosis(Record, frozen=True, kw_only=True):
    """The result of a diagnosis."""

    disagreement: float | None  #: Mean disagreement of the estimate as given; None if too few stamps are common.
    hypotheses: tuple[Hypothesis, ...]  #: Mismatches, in ascending order of the remaining disagreement.
    found: Hypothesis | None  #: Mismatch that explains the disagreement; None without a disagreement or an explanation.


def diagnose(
    estimate: Trajectory,
    truth: Trajectory,
    config: AssociationConfig,
    rig: StereoRig | None = None,
    *,
    every: bool = True,
) -> Diagnosis:
    """Find the single convention mismatch that explains the disagreement of estimate and truth (poses of RB in DS).

    With `every`, all hypotheses are tried even if estimate and truth agree. A score does not need these hypotheses.
    """
    if not truth.has_attitude:  # the disagreement requires attitudes
        return Diagnosis(disagreement=None, hypotheses=(), found=None)
    compared = compared_poses(estimate, truth, config, rig)
    plain = compared.plain
    if plain is not None and np.median(plain) < NEGLIGIBLE and not every:
        return Diagnosis(disagreement=compared.before, hypotheses=(), found=None)
    tried = [item for hypotheses in HYPOTHESES for item in hypotheses(compared)]
    tried.sort(key=lambda item: item.hypothesis.disagreement)
    without_mismatch = list(_without_mismatch(compared))
    without_fit = [item.left for item in tried if not item.hypothesis.fitted]
    found = (
        item.hypothesis
        for item in tried
        if _explains(item, [*without_mismatch, *(without_fit if item.hypothesis.fitted else ())])
    )
    hypotheses = tuple(item.hypothesis for item in tried)
    return Diagnosis(disagreement=compared.before, hypotheses=hypotheses, found=next(found, None))


def _explains(tried: Tried, simpler: Sequence[FloatArray]) -> bool:
    """Return whether a mismatch explains the disagreement better than all hypotheses that presume less.

    `simpler` are the disagreements of the sub-trajectories that these hypotheses leave. Their median is compared, so
    that outliers of the estimate require no explanation.
    """
    gain = GAIN_FITTED if tried.hypothesis.fitted else GAIN
    left = float(np.quantile(tried.left, NEARLY_ALL))
    others = [float(np.median(each)) for each in simpler]
    return left <= EXPLAINED and all(other >= NEGLIGIBLE and gain * left <= other for other in others)


def _without_mismatch(compared: ComparedPoses) -> Iterator[FloatArray]:
    """Yield the disagreements without a mismatch: as delivered, and after the correction of a scale error."""
    if compared.plain is None:
        return
    yield compared.plain
    true = compared.true
    found = compared.found
    starts, ends = eighths(len(true[0]))
    true_m, found_m = (np.linalg.norm(p[ends] - p[starts], axis=1) for p in (true[0], found[0]))
    scale = float(true_m @ found_m) / max(float(found_m @ found_m), 1e-12)
    if HONEST_SCALES[0] <= scale <= HONEST_SCALES[1]:
        yield disagreements(true, (scale * found[0], found[1]))


def compared_poses(
    estimate: Trajectory, truth: Trajectory, config: AssociationConfig, rig: StereoRig | None
) -> ComparedPoses:
    """Return the poses of an estimate and a truth with attitudes. A long estimate is decimated."""
    estimate = _in_order(estimate, max(1, len(estimate.stamps_ns) // MAX_POSES))
    truth = _in_order(truth, 1)
    frames = associate(estimate, truth, config)[0]
    true = (frames.true_position, frames.true_attitude)
    found = (frames.position, frames.attitude)
    plain = disagreements(true, found) if len(frames.stamps_ns) >= MIN_POSES else None
    return ComparedPoses(estimate, truth, found, true, rig, plain)


def _in_order(poses: Trajectory, step: int) -> Trajectory:
    """Return every `step`-th pose in the order of the stamps, each stamp once."""
    rows = unique_rows(poses.stamps_ns)[::step]
    return Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quats_xyzw[rows])


# ---- mismatches that are corrected pose by pose


class Mismatch(NamedTuple):
    """A convention mismatch and its correction.

    `undo` corrects positions and quaternions as `PoseConvention` does with the setting
    (`test/metrics/test_convention_diagnosis.py`).
    """

    name: str
    setting: str  #: Setting `NAME=VALUE` of `PoseConvention` for the correction; empty if there is none.
    sentence: str
    undo: Callable[[FloatArray, FloatArray], PoseArrays]
    is_fitted: bool = False  #: Whether numbers were fitted for the correction.
    is_of_truth: bool = False  #: Whether the truth has the mismatch and not the estimate.
    #: Whether the true and estimated poses can show the mismatch.
    applies: Callable[[PoseArrays, PoseArrays], bool] = lambda true, found: True

    def tried(self, compared: ComparedPoses) -> Tried:
        """Return the result of the correction."""
        true = compared.true
        found = compared.found
        left = disagreements(self.undo(*true), found) if self.is_of_truth else disagreements(true, self.undo(*found))
        hypothesis = Hypothesis(
            mismatch=self.name,
            sentence=f"the {'truth' if self.is_of_truth else 'estimate'} looks wrong: {self.sentence}",
            disagreement=float(np.mean(left)),
            fitted=self.is_fitted,
            setting=self.setting,
        )
        return Tried(hypothesis, left)


def _of_poses(compared: ComparedPoses) -> Iterator[Tried]:
    """Yield the mismatches that are corrected pose by pose."""
    if compared.plain is None:
        return
    fitted = _of_fitted_point(compared.true, compared.found)
    for item in (*MISMATCHES, *_of_units(compared), *_of_left_camera(compared.rig), *fitted):
        if item.applies(compared.true, compared.found):
            yield item.tried(compared)


def _motions_inverted(p: FloatArray, q: FloatArray) -> PoseArrays:
    back = quat_conjugate(q)
    return quat_rotate(back, p[0] - p), quat_multiply(back, q[0])


def _begins_elsewhere(true: PoseArrays, found: PoseArrays) -> bool:
    """Return whether the first pose differs from the identity, with which inverted motions equal inverted poses."""
    positions, quats = found
    return bool(np.abs(positions[0]).max() + quat_angle(quats[0]) > 1e-9)


def _moves_in_true_directions(true: PoseArrays, found: PoseArrays) -> bool:
    """Return whether the displacements have the directions of the true displacements.

    The displacements of a stationary rover are noise. Without this condition the unit millimetre would explain this
    noise, because a smaller unit reduces it.
    """
    starts, ends = eighths(len(true[0]))
    moves = [quat_rotate(quat_conjugate(q[starts]), p[ends] - p[starts]) for p, q in (true, found)]
    size = float(np.linalg.norm(moves[0]) * np.linalg.norm(moves[1]))
    return bool((moves[0] * moves[1]).sum() > MIN_CORRELATION * size)


WXYZ = [1, 2, 3, 0]  #: Columns x, y, z, w of a quaternion that was written as w, x, y, z.
OPTICAL = quat_from_matrix(OPTICAL_IN_BODY)
FRD = quat_from_matrix(FRD_IN_BODY)
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
        "swapped left and right images",
        "",
        "it moves backwards where the truth moves forwards: the left and right images are swapped",
        lambda p, q: (-p, q),
    ),
    Mismatch(
        "mirrored left and right",
        "mirrored=true",
        "left and right are mirrored (y points right): negate y, and x and z of the quaternions",
        lambda p, q: (p * MIRROR, q * MIRROR_QUAT),
    ),
    Mismatch(
        "axes of NED",
        "frame=rb_frd",
        "its attitudes are those of the axes x forward, y right, z down (NED): rotate them to RB; if the truth has "
        "these axes, --set 'truth.lever_quat_xyzw=[1, 0, 0, 0]' corrects the truth",
        lambda p, q: (p, quat_multiply(q, quat_conjugate(FRD))),
    ),
    Mismatch(
        "truth scalar first",
        "",
        "its quaternions are scalar first: write them scalar last, or name the columns (option --columns "
        "'truth:t,x,y,z,qw,qx,qy,qz')",
        lambda p, q: (p, q[:, WXYZ]),
        is_of_truth=True,
    ),
)
"""The mismatches whose correction has no fitted numbers."""


def _of_units(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches that the unit of the positions is not the metre.

    The ratio of the sizes does not show whether estimate or truth has the wrong unit. The estimate is corrected only if
    the truth has the speed of a vehicle and the estimate does not. Otherwise the truth is named, without a correction.
    """
    if not _moves_in_true_directions(compared.true, compared.found):
        return
    is_of_truth = not _has_speed_of_vehicle(compared.truth) or _has_speed_of_vehicle(compared.estimate)
    if is_of_truth:
        yield _unit_of_truth("kilometres", 1e3, "those of the estimate in millimetres")
        yield _unit_of_truth("millimetres", 1e-3, "those of the estimate in kilometres")
        return
    yield Mismatch(
        "millimetres",
        "metres_per_unit=0.001",
        "its positions are in millimetres: write metres",
        lambda p, q: (p * 1e-3, q),
    )
    yield Mismatch(
        "kilometres", "metres_per_unit=1000", "its positions are in kilometres: write metres", lambda p, q: (p * 1e3, q)
    )


def _unit_of_truth(unit: str, metres: float, otherwise: str) -> Mismatch:
    """Return the mismatch that the positions of the truth have another unit, of this number of metres."""
    return Mismatch(
        f"truth in {unit}",
        "",
        f"its positions are in {unit}, or {otherwise}: write metres",
        lambda p, q: (p * metres, q),
        is_of_truth=True,
    )


def _has_speed_of_vehicle(poses: Trajectory) -> bool:
    """Return whether the positions have the speed of a vehicle if they are in metres; poses are in time order.

    The quantile `SPEED_QUANTILE` of the speeds between successive poses is compared.
    """
    steps = np.linalg.norm(np.diff(poses.positions, axis=0), axis=1)
    speed = float(np.quantile(steps / (np.diff(poses.stamps_ns) / NS_PER_S), SPEED_QUANTILE))
    return SPEEDS[0] <= speed <= SPEEDS[1]


UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def _of_left_camera(rig: StereoRig | None) -> Iterator[Mismatch]:
    """Yield the mismatches in which the poses are poses of the left camera of the rig."""
    if rig is not None and rig.T_rb_sb is not None:
        lever = rig.T_rb_sb.apply(np.array([0.0, 0.5 * rig.baseline_m, 0.0]))
        turn = quat_from_matrix(rig.T_rb_sb.rotation.dot(OPTICAL_IN_BODY))
        yield _of_point("left camera", turn, lever, "optical axes", "frame=left_optical")
        yield _of_point("left camera", UPRIGHT, lever, "axes of RB", "")


def _of_fitted_point(truth: PoseArrays, estimate: PoseArrays) -> Iterator[Mismatch]:
    """Yield the mismatches in which the poses are poses of a camera or another point, with fitted extrinsics.

    The rotation of a tilted camera aligns the directions of the estimated motions with those of the true motions
    (Kabsch 1976). The directions are the rotation axes and displacements of the sub-trajectories in the frame of their
    start, weighted by their size.
    """
    starts, ends = eighths(len(estimate[0]))
    turns, moves, directions = [], [], []
    for positions, attitudes in (truth, estimate):
        back = quat_conjugate(attitudes[starts])
        turns.append(_upright(quat_multiply(back, attitudes[ends])))
        moves.append(quat_rotate(back, positions[ends] - positions[starts]))
        size = float(np.sqrt(np.square(moves[-1]).sum(axis=1).mean())) or 1.0
        directions.append(np.concatenate((turns[-1][:, :3], moves[-1] / size)))
    u, _, vt = np.linalg.svd(directions[0].T @ directions[1])
    fitted = quat_from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
    tilt_deg = float(np.degrees(quat_angle(quat_multiply(fitted, quat_conjugate(OPTICAL)))))
    axes = {"axes of RB": UPRIGHT, "optical axes": OPTICAL}
    if tilt_deg <= MAX_TILT_DEG:
        axes["tilted optical axes"] = fitted
    for name, turn in axes.items():
        # the lever arm l of the point whose poses are given: its displacements differ by `R l - l`
        matrix = (matrix_from_quat(turns[0]) - np.eye(3)).reshape(-1, 3)
        lever = np.asarray(np.linalg.lstsq(matrix, (quat_rotate(turn, moves[1]) - moves[0]).ravel(), rcond=1e-3)[0])
        if float(np.sqrt(lever @ lever)) >= MIN_LEVER_M:
            position = ", ".join(f"{value:.2f}" for value in lever)
            place = f"{name}, at {position} m in RB"
            yield _of_point("another point", turn, lever, place, "", is_fitted=True)


def _of_point(
    name: str, turn: FloatArray, lever_m: FloatArray, place: str, setting: str, *, is_fitted: bool = False
) -> Mismatch:
    """Return the mismatch in which the poses are poses of a camera or another point of RB, named `name`."""
    if not setting:
        numbers = (*lever_m.tolist(), *turn.tolist())
        setting = "extrinsics=" + ",".join(repr(round(number, 9)) for number in numbers)

    def undo(p: FloatArray, q: FloatArray) -> PoseArrays:
        of_rb = quat_multiply(q, quat_conjugate(turn))
        return p - quat_rotate(of_rb, lever_m), of_rb

    point = name if is_fitted else f"the {name}"
    sentence = f"its poses are those of {point} in place of RB ({place}): transform them by the extrinsics of the point"
    return Mismatch(name, setting, sentence, undo, is_fitted)


def _upright(quats: FloatArray) -> FloatArray:
    """Return quaternions of the same rotations with a scalar part >= 0."""
    return np.where(quats[:, 3:] < 0.0, -quats, quats)


# ---- offsets of the stamps


def _of_stamps(compared: ComparedPoses) -> Iterator[Tried]:
    """Yield the hypothesis that the stamps are offset, if most of the estimate has a truth with an offset."""
    begin_ns = 0
    if compared.plain is None and len(compared.estimate) and len(compared.truth):  # too few stamps are common
        begin_ns = int(compared.truth.stamps_ns[0]) - int(compared.estimate.stamps_ns[0])
    best = best_offset(compared.estimate, compared.truth, begin_ns)
    if best is None:
        return
    seconds = best.offset_ns / NS_PER_S
    periods = best.offset_ns / period_ns(compared.estimate)
    hypothesis = Hypothesis(
        mismatch=TIME_OFFSET,
        sentence="the stamps of estimate and truth are offset: add "
        f"{seconds:+.3f} s ({periods:+.3g} periods) to those of the estimate",
        disagreement=best.disagreement,
        fitted=True,
        setting=f"time_offset_ns={best.offset_ns}",
    )
    yield Tried(hypothesis, best.left)


HYPOTHESES: tuple[Callable[[ComparedPoses], Iterator[Tried]], ...] = (_of_poses, _of_stamps)
"""The mismatches that a diagnosis tries: those that are corrected pose by pose, and an offset of the stamps."""
