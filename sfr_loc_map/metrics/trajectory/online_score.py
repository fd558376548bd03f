"""The trajectory score of a run that is still going on.

Poses come one by one and in any order within a window; they are associated and scored by the very functions that score
files, in portions, so that `result` has the bits that `score_trajectory` gives for the same poses. Cost per pose is
constant on average. What is kept does not grow with the run: poses that wait for their truth (at most
`MAX_WAITING_POSES` of each kind), starts that wait for their end (`MAX_WAITING_STARTS` of each condition), sums, and
thinned rows for figures.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import is_plausible_pose
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.modes import AssociationMode
from sfr_loc_map.metrics.score import AssociationCounts
from sfr_loc_map.metrics.trajectory.association import COVARIANCE_SIZE, UPPER, Estimates, Frames, join
from sfr_loc_map.metrics.trajectory.relative_covariance import STEP_SIZE, StepSums
from sfr_loc_map.metrics.trajectory.stamp_matching import AUTO_STAMPS, decide_mode, tolerance_ns, unique_rows
from sfr_loc_map.metrics.trajectory.trajectory_score import ScoredTrajectory, TrajectoryScorer

WINDOW_POSES = 64
"""A pose may come after this many later ones of its kind and still count."""
MAX_WAITING_POSES = 100_000
"""Poses of one kind that wait for the other kind; beyond, the older half is settled without."""

UNKNOWN_STEP = np.full(STEP_SIZE, np.nan)
Row = tuple[float, ...]


class _Waiting:
    """Poses that wait, in order of stamps; of equal stamps in the order they came."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.rows: list[Row] = []
        self.latest: int | None = None
        self.given = 0
        self.unordered = 0

    def add(self, stamp_ns: int, row: Row) -> None:
        self.given += 1
        if self.latest is not None and stamp_ns < self.latest:
            self.unordered += 1
            index = bisect.bisect_right(self.stamps, stamp_ns)
            self.stamps.insert(index, stamp_ns)
            self.rows.insert(index, row)
        else:
            self.latest = stamp_ns
            self.stamps.append(stamp_ns)
            self.rows.append(row)

    def until(self, stamp_ns: int) -> int:
        """Return how many are not later than a stamp."""
        return bisect.bisect_right(self.stamps, stamp_ns)

    def drop(self, count: int) -> None:
        del self.stamps[:count]
        del self.rows[:count]

    def arrays(self, count: int) -> tuple[IntArray, FloatArray]:
        width = len(self.rows[0]) if self.rows else 7
        return np.array(self.stamps[:count], np.int64), np.array(self.rows[:count], np.float64).reshape(-1, width)


class LiveTrajectoryScore:
    """Scores a run while it goes on."""

    def __init__(self, config: TrajectoryScoreConfig) -> None:
        """Start a run.

        Raises:
            MetricsError: If a condition is not valid.
        """
        self._config = config
        self._scorer = TrajectoryScorer(config)
        self._estimates, self._truth = _Waiting(), _Waiting()
        self._counts = AssociationCounts()
        self._mode: AssociationMode | None = None
        self._settled_until: int | None = None
        self._truth_before: tuple[int, Row] | None = None
        self._calls: dict[int, tuple[bool, FloatArray]] = {}
        self._steps_before = StepSums.none()

    def add_truth(self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """Add a true pose of RB in DS.

        Raises:
            GeometryError: If it is not finite, absurd or the quaternion not of unit length.
        """
        _check(stamp_ns, position, quat_xyzw)
        self._add(self._truth, stamp_ns, (*map(float, position), *map(float, quat_xyzw)))

    def add_estimate(
        self,
        stamp_ns: int,
        position: Sequence[float],
        quat_xyzw: Sequence[float],
        covariance: FloatArray | None = None,
        lost: bool = False,
    ) -> None:
        """Add an estimated pose of RB in DS.

        Args:
            stamp_ns: Its stamp.
            position: `(3,)`, metres.
            quat_xyzw: `(4,)`, as in ROS messages.
            covariance: `(6, 6)` in ROS order, None where not known.
            lost: Whether the pose was repeated because the localiser was lost.

        Raises:
            GeometryError: If the pose is not finite, absurd or the quaternion not of unit length.
        """
        _check(stamp_ns, position, quat_xyzw)
        triangle = [np.nan] * COVARIANCE_SIZE if covariance is None else covariance[UPPER].tolist()
        row = (*map(float, position), *map(float, quat_xyzw), float(lost), *triangle)
        self._add(self._estimates, stamp_ns, row)

    def note_call(self, stamp_ns: int, step: FloatArray | None, *, degraded: bool) -> None:
        """Note what the localiser said of its pose of a stamp, which may come before or after this.

        Args:
            stamp_ns: The stamp.
            step: `(27,)` step to the pose, None where not known.
            degraded: Whether the localiser doubts the pose.
        """
        late = self._settled_until is not None and stamp_ns <= self._settled_until
        if not late and len(self._calls) < MAX_WAITING_POSES:
            self._calls[stamp_ns] = degraded, UNKNOWN_STEP if step is None else step

    def result(self, *, details: bool = True) -> ScoredTrajectory:
        """Return what `score_trajectory` returns for all poses so far; the run goes on unchanged.

        Args:
            details: Whether what figures are drawn from is wanted; it costs more than all the rest.
        """
        scorer, counts = self._scorer.copy(), self._counts
        mode = self._mode or self._decide(len(self._estimates.stamps), len(self._truth.stamps))
        frames, portion, _ = self._associated(len(self._estimates.stamps), len(self._truth.stamps), mode)
        if len(frames):
            scorer.push(frames)
        return scorer.result(self._given(counts + portion), mode, details=details)

    def _add(self, waiting: _Waiting, stamp_ns: int, row: Row) -> None:
        if self._settled_until is not None and stamp_ns <= self._settled_until:
            waiting.given += 1
            self._counts += AssociationCounts(late=1)
            return
        waiting.add(stamp_ns, row)
        enough = min(len(self._estimates.stamps), len(self._truth.stamps)) >= 2 * WINDOW_POSES
        if enough and len(waiting.stamps) % WINDOW_POSES == 0:
            self._settle(self._settled_stamp())
        elif len(waiting.stamps) > MAX_WAITING_POSES:
            self._settle(waiting.stamps[MAX_WAITING_POSES // 2])

    def _settled_stamp(self) -> int:
        return min(self._estimates.stamps[-WINDOW_POSES], self._truth.stamps[-WINDOW_POSES])

    def _settle(self, until: int) -> None:
        """Score everything up to a stamp; put off if a pair of stamps that belong together might be torn apart."""
        apart = until + 2 * tolerance_ns(self._config.association)
        est_count, gt_count = self._estimates.until(until), self._truth.until(until)
        torn = self._estimates.until(apart) > est_count or self._truth.until(apart) > gt_count
        undecided = self._mode is None and not self._first_stamps_settled(est_count, gt_count)
        overdue = max(len(self._estimates.stamps), len(self._truth.stamps)) > MAX_WAITING_POSES
        if (torn or undecided) and not overdue:
            return
        if self._mode is None:
            self._mode = self._decide(est_count, gt_count)
        frames, portion, self._steps_before = self._associated(est_count, gt_count, self._mode)
        self._counts += portion
        if len(frames):
            self._scorer.push(frames)
        if gt_count:
            self._truth_before = self._truth.stamps[gt_count - 1], self._truth.rows[gt_count - 1]
        self._estimates.drop(est_count)
        self._truth.drop(gt_count)
        self._settled_until = until
        self._calls = {stamp: call for stamp, call in self._calls.items() if stamp > until}

    def _first_stamps_settled(self, est_count: int, gt_count: int) -> bool:
        if not est_count or not gt_count:
            return False
        first = max(self._estimates.stamps[0], self._truth.stamps[0])
        est = set(self._estimates.stamps[bisect.bisect_left(self._estimates.stamps, first) : est_count])
        truth = set(self._truth.stamps[bisect.bisect_left(self._truth.stamps, first) : gt_count])
        return min(len(est), len(truth)) > AUTO_STAMPS

    def _decide(self, est_count: int, gt_count: int) -> AssociationMode:
        stamps = [
            np.array(sorted(set(w.stamps[:n]))) for w, n in ((self._estimates, est_count), (self._truth, gt_count))
        ]
        return decide_mode(stamps[0].astype(np.int64), stamps[1].astype(np.int64), self._config.association)

    def _associated(
        self, est_count: int, gt_count: int, mode: AssociationMode
    ) -> tuple[Frames, AssociationCounts, StepSums]:
        """Return the frames of the first poses that wait; true poses beside them are there to interpolate."""
        est_stamps, est = self._estimates.arrays(est_count)
        beside = gt_count + 1 if gt_count < len(self._truth.stamps) else gt_count
        gt_stamps, gt = self._truth.arrays(beside)
        if self._truth_before is not None:
            gt_stamps = np.concatenate(([self._truth_before[0]], gt_stamps))
            gt = np.concatenate(([self._truth_before[1]], gt.reshape(-1, 7)))
        trajectory = Trajectory(est_stamps, est[:, :3], est[:, 3:7])
        extra = est[:, 8:] if len(est) else np.empty((0, COVARIANCE_SIZE))
        lost = est[:, 7] > 0 if len(est) else np.empty(0, np.bool_)
        calls = [self._calls.get(stamp, (False, UNKNOWN_STEP)) for stamp in est_stamps.tolist()]
        degraded, steps = np.array([call[0] for call in calls], np.bool_), np.array([call[1] for call in calls])
        estimates = Estimates.of(trajectory, lost, degraded, extra, steps.reshape(-1, STEP_SIZE))
        truth = Trajectory(gt_stamps, gt[:, :3], gt[:, 3:])
        est_rows, gt_rows = unique_rows(est_stamps), unique_rows(gt_stamps)
        estimates, after = estimates.summed(est_rows, self._steps_before)
        frames, counts = join(estimates, est_rows, truth, gt_rows, self._config.association, mode)
        own = np.unique(self._truth.stamps[:gt_count])
        duplicates = est_count - len(est_rows), gt_count - len(own)
        return frames, replace(counts, estimate_duplicates=duplicates[0], truth_duplicates=duplicates[1]), after

    def _given(self, counts: AssociationCounts) -> AssociationCounts:
        """Return the counts with the poses given so far."""
        return counts + AssociationCounts(
            estimate_poses=self._estimates.given,
            truth_poses=self._truth.given,
            estimate_unordered=self._estimates.unordered,
            truth_unordered=self._truth.unordered,
        )


def _check(stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
    if is_plausible_pose(position, quat_xyzw):
        return
    Trajectory(  # says what is wrong
        np.array([stamp_ns], np.int64), np.array([position], np.float64), np.array([quat_xyzw], np.float64)
    )
