"""Absolute and relative pose error (APE, RPE) after an alignment.

APE and RPE are defined as in Sturm et al. 2012 (IROS, section IV) and in evo. For the same files, the errors
equal those of evo, except for the standard deviation, which evo computes with the divisor n. docs/metrics.md describes
how poses are paired.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    quat_angle,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_normalised,
    quat_rotate,
)
from sfr_loc_map.geometry.trajectory import Trajectory, as_truth, at_point
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.conditions import Component, Condition, ConditionKind
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.figures.records import Alignment
from sfr_loc_map.metrics.figures.row_part import ROTATION, TRANSLATION
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.formulas import statistics
from sfr_loc_map.metrics.frames.association import check_attitudes, unique_rows
from sfr_loc_map.metrics.frames.true_attitudes import check_true_attitudes, incomplete_attitudes, known_attitudes
from sfr_loc_map.metrics.frames.umeyama import Similarity, umeyama
from sfr_loc_map.metrics.other_formulas import relative_motions
from sfr_loc_map.stamp_pairing import nearest_stamps


class AlignedPoses(NamedTuple):
    """Paired poses with unit quaternions after the alignment, and the similarity that was applied to the estimate."""

    estimate: Trajectory
    truth: Trajectory
    similarity: Similarity | None

    def errors_m(self) -> FloatArray:
        """Return the distance of each estimate from the truth."""
        return np.asarray(np.linalg.norm(self.estimate.positions - self.truth.positions, axis=1))


class AlignedErrors(NamedTuple):
    """APE and RPE, and how they were computed."""

    figures: tuple[Figure, ...]
    alignment: Alignment


def aligned_errors(estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig) -> AlignedErrors:
    """Return the absolute and relative pose error of an estimate; its poses may be in any order.

    Without true attitudes, rotation errors are unknown, and relative errors are those of displacements in DS. Without
    true roll and pitch, rotation errors are unknown, and the truth has the roll and pitch of the estimate.
    MetricsError if the estimate has no attitudes, if the truth has no heights, if no stamps are within
    `max_difference`, or if the alignment is undetermined.
    """
    known = as_truth(truth)
    if not known.has_height:
        raise MetricsError("APE and RPE require true heights, which the truth does not have: omit the option align")
    poses = aligned_poses(estimate, truth, config)
    delta = Condition.parse(config.rpe_delta)
    # relative error E = inv(inv(Q_i) Q_j) inv(P_i) P_j with the truth Q and the estimate P; the next motion starts at j
    ends = _ends(poses.estimate.positions, delta.components[0])
    spans = ends[:-1], ends[1:]
    true_move, true_turn = relative_motions(poses.truth.positions, poses.truth.quats_xyzw, *spans)
    move, turn = relative_motions(poses.estimate.positions, poses.estimate.quats_xyzw, *spans)
    figures: list[Figure] = []
    for name, errors_m, true_quats, quats in (
        ("ape", poses.errors_m(), poses.truth.quats_xyzw, poses.estimate.quats_xyzw),
        ("rpe", np.linalg.norm(move - true_move, axis=1), true_turn, turn),
    ):
        errors_deg = np.degrees(quat_angle(quat_multiply(quat_conjugate(true_quats), quats)))
        known_deg = errors_deg if incomplete_attitudes(known) is None else errors_deg[:0]
        figures.append(figure_row(name, part=TRANSLATION, statistics=statistics(errors_m)))
        figures.append(figure_row(name, part=ROTATION, statistics=statistics(known_deg)))
    similarity = poses.similarity or Similarity(1.0, np.eye(3), np.zeros(3))
    if not known.has_attitude:
        attitudes = "; relative errors are of displacements in DS"
    else:
        attitudes = "" if known.has_tilt else "; roll and pitch of the truth are those of the estimate"
    alignment = Alignment(
        align=config.align,
        association=f"{len(poses.truth)} poses paired by the nearest stamp{attitudes}",
        max_difference_s=config.max_difference,
        rpe_delta=delta.setting,
        scale=similarity.scale,
        quat_xyzw=tuple(quat_from_matrix(similarity.rotation).tolist()),
        translation_m=tuple(similarity.translation.tolist()),
    )
    return AlignedErrors(tuple(figures), alignment)


def aligned_poses(estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig) -> AlignedPoses:
    """Return paired poses after the alignment.

    Unknown components of the true attitudes are those of the aligned estimate. The alignment `origin` requires the true
    heading, and is a yaw without true roll and pitch. MetricsError if the estimate has no attitudes, if no stamps are
    within `max_difference`, or if the alignment is undetermined.
    """
    check_attitudes(estimate)
    known = as_truth(truth)
    if not known.has_attitude:
        if config.align == "origin":
            check_true_attitudes(known, "align=origin", "use align=se3 or none")
        estimate = at_point(estimate, known.lever_arm_m)
    estimate_rows, true_rows = unique_rows(estimate.stamps_ns), unique_rows(truth.stamps_ns)
    estimate_stamps, true_stamps = estimate.stamps_ns[estimate_rows], truth.stamps_ns[true_rows]
    estimate_is_longer = len(estimate_rows) > len(true_rows)
    few, many = (true_stamps, estimate_stamps) if estimate_is_longer else (estimate_stamps, true_stamps)
    short = long = np.zeros(0, np.intp)
    if len(few):  # each pose of the shorter trajectory is paired with the nearest pose of the longer one
        nearest, difference = nearest_stamps(few, many)
        short = np.flatnonzero(difference <= round(config.max_difference * NS_PER_S))
        long = nearest[short]
    mine, theirs = (long, short) if estimate_is_longer else (short, long)
    if not len(mine):
        raise MetricsError(
            f"no stamps of estimate and truth are within {config.max_difference:g} s of each other, so there is "
            "no APE: increase the option max_difference, or omit the option align"
        )
    est, true = (
        Trajectory(
            each.stamps_ns[rows],
            each.positions[rows],
            quat_normalised(each.quats_xyzw[rows]) if each.has_attitude else each.quats_xyzw[rows],
        )
        for each, rows in ((estimate, estimate_rows[mine]), (truth, true_rows[theirs]))
    )
    similarity = None
    if config.align == "origin":
        first = known_attitudes(known, true.quats_xyzw[:1], est.quats_xyzw[:1])[0]
        turn = quat_multiply(first, quat_conjugate(est.quats_xyzw[0]))
        translation = true.positions[0] - quat_rotate(turn, est.positions[0])
        similarity = Similarity(1.0, matrix_from_quat(turn), translation)
    elif config.align != "none":
        similarity = umeyama(est.positions, true.positions, with_scale=config.align == "sim3")
    if similarity is not None:
        turned = quat_multiply(quat_from_matrix(similarity.rotation), est.quats_xyzw)
        moved = (similarity.scale * est.positions) @ similarity.rotation.T + similarity.translation
        est = Trajectory(est.stamps_ns, np.asarray(moved), turned)
    true = Trajectory(true.stamps_ns, true.positions, known_attitudes(known, true.quats_xyzw, est.quats_xyzw))
    return AlignedPoses(est, true, similarity)


def _ends(positions: FloatArray, delta: Component) -> NDArray[np.intp]:
    if delta.kind is ConditionKind.FRAMES:
        return np.arange(0, len(positions), int(delta.value), dtype=np.intp)
    ends, travelled = [0], 0.0
    for index, step in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1).tolist(), 1):
        travelled += step
        if travelled >= delta.value:
            ends.append(index)
            travelled = 0.0
    return np.array(ends, np.intp)
