"""Which single convention mismatch would explain that an estimate and the truth disagree?

Each is undone in turn and the disagreement measured again. One is named only if undoing it leaves a half or less of the
disagreement (a third, if numbers are fitted to undo it); a pair that agrees is never far from the best it can be,
whatever is undone, and nothing is named.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.convention.convention_hypotheses import convention_hypotheses, frame_hypotheses
from sfr_loc_map.metrics.convention.disagreement import MIN_POSES, Hypothesis, case_of, disagreement
from sfr_loc_map.metrics.convention.time_offset import time_offset_hypotheses
from sfr_loc_map.metrics.records.json_records import Key
from sfr_loc_map.metrics.trajectory.association import Estimates, associate
from sfr_loc_map.metrics.trajectory.stamp_matching import unique_rows

GAIN = 2.0
"""Undoing a mismatch must make the disagreement this many times smaller."""
GAIN_FITTED = 3.0
"""The same where numbers were fitted to undo it."""
AGREES = 1e-3
"""A disagreement below this (a thousandth of the path, or 0.06 degrees) needs no explanation."""
EXPLAINED = 0.25
"""What is left must be less than this (a quarter of the path, or 14 degrees)."""
SIMPLER = 2.0
"""A mismatch with fitted numbers must explain this many times more than one without."""
MAX_POSES = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What was found.

    Attributes:
        disagreement: As the estimate stands; None where estimate and truth have no stamp in common.
        hypotheses: All mismatches looked into, the best explanation first.
        found: The mismatch that explains the disagreement, None if none does or there is nothing to explain.
    """

    disagreement: float | None
    hypotheses: Annotated[tuple[Hypothesis, ...], Key("suspicions")]
    found: Hypothesis | None


def diagnose(
    estimate: Trajectory, truth: Trajectory, config: AssociationConfig, T_rb_left: Transform | None = None
) -> Diagnosis:
    """Find the single convention mismatch that explains how estimate and truth disagree.

    Args:
        estimate: Estimated poses of RB in DS.
        truth: True poses of RB in DS.
        config: How estimates find their truth.
        T_rb_left: Extrinsics of the left camera, where they are known.
    """
    step = max(1, len(estimate) // MAX_POSES)
    rows = unique_rows(estimate.stamps_ns)[::step]
    estimate = Trajectory(estimate.stamps_ns[rows], estimate.positions[rows], estimate.quats_xyzw[rows])
    frames = associate(Estimates.of(estimate), truth, config)[0]
    hypotheses: list[Hypothesis] = []
    before = None
    if len(frames) >= MIN_POSES:
        case = case_of((frames.gt_pos, frames.gt_quat), (frames.est_pos, frames.est_quat))
        before = disagreement(case, case.estimate)
        hypotheses += convention_hypotheses(case)
        hypotheses += frame_hypotheses(case, T_rb_left)
    hypotheses += time_offset_hypotheses(estimate, truth, before)
    hypotheses.sort(key=lambda item: item.disagreement)
    return Diagnosis(disagreement=before, hypotheses=tuple(hypotheses), found=_best(before, hypotheses))


def _best(before: float | None, hypotheses: list[Hypothesis]) -> Hypothesis | None:
    if before is not None and before < AGREES:
        return None
    most = np.inf if before is None else before
    possible = [
        item
        for item in hypotheses
        if item.disagreement <= min(EXPLAINED, most / (GAIN_FITTED if item.fitted else GAIN))
    ]
    if not possible:
        return None
    plain = [item for item in possible if not item.fitted]
    if plain and plain[0].disagreement <= SIMPLER * possible[0].disagreement:
        return plain[0]
    return possible[0]
