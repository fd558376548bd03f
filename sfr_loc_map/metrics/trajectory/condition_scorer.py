"""The figures of one condition, from frames that come in any portions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.modes import Rebase
from sfr_loc_map.metrics.records.score_details import SubTrajectoryRows
from sfr_loc_map.metrics.score import ConditionScore, DistanceScore, ErrorComponents, IntervalStatistic, Statistic
from sfr_loc_map.metrics.statistics.running_statistics import Decimated, Moments, column, integers, norm
from sfr_loc_map.metrics.trajectory.association import Frames
from sfr_loc_map.metrics.trajectory.confidence import BlockSums, interval95
from sfr_loc_map.metrics.trajectory.consistency import Consistency, PoseSample
from sfr_loc_map.metrics.trajectory.relative_covariance import unknown_sums
from sfr_loc_map.metrics.trajectory.start_queue import StartQueue, Starts
from sfr_loc_map.metrics.trajectory.sub_trajectories import KINDS, Progress, find_ends
from sfr_loc_map.metrics.trajectory.trajectory_error import ErrorColumn, PoseRows, sub_trajectory_errors

MAX_WAITING_STARTS = 1_000_000
"""A start that has waited for its end through so many others is discarded."""
MAX_WAITING_BRIEF = 5000
"""The same where a condition is brief."""
DETAIL_ROWS = 1000
"""Sub-trajectories of each condition that are kept for figures."""
POSITION, ATTITUDE, HEADING = slice(0, 3), slice(3, 4), slice(4, 5)
"""Columns of the errors that the figures of the score are made of."""
INTERVAL_COLUMNS = 5


class ConditionScorer:
    """Scores the sub-trajectories of one condition.

    Attributes:
        condition: What ends them.
        discarded_starts: Starts that waited for their end for too long.
        spacing: Frames from one start to the next.
        passed: Starts that need no end any more.
    """

    def __init__(
        self, condition: Condition, config: TrajectoryScoreConfig, starts: StartQueue, *, brief: bool = False
    ) -> None:
        """Start without a frame.

        Args:
            condition: What ends a sub-trajectory.
            config: Spacing and re-basing.
            starts: Starts of that spacing; those of frames that are pushed are there already.
            brief: Whether only `brief` is needed: no interval, no consistency, no details.
        """
        self.condition = condition
        self.discarded_starts = self.passed = 0
        self.spacing, self._rebase, self._brief = config.spacing, Rebase(config.rebase), brief
        self._most_frames = (MAX_WAITING_BRIEF if brief else MAX_WAITING_STARTS) * config.spacing
        self._starts = starts
        self._moments = Moments(len(ErrorColumn))
        self._blocks = BlockSums(INTERVAL_COLUMNS)
        self._consistency = Consistency()
        self._overlaps = 0
        self._kept_errors = Decimated(len(ErrorColumn), DETAIL_ROWS)
        self._kept_spans = Decimated(4, DETAIL_ROWS, np.int64)

    @property
    def count(self) -> int:
        """Sub-trajectories so far."""
        return self._moments.count

    def push(self, frames: Frames, progress: Progress) -> None:
        """Add frames."""
        starts, first_frame = self._starts.waiting(self.passed), int(progress.frames[0])
        waiting = Progress(starts["frame"], starts["stamp"], starts["length"])
        ends = find_ends(waiting, progress, KINDS[self.condition.kind], self.condition.threshold)
        ends = ends[: np.searchsorted(ends, len(frames))]
        # what is discarded depends on frames alone, not on the portions that they come in
        rows = np.flatnonzero(first_frame + ends - starts["frame"][: len(ends)] <= self._most_frames)
        if len(rows):
            self._score((frames, progress), starts, rows, ends[rows])
        last = first_frame + len(frames) - 1
        too_old = int(np.searchsorted(starts["frame"][len(ends) :], last - self._most_frames, side="right"))
        self.passed += len(ends) + too_old
        self.discarded_starts += len(ends) - len(rows) + too_old

    def _score(self, pushed: tuple[Frames, Progress], starts: Starts, rows: NDArray[np.intp], ends: IntArray) -> None:
        frames, progress = pushed
        first = PoseRows(starts["gt_pos"], starts["gt_quat"], starts["est_pos"], starts["est_quat"], starts["length"])
        last = PoseRows(frames.gt_pos, frames.gt_quat, frames.est_pos, frames.est_quat, progress.lengths)
        errors = sub_trajectory_errors(first, rows, last, ends, self._rebase is Rebase.POSE)
        self._moments.push(errors)
        if self._brief:
            return
        numbers, end_numbers = starts["frame"][rows], progress.frames[ends]
        self._blocks.push(errors[:, :INTERVAL_COLUMNS])
        self._overlaps += int(np.sum(-(-(end_numbers - numbers) // self.spacing)))
        self._kept_errors.push(errors)
        self._check_covariance(pushed, starts, rows, ends)
        spans = (numbers, end_numbers, starts["stamp"][rows], progress.stamps_ns[ends])
        self._kept_spans.push(np.column_stack(spans))

    def _check_covariance(
        self, pushed: tuple[Frames, Progress], starts: Starts, rows: NDArray[np.intp], ends: IntArray
    ) -> None:
        frames, progress = pushed
        if frames.covariance is None:
            return
        first_sums, last_sums = unknown_sums(len(starts["frame"])), unknown_sums(len(frames))
        if frames.sums is not None:
            first_sums, last_sums = starts["sums"], frames.sums
        true, found = (starts["gt_pos"], starts["gt_quat"]), (starts["est_pos"], starts["est_quat"])
        first = PoseSample(*true, *found, starts["covariance"], first_sums)
        last = PoseSample(frames.gt_pos, frames.gt_quat, frames.est_pos, frames.est_quat, frames.covariance, last_sums)
        numbers = starts["frame"]
        for row, end in zip(rows.tolist(), ends.tolist(), strict=True):
            start = int(numbers[row])
            if start >= self._consistency.free_from:
                self._consistency.push((start, int(progress.frames[end])), first.row(row), last.row(end))

    def result(self) -> ConditionScore:
        """Return the score of the condition."""
        overlap = self._overlaps / max(self._moments.count, 1)
        return ConditionScore(
            count=self._moments.count,
            condition=self.condition,
            spacing_frames=self.spacing,
            rebase=self._rebase,
            position_m=self._figure(POSITION, overlap),
            attitude_deg=self._figure(ATTITUDE, overlap, unsigned=True),
            heading_deg=self._figure(HEADING, overlap),
            overlap=overlap,
            nees=self._consistency.result(),
            components=self._components(),
        )

    def brief(self) -> DistanceScore:
        """Return the plain figures of a distance."""
        return DistanceScore(
            distance_m=self.condition.value,
            count=self._moments.count,
            position_m=statistic(self._moments, POSITION),
            attitude_deg=statistic(self._moments, ATTITUDE),
            heading_deg=statistic(self._moments, HEADING),
        )

    def details(self) -> SubTrajectoryRows:
        """Return the sub-trajectories, or every n-th of them."""
        start_frame, end_frame, start_stamp, end_stamp = map(integers, self._kept_spans.rows.T)
        errors = [column(values) for values in self._kept_errors.rows.T]
        return SubTrajectoryRows(
            condition=self.condition,
            every=self._kept_spans.step,
            start_frame=start_frame,
            end_frame=end_frame,
            start_stamp_ns=start_stamp,
            end_stamp_ns=end_stamp,
            x_m=errors[ErrorColumn.X],
            y_m=errors[ErrorColumn.Y],
            z_m=errors[ErrorColumn.Z],
            attitude_deg=errors[ErrorColumn.ATTITUDE],
            heading_deg=errors[ErrorColumn.HEADING],
            along_m=errors[ErrorColumn.ALONG],
            cross_m=errors[ErrorColumn.CROSS],
            vertical_m=errors[ErrorColumn.VERTICAL],
            travelled_m=errors[ErrorColumn.TRAVELLED],
        )

    def _figure(self, columns: slice, overlap: float, *, unsigned: bool = False) -> IntervalStatistic:
        plain = statistic(self._moments, columns)
        return IntervalStatistic(
            mean=plain.mean,
            sigma=plain.sigma,
            mean_plus_3sigma=plain.mean_plus_3sigma,
            mean_plus_3sigma_ci95=interval95(self._blocks, columns, overlap, unsigned=unsigned),
        )

    def _components(self) -> ErrorComponents:
        def of(index: ErrorColumn) -> Statistic:
            return statistic(self._moments, slice(index, index + 1))

        return ErrorComponents(
            x_m=of(ErrorColumn.X),
            y_m=of(ErrorColumn.Y),
            z_m=of(ErrorColumn.Z),
            along_m=of(ErrorColumn.ALONG),
            cross_m=of(ErrorColumn.CROSS),
            vertical_m=of(ErrorColumn.VERTICAL),
        )


def statistic(moments: Moments, columns: slice) -> Statistic:
    """Return the statistic of some columns [4.2.3]; None where undefined.

    Of several columns the norm of the mean vector and the norm of the sigmas; of one the mean with its sign, which is
    left out in mean + 3 sigma.
    """
    mean = magnitude(moments.mean[columns]) if moments.count else None
    sigma = None if moments.sigma is None else magnitude(moments.sigma[columns])
    total = None if mean is None or sigma is None else abs(mean) + 3.0 * sigma
    return Statistic(mean=mean, sigma=sigma, mean_plus_3sigma=total)


def magnitude(values: FloatArray) -> float:
    """Return the norm of a vector, a single number as it is."""
    return float(values[0]) if len(values) == 1 else norm(values)
