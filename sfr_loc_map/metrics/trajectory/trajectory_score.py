"""The trajectory score: frames in, figures out; the same path for a file at once and for a live run."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.condition import Condition, ConditionKind
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.modes import AssociationMode
from sfr_loc_map.metrics.records.score_details import PathRows, TrajectoryDetails
from sfr_loc_map.metrics.score import AssociationCounts, AssociationScore, TrajectoryScore
from sfr_loc_map.metrics.statistics.running_statistics import Decimated, column, integers
from sfr_loc_map.metrics.trajectory.association import Estimates, Frames, associate_in_portions
from sfr_loc_map.metrics.trajectory.condition_scorer import ConditionScorer
from sfr_loc_map.metrics.trajectory.start_queue import StartQueue
from sfr_loc_map.metrics.trajectory.sub_trajectories import Progress, path_lengths

PATH_ROWS = 2000
"""Frames that are kept for figures."""
CHUNK_FRAMES = 16384
POSITION_VARIANCES = (0, 6, 11)
"""Columns of the upper triangle of a 6 x 6 covariance that hold the variances of x, y and z."""
DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Distances of the error against distance travelled."""
DISTANCES_SPACING, DISTANCES_BASE_M = 10, 50.0
"""Their starts are at least this many frames apart, whatever the spacing of the conditions; beyond the base in
proportion to the distance: the more sub-trajectories overlap, the less one more says, and all starts wait for their
end."""


@dataclass(frozen=True, slots=True)
class ScoredTrajectory:
    """What the trajectory adds to the score.

    Attributes:
        score: The part `trajectory`.
        details: What figures are drawn from, None if it is not wanted.
    """

    score: TrajectoryScore
    details: TrajectoryDetails | None


class TrajectoryScorer:
    """Scores frames as they come; memory and cost per frame do not grow with the length of the run."""

    def __init__(self, config: TrajectoryScoreConfig) -> None:
        """Prepare for the conditions of the settings.

        Raises:
            MetricsError: If a condition is not valid.
        """
        self._association = config.association
        self._starts: dict[int, StartQueue] = {}
        self._conditions = [
            ConditionScorer(Condition.parse(text), config, self._starts_every(config.spacing))
            for text in config.conditions
        ]
        if not self._conditions:
            raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
        self._error_by_distance = [
            ConditionScorer(
                Condition(ConditionKind.DISTANCE, metres), spaced, self._starts_every(spaced.spacing), brief=True
            )
            for metres in DISTANCES_M
            for spaced in [_spaced(config, metres)]
        ]
        self._frames = 0
        self._length = np.zeros(2)
        self._last = np.full(3, np.nan)
        self._span_ns: tuple[int, int] | None = None
        self._path = Decimated(11, PATH_ROWS)
        self._path_stamps = Decimated(1, PATH_ROWS, np.int64)
        self._path_states = Decimated(2, PATH_ROWS, np.bool_)

    def _starts_every(self, spacing: int) -> StartQueue:
        return self._starts.setdefault(spacing, StartQueue(spacing))

    def copy(self) -> TrajectoryScorer:
        """Return a scorer that goes on independently from here."""
        return copy.deepcopy(self)

    def push(self, frames: Frames) -> None:
        """Add frames, later than all before."""
        for first in range(0, len(frames), CHUNK_FRAMES):
            self._push(frames.rows(slice(first, first + CHUNK_FRAMES)))

    def _push(self, frames: Frames) -> None:
        lengths = path_lengths(frames.gt_pos, self._last, self._length)
        progress = Progress(self._frames + np.arange(len(frames)), frames.stamps_ns, lengths)
        scorers = (*self._conditions, *self._error_by_distance)
        for starts in self._starts.values():
            starts.append(frames, progress)
        for scorer in scorers:
            scorer.push(frames, progress)
        for spacing, starts in self._starts.items():
            starts.drop(min(scorer.passed for scorer in scorers if scorer.spacing == spacing))
        self._frames += len(frames)
        first_ns = int(frames.stamps_ns[0]) if self._span_ns is None else self._span_ns[0]
        self._span_ns = first_ns, int(frames.stamps_ns[-1])
        self._path.push(np.column_stack((frames.gt_pos, frames.est_pos, lengths, _position_sigmas(frames))))
        self._path_stamps.push(frames.stamps_ns[:, None])
        self._path_states.push(np.column_stack((frames.lost, frames.degraded)))

    def result(self, counts: AssociationCounts, mode: AssociationMode, *, details: bool = True) -> ScoredTrajectory:
        """Return the score of all frames so far.

        Args:
            counts: What became of the poses.
            mode: How they were associated.
            details: Whether what figures are drawn from is wanted.
        """
        each = tuple(scorer.result() for scorer in self._conditions)
        association = AssociationScore(
            counts=counts,
            mode=mode,
            tolerance_s=self._association.tolerance_s,
            max_gap_s=self._association.max_gap_s,
        )
        score = TrajectoryScore(
            first=each[0],
            matched=counts.matched,
            estimate_poses=counts.estimate_poses,
            lost=counts.lost,
            degraded=counts.degraded,
            path_length_m=float(self._length[0] + self._length[1]),
            duration_s=None if self._span_ns is None else (self._span_ns[1] - self._span_ns[0]) / NS_PER_S,
            discarded_starts=sum(scorer.discarded_starts for scorer in self._conditions),
            association=association,
            several=each if len(each) > 1 else (),
            by_distance=tuple(scorer.brief() for scorer in self._error_by_distance if scorer.count),
        )
        return ScoredTrajectory(score, self._details() if details else None)

    def _details(self) -> TrajectoryDetails:
        rows = self._path.rows
        truth, estimate = ([column(values) for values in rows[:, first : first + 3].T] for first in (0, 3))
        known = np.isfinite(rows[:, 8:]).any()
        sigmas = [column(values) if known else () for values in rows[:, 8:].T]
        path = PathRows(
            every=self._path.step,
            stamp_ns=integers(self._path_stamps.rows[:, 0]),
            travelled_m=column(rows[:, 6] + rows[:, 7]),
            truth_x_m=truth[0],
            truth_y_m=truth[1],
            truth_z_m=truth[2],
            estimate_x_m=estimate[0],
            estimate_y_m=estimate[1],
            estimate_z_m=estimate[2],
            lost=tuple(self._path_states.rows[:, 0].tolist()),
            degraded=tuple(self._path_states.rows[:, 1].tolist()),
            sigma_x_m=sigmas[0],
            sigma_y_m=sigmas[1],
            sigma_z_m=sigmas[2],
        )
        return TrajectoryDetails(path=path, sub_trajectories=tuple(scorer.details() for scorer in self._conditions))


def _spaced(config: TrajectoryScoreConfig, metres: float) -> TrajectoryScoreConfig:
    spacing = round(DISTANCES_SPACING * max(metres / DISTANCES_BASE_M, 1.0))
    return replace(config, spacing=max(config.spacing, spacing))


def _position_sigmas(frames: Frames) -> FloatArray:
    """Return sigma of x, y and z `(N, 3)` by the covariances, m, NaN where they are not known."""
    if frames.covariance is None:
        return np.full((len(frames), 3), np.nan)
    variances = frames.covariance[:, POSITION_VARIANCES]
    return np.sqrt(np.where(variances >= 0.0, variances, np.nan))


def score_trajectory(estimates: Estimates, truth: Trajectory, config: TrajectoryScoreConfig) -> ScoredTrajectory:
    """Return the score of a trajectory.

    Args:
        estimates: Estimated poses of RB in DS, in any order.
        truth: True poses of RB in DS, in any order.
        config: Settings.

    Raises:
        MetricsError: If no estimate has a truth, or a condition is not valid.
    """
    scorer = TrajectoryScorer(config)
    portions, counts, mode = associate_in_portions(estimates, truth, config.association, CHUNK_FRAMES)
    if not counts.matched:
        raise MetricsError(_nothing_in_common(estimates.trajectory, truth))
    for frames in portions:
        scorer.push(frames)
    return scorer.result(counts, mode)


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
