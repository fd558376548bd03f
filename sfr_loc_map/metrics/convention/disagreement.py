"""How much an estimate and the truth disagree, whatever the placing of the world frame.

The mean over sub-trajectories of the position error as a share of the path and the attitude error in radians, root of
the sum of squares, re-based by the whole pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.quaternion_kernels import row_difference
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.records.json_records import Key
from sfr_loc_map.metrics.trajectory.trajectory_error import ErrorColumn, PoseRows, sub_trajectory_errors

MIN_POSES = 8
SUB_TRAJECTORIES = 400
LOOKS_WRONG = "the estimate looks wrong:"

Poses = tuple[FloatArray, FloatArray]
"""Positions `(N, 3)` and unit quaternions `(N, 4)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """One convention mismatch and what undoing it does.

    Attributes:
        mismatch: Short name.
        sentence: What is wrong with the estimate, and what to do.
        disagreement: What is left when it is undone.
        fitted: Whether numbers were fitted to undo it.
        setting: What corrects it as `NAME=VALUE` of `PoseConvention`; empty where none does.
    """

    mismatch: Annotated[str, Key("mistake")]
    sentence: str
    disagreement: float
    fitted: bool = False
    setting: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """True and estimated poses side by side, and the sub-trajectories that are compared.

    Attributes:
        truth: True poses.
        estimate: Estimated poses.
        starts: `(M,)` rows of the starts.
        ends: `(M,)` rows of the ends.
    """

    truth: Poses
    estimate: Poses
    starts: IntArray
    ends: IntArray


def case_of(truth: Poses, estimate: Poses) -> Case:
    """Return the case of poses in time order, with sub-trajectories of an eighth of them."""
    return Case(truth, estimate, *_sub_trajectories(len(truth[0])))


@lru_cache(maxsize=8)
def _sub_trajectories(count: int) -> tuple[IntArray, IntArray]:
    """Return the starts and ends of so many poses."""
    span = max(2, count // 8)
    starts = np.unique(np.linspace(0, count - 1 - span, SUB_TRAJECTORIES).astype(np.int64))
    return starts, starts + span


def disagreement(case: Case, estimate: Poses) -> float:
    """Return the disagreement of estimated poses with the truth of a case."""
    no_length = np.zeros((len(case.truth[0]), 2))
    poses = PoseRows(*case.truth, np.ascontiguousarray(estimate[0]), np.ascontiguousarray(estimate[1]), no_length)
    errors = sub_trajectory_errors(poses, case.starts, poses, case.ends, True)
    position = np.sqrt(np.square(errors[:, :3]).sum(axis=1)) / _path_lengths(case)
    return float(np.mean(np.sqrt(np.square(position) + np.square(np.radians(errors[:, ErrorColumn.ATTITUDE])))))


def _path_lengths(case: Case) -> FloatArray:
    """Return the path length of each sub-trajectory, never much less than the mean."""
    until = _travelled(np.ascontiguousarray(case.truth[0]))
    lengths = until[case.ends] - until[case.starts]
    return np.asarray(np.maximum(lengths, max(0.1 * float(lengths.mean()), 1e-9)))


@jit
def _travelled(positions: FloatArray) -> FloatArray:
    """Return the path length `(N,)` up to each position `(N, 3)`."""
    until = np.zeros(len(positions))
    for i in range(1, len(positions)):
        x, y, z = row_difference(positions, i, positions, i - 1)
        until[i] = until[i - 1] + np.sqrt(x * x + y * y + z * z)
    return until
