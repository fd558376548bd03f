"""The path of a run as far as it is known: each estimate with the truth of its stamp and the error between them.

The estimate is shown in the frame of the truth: `T_gt(0) inv(T_est(0)) T_est`, with the first pose that has a truth as
0. The error of the sub-trajectory under way is re-based at its start in the same manner [4.1.2]; it is the latest error
of a sub-trajectory that has not ended, and no figure of the score.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_normalised
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.live.updates import PoseSample, Track
from sfr_loc_map.metrics.config import Condition, ConditionKind
from sfr_loc_map.pipeline.reception import jumped_back

MAX_ROWS = 4000
"""Poses that are kept; beyond them every other one is left out, and from then on every other one of those to come."""
MAX_TRUTHS = 4000
MAX_PENDING = 400
"""Estimates that wait for a truth."""
MAX_OPEN_STARTS = 1000
MAX_GAP_NS = NS_PER_S
"""Longest gap of the truth that is interpolated."""
Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PathRow:
    """One estimate, in the frame of the truth.

    Attributes:
        n: Its number, from 0.
        stamp_ns: Its stamp.
        received_s: When it was received.
        position: Metres.
        covariance_xy: Variances of x and y and their covariance, m^2; None where it is lost or not known.
        lost: Whether localisation was lost.
        truth: True position, metres; None where there is none (yet).
        error: Estimate less truth, metres.
        distance_m: Length of the true path so far, of the estimated one without truth.
    """

    n: int
    stamp_ns: int
    received_s: float
    position: Point
    covariance_xy: Point | None
    lost: bool
    truth: Point | None
    error: Point | None
    distance_m: float


@dataclass(frozen=True, slots=True)
class UnderWay:
    """The oldest sub-trajectory that has not ended.

    Attributes:
        start_n: Number of the row that it starts at.
        condition: What ends it, in words.
        progress: Share of it that is done, 0 to 1.
        error: Estimate less truth now, re-based at the start, metres, DS.
    """

    start_n: int
    condition: str
    progress: float
    error: Point


@dataclass(frozen=True, slots=True)
class _Start:
    row: PathRow
    frame: int
    estimate: Transform
    truth: Transform


class LivePath:
    """Collects poses. Its memory is bounded.

    Attributes:
        version: Changes whenever rows that were given out do not hold any more.
        condition: What ends a sub-trajectory.
        spacing: Frames from one start of a sub-trajectory to the next.
        under_way: The sub-trajectory under way, None without truth.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.version = 0
        self.condition = Condition(ConditionKind.DISTANCE, 5.0)
        self.spacing = 10
        self._clear()

    def restart(self) -> None:
        """Forget all poses: a new run begins."""
        self.version += 1
        self._clear()

    def _clear(self) -> None:
        self.under_way: UnderWay | None = None
        self._rows: list[PathRow] = []
        self._count = self._frames = 0
        self._every = 1
        self._changed_from = 0
        self._truths: deque[PoseSample] = deque(maxlen=MAX_TRUTHS)
        self._pending: deque[PoseSample] = deque(maxlen=MAX_PENDING)
        self._starts: deque[_Start] = deque(maxlen=MAX_OPEN_STARTS)
        self._to_truth: Transform | None = None
        self._last: tuple[Point, float] | None = None

    @property
    def rows(self) -> list[PathRow]:
        """All rows that are kept, the oldest first."""
        return self._rows

    @property
    def has_truth(self) -> bool:
        """Whether a pose has found a truth."""
        return self._to_truth is not None

    def add(self, sample: PoseSample) -> None:
        """Add a pose; one whose stamp lies far behind the latest begins a new run."""
        latest = self._latest_ns(sample.track)
        if latest is not None and jumped_back(latest, sample.stamp_ns):
            self.restart()
        if sample.track is Track.TRUTH:
            if latest is None or sample.stamp_ns > latest or not self._truths:
                self._truths.append(sample)
                self._match_pending()
        else:
            self._pending.append(sample)
            self._match_pending()

    def _latest_ns(self, track: Track) -> int | None:
        if track is Track.TRUTH:
            return self._truths[-1].stamp_ns if self._truths else None
        return self._rows[-1].stamp_ns if self._rows else None

    def _match_pending(self) -> None:
        """Make rows of the estimates whose truth is there, or which a truth does not keep waiting."""
        while self._pending:
            sample = self._pending[0]
            newest = self._truths[-1].stamp_ns if self._truths else None
            behind_ns = -1 if newest is None else sample.stamp_ns - newest
            if newest is not None and 0 < behind_ns <= MAX_GAP_NS:
                return  # its truth may be on its way
            self._pending.popleft()
            self._add_row(sample, None if behind_ns > 0 or newest is None else self._truth_at(sample.stamp_ns))

    def _truth_at(self, stamp_ns: int) -> Transform | None:
        """Return the true pose of a stamp, between two of them where none has it."""
        after: PoseSample | None = None
        for sample in reversed(self._truths):
            if sample.stamp_ns == stamp_ns:
                return Transform.from_quat(sample.position, sample.quat_xyzw)
            if sample.stamp_ns < stamp_ns:
                return None if after is None else _between(sample, after, stamp_ns)
            after = sample
        return None

    def _add_row(self, sample: PoseSample, truth: Transform | None) -> None:
        estimate = Transform.from_quat(sample.position, sample.quat_xyzw)
        lost = sample.covariance is not None and bool((np.diagonal(sample.covariance) >= LOST_VARIANCE).all())
        estimate = self._in_frame_of_truth(estimate, truth)
        position = _point(estimate.translation)
        row = PathRow(
            n=self._count,
            stamp_ns=sample.stamp_ns,
            received_s=sample.received_s,
            position=position,
            covariance_xy=None if lost else self._covariance_xy(sample.covariance),
            lost=lost,
            truth=None if truth is None else _point(truth.translation),
            error=None if truth is None else _point(estimate.translation - truth.translation),
            distance_m=self._travelled(position if truth is None else _point(truth.translation)),
        )
        if truth is not None:
            self._follow(_Start(row, self._frames, estimate, truth))
            self._frames += 1
        self._count += 1
        if row.n % self._every == 0 or lost:
            self._keep(row)

    def _in_frame_of_truth(self, estimate: Transform, truth: Transform | None) -> Transform:
        """Return an estimate in the frame of the truth; the first one with a truth tells where that is."""
        if truth is not None and self._to_truth is None:
            to_truth = self._to_truth = truth @ estimate.inverse()
            self.version += 1
            self._rows = [replace(row, position=_point(to_truth.apply(row.position))) for row in self._rows]
        return estimate if self._to_truth is None else self._to_truth @ estimate

    def _keep(self, row: PathRow) -> None:
        self._rows.append(row)
        if len(self._rows) > MAX_ROWS:
            self._every *= 2
            self._rows = self._rows[::2]
            self.version += 1

    def _covariance_xy(self, covariance: FloatArray | None) -> Point | None:
        if covariance is None or not np.isfinite(covariance).all():
            return None
        part = covariance[:3, :3]
        if self._to_truth is not None:
            part = self._to_truth.rotation @ part @ self._to_truth.rotation.T
        return float(part[0, 0]), float(part[1, 1]), float(part[0, 1])

    def _travelled(self, position: Point) -> float:
        before = self._last
        distance = 0.0 if before is None else before[1] + math.dist(before[0], position)
        self._last = (position, distance)
        return distance

    def _follow(self, now: _Start) -> None:
        """Find the oldest sub-trajectory that has not ended, and its error now."""
        if now.frame % self.spacing == 0:
            self._starts.append(now)
        while self._starts and (progress := self._progress(self._starts[0], now)) >= 1.0:
            self._starts.popleft()
        if not self._starts:
            self.under_way = None
            return
        start = self._starts[0]
        moved = (start.truth @ start.estimate.inverse() @ now.estimate).translation
        error = _point(moved - now.truth.translation)
        self.under_way = UnderWay(start.row.n, self.condition.label, progress, error)

    def _progress(self, start: _Start, now: _Start) -> float:
        kind = self.condition.kind
        if kind is ConditionKind.DISTANCE:
            done = now.row.distance_m - start.row.distance_m
        elif kind is ConditionKind.TIME:
            done = (now.row.stamp_ns - start.row.stamp_ns) / NS_PER_S
        else:
            done = now.frame - start.frame
        return done / self.condition.value


def _point(values: FloatArray) -> Point:
    x, y, z = values.tolist()
    return x, y, z


def _between(before: PoseSample, after: PoseSample, stamp_ns: int) -> Transform | None:
    """Return a pose between two: linear in position and (normalised) in attitude; None where they lie far apart."""
    gap_ns = after.stamp_ns - before.stamp_ns
    if gap_ns > MAX_GAP_NS:
        return None
    share = (stamp_ns - before.stamp_ns) / gap_ns
    first, second = np.array(before.quat_xyzw), np.array(after.quat_xyzw)
    second = second if first @ second >= 0.0 else -second
    position = np.array(before.position) * (1.0 - share) + np.array(after.position) * share
    return Transform.from_quat(position, quat_normalised(first * (1.0 - share) + second * share))
