"""The trajectory score: frames in, figures out; the same path for a file at once and for a live run."""

from __future__ import annotations

import copy
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.association import Estimates, Frames, associate
from sfr_loc_map.metrics.condition import Condition, ConditionKind
from sfr_loc_map.metrics.condition_score import ConditionScore, rounded
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score import AssociationCounts
from sfr_loc_map.metrics.statistics import Decimated
from sfr_loc_map.metrics.sub_trajectories import path_lengths

PATH_ROWS = 2000
"""Frames that are kept for figures."""
CHUNK_FRAMES = 65536
POSITION_VARIANCES = (0, 6, 11)
"""Columns of the upper triangle of a 6 x 6 covariance that hold the variances of x, y and z."""
LADDER_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Distances of the error against distance travelled."""
LADDER_SPACING, LADDER_BASE_M = 10, 50.0
"""Its starts are at least this many frames apart, whatever the spacing of the conditions; beyond the base in proportion
to the distance: the more sub-trajectories overlap, the less one more says, and all starts wait for their end."""


class TrajectoryScorer:
    """Scores frames as they come; memory and cost per frame do not grow with the length of the run."""

    def __init__(self, config: TrajectoryScoreConfig) -> None:
        """Prepare for the conditions of the settings.

        Raises:
            MetricsError: If a condition is not valid.
        """
        self._config = config
        self._conditions = [ConditionScore(Condition.parse(text)) for text in config.conditions]
        if not self._conditions:
            raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
        self._ladder = [
            (ConditionScore(Condition(ConditionKind.DISTANCE, metres), brief=True), _ladder_config(config, metres))
            for metres in LADDER_M
        ]
        self._frames = 0
        self._length = np.zeros(2)
        self._last = np.full(3, np.nan)
        self._first_stamp_ns: int | None = None
        self._last_stamp_ns: int | None = None
        self._path = Decimated(11, PATH_ROWS)
        self._path_stamps = Decimated(1, PATH_ROWS, np.int64)
        self._path_lost = Decimated(1, PATH_ROWS, np.bool_)

    def copy(self) -> TrajectoryScorer:
        """Return a score that goes its own way from here."""
        return copy.deepcopy(self)

    def push(self, frames: Frames) -> None:
        """Add frames, later than all before."""
        for first in range(0, len(frames), CHUNK_FRAMES):
            self._push(frames.rows(slice(first, first + CHUNK_FRAMES)))

    def _push(self, frames: Frames) -> None:
        lengths = path_lengths(frames.gt_pos, self._last, self._length)
        for condition in self._conditions:
            condition.push(frames, lengths, self._frames, self._config)
        for step, config in self._ladder:
            step.push(frames, lengths, self._frames, config)
        self._frames += len(frames)
        if self._first_stamp_ns is None:
            self._first_stamp_ns = int(frames.stamps_ns[0])
        self._last_stamp_ns = int(frames.stamps_ns[-1])
        self._path.push(np.column_stack((frames.gt_pos, frames.est_pos, lengths, _position_sigmas(frames))))
        self._path_stamps.push(frames.stamps_ns[:, None])
        self._path_lost.push(frames.lost[:, None])

    def result(self, counts: AssociationCounts, way: str, *, details: bool = True) -> dict[str, Any]:
        """Return `{"trajectory": ..., "details": {"trajectory": ...}}` of the score, without details if not wanted."""
        each = [condition.result(self._config) for condition in self._conditions]
        trajectory = {**each[0], "matched": counts.matched, "estimate_poses": counts.estimate_poses}
        trajectory |= self._facts(counts, way)
        if len(each) > 1:
            trajectory["conditions"] = each
        trajectory["by_distance"] = [step.brief() for step, _ in self._ladder if step.moments.count]
        return {"trajectory": trajectory} | ({"details": {"trajectory": self._details()}} if details else {})

    def _facts(self, counts: AssociationCounts, way: str) -> dict[str, Any]:
        association = asdict(counts) | {
            "truth": way,
            "tolerance_s": self._config.association.tolerance_s,
            "max_gap_s": self._config.association.max_gap_s,
        }
        duration = None
        if self._first_stamp_ns is not None and self._last_stamp_ns is not None:
            duration = (self._last_stamp_ns - self._first_stamp_ns) / NS_PER_S
        return {
            "lost": counts.lost,
            "path_length_m": float(self._length[0] + self._length[1]),
            "duration_s": duration,
            "starts_given_up": sum(condition.given_up for condition in self._conditions),
            "association": association,
        }

    def _details(self) -> dict[str, Any]:
        rows = self._path.rows
        path = {"every": self._path.step, "stamp_ns": self._path_stamps.rows[:, 0].tolist()}
        path |= {"travelled_m": rounded(rows[:, 6] + rows[:, 7])}
        for k, name in enumerate(("truth_x", "truth_y", "truth_z", "estimate_x", "estimate_y", "estimate_z")):
            path[name + "_m"] = rounded(rows[:, k])
        path["lost"] = self._path_lost.rows[:, 0].tolist()
        if np.isfinite(rows[:, 8:]).any():
            path |= {f"sigma_{axis}_m": rounded(rows[:, 8 + k]) for k, axis in enumerate("xyz")}
        return {"path": path, "sub_trajectories": [condition.details() for condition in self._conditions]}


def _ladder_config(config: TrajectoryScoreConfig, metres: float) -> TrajectoryScoreConfig:
    return replace(config, spacing=max(config.spacing, round(LADDER_SPACING * max(metres / LADDER_BASE_M, 1.0))))


def _position_sigmas(frames: Frames) -> FloatArray:
    """Return sigma of x, y and z `(N, 3)` that the covariances say, m, NaN where they are not known."""
    if frames.covariance is None:
        return np.full((len(frames), 3), np.nan)
    variances = frames.covariance[:, POSITION_VARIANCES]
    return np.sqrt(np.where(variances >= 0.0, variances, np.nan))


def score_trajectory(estimates: Estimates, truth: Trajectory, config: TrajectoryScoreConfig) -> dict[str, Any]:
    """Return `{"trajectory": ..., "details": {"trajectory": ...}}`, plain values ready for JSON.

    Args:
        estimates: Estimated poses of RB in DS, in any order.
        truth: True poses of RB in DS, in any order.
        config: Settings.

    Raises:
        MetricsError: If no estimate has a truth, or a condition is not valid.
    """
    score = TrajectoryScorer(config)
    frames, counts, way = associate(estimates, truth, config.association)
    if not len(frames):
        raise MetricsError(_nothing_in_common(estimates.trajectory, truth))
    score.push(frames)
    return score.result(counts, way)


def _nothing_in_common(estimate: Trajectory, truth: Trajectory) -> str:
    spans = []
    for name, poses in (("the estimate", estimate), ("the truth", truth)):
        ends = (
            f" from {poses.stamps_ns.min() / NS_PER_S:.3f} s to {poses.stamps_ns.max() / NS_PER_S:.3f} s"
            if len(poses)
            else ""
        )
        spans.append(f"{name} has {len(poses)} poses{ends}")
    return (
        f"no estimate has a truth at its stamp: {', '.join(spans)}; give trajectories of the same drive and clock "
        "(sfr doctor finds a clock that is off)"
    )
