"""The path of a run as far as it is known: each estimate with the truth of its stamp and the error between them.

The estimate is shown in the frame of the truth: `T_gt(0) inv(T_est(0)) T_est`, with the first pose that has a truth as
0. The error of the sub-trajectory under way is re-based at its start in the same manner [4.1.2]; it is the latest error
of a sub-trajectory that has not ended, and no figure of the score.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform, interpolated
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
    """One estimate in the frame of the truth, metres.

    The covariance has the variances of x and y and their covariance, m^2, None where lost or not known. The distance is
    the length of the true path so far, of the estimated one without truth.
    """

    n: int
    stamp_ns: int
    received_s: float
    published_s: float | None
    position_m: Point
    covariance_xy_m2: Point | None
    lost: bool
    truth_m: Point | None
    error_m: Point | None
    distance_m: float

    def to_plain(self) -> list[Any]:
        """Return it as a list of JSON values in the order of `ROW_FIELDS`; stamps have too many digits for a script."""
        covariance = self.covariance_xy_m2
        return [
            self.n,
            str(self.stamp_ns),
            round(self.received_s, 4),
            self.published_s,
            _rounded(self.position_m),
            None if covariance is None else [float(f"{value:.4g}") for value in covariance],
            int(self.lost),
            _rounded(self.truth_m),
            _rounded(self.error_m, 6),
            round(self.distance_m, 4),
        ]


ROW_FIELDS = tuple(field.name for field in fields(PathRow))


@dataclass(frozen=True, slots=True)
class _Start:
    """Where a sub-trajectory starts, and what takes the estimate from there to the truth."""

    row: PathRow
    frame: int
    to_truth: Transform


class LivePath:
    """Collects poses. Its memory is bounded.

    Attributes:
        version: Changes whenever rows that were given out do not hold any more.
        spacing: Frames from one start of a sub-trajectory to the next.
        under_way: The oldest sub-trajectory that has not ended, as JSON values; None without truth.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.version = -1
        self.condition = Condition(ConditionKind.DISTANCE, 5.0)
        self.spacing = 10
        self.restart()

    def restart(self) -> None:
        """Forget all poses: a new run begins."""
        self.version += 1
        self.rows: list[PathRow] = []
        self.under_way: dict[str, Any] | None = None
        self._count = self._frames = 0
        self._every = 1
        self._latest_ns: dict[Track, int] = {}
        self._truths: deque[tuple[int, Transform]] = deque(maxlen=MAX_TRUTHS)
        self._pending: deque[tuple[PoseSample, float | None]] = deque(maxlen=MAX_PENDING)
        self._starts: deque[_Start] = deque(maxlen=MAX_OPEN_STARTS)
        self._to_truth: Transform | None = None
        self._last: tuple[Point, float] | None = None

    def add(self, sample: PoseSample, published_s: float | None = None) -> None:
        """Add a pose, and when its image was published; a stamp far behind the latest one begins a new run.

        Raises:
            GeometryError: If it is no pose.
        """
        stamp_ns = sample.stamp_ns
        if jumped_back(self._latest_ns.get(sample.track, stamp_ns), stamp_ns):
            self.restart()
        latest_ns = self._latest_ns.get(sample.track, -1)
        self._latest_ns[sample.track] = max(latest_ns, stamp_ns)
        if sample.track is Track.ESTIMATE:
            self._pending.append((sample, published_s))
        elif stamp_ns > latest_ns:
            self._truths.append((stamp_ns, Transform.from_quat(sample.position, sample.quat_xyzw)))
        while self._pending:
            estimate, published_s = self._pending[0]
            newest_ns = self._truths[-1][0] if self._truths else estimate.stamp_ns
            if 0 < estimate.stamp_ns - newest_ns <= MAX_GAP_NS:
                return  # its truth may be on its way
            self._pending.popleft()
            self._add_row(estimate, published_s, self._truth_at(estimate.stamp_ns))

    def _truth_at(self, stamp_ns: int) -> Transform | None:
        """Return the true pose of a stamp, between two of them where none has it."""
        after_ns, after = 0, None
        for truth_ns, truth in reversed(self._truths):
            if truth_ns == stamp_ns:
                return truth
            if truth_ns < stamp_ns:
                gap_ns = after_ns - truth_ns
                if after is None or gap_ns > MAX_GAP_NS:
                    return None
                return interpolated(truth, after, (stamp_ns - truth_ns) / gap_ns)
            after_ns, after = truth_ns, truth
        return None

    def _add_row(self, sample: PoseSample, published_s: float | None, truth: Transform | None) -> None:
        estimate, covariance = Transform.from_quat(sample.position, sample.quat_xyzw), sample.covariance
        if truth is not None and self._to_truth is None:
            to_truth = self._to_truth = truth @ estimate.inverse()
            self.version += 1
            self.rows = [replace(row, position_m=_point(to_truth.apply(row.position_m))) for row in self.rows]
        if self._to_truth is not None:
            estimate = self._to_truth @ estimate
        lost = covariance is not None and bool((np.diagonal(covariance) >= LOST_VARIANCE).all())
        travelled = _point((estimate if truth is None else truth).translation)
        distance_m = 0.0 if self._last is None else self._last[1] + math.dist(self._last[0], travelled)
        self._last = (travelled, distance_m)
        row = PathRow(
            n=self._count,
            stamp_ns=sample.stamp_ns,
            received_s=sample.received_s,
            published_s=published_s,
            position_m=_point(estimate.translation),
            covariance_xy_m2=None if lost else self._covariance_xy(covariance),
            lost=lost,
            truth_m=None if truth is None else _point(truth.translation),
            error_m=None if truth is None else _point(estimate.translation - truth.translation),
            distance_m=distance_m,
        )
        if truth is not None:
            self._follow(row, estimate, truth)
        self._count += 1
        if row.n % self._every == 0 or lost:
            self.rows.append(row)
            if len(self.rows) > MAX_ROWS:
                self._every *= 2
                self.rows = self.rows[::2]
                self.version += 1

    def _covariance_xy(self, covariance: FloatArray | None) -> Point | None:
        if covariance is None or not np.isfinite(covariance).all():
            return None
        part = covariance[:3, :3]
        if self._to_truth is not None:
            part = self._to_truth.rotation @ part @ self._to_truth.rotation.T
        return float(part[0, 0]), float(part[1, 1]), float(part[0, 1])

    def _follow(self, row: PathRow, estimate: Transform, truth: Transform) -> None:
        """Find the oldest sub-trajectory that has not ended, and its error now."""
        if self._frames % self.spacing == 0:
            self._starts.append(_Start(row, self._frames, truth @ estimate.inverse()))
        while self._starts and self._progress(self._starts[0], row) >= 1.0:
            self._starts.popleft()
        self.under_way = None
        if self._starts:
            start = self._starts[0]
            error = (start.to_truth @ estimate).translation - truth.translation
            self.under_way = {
                "start_n": start.row.n,
                "condition": self.condition.label,
                "progress": round(self._progress(start, row), 4),
                "error": error.tolist(),
            }
        self._frames += 1

    def _progress(self, start: _Start, now: PathRow) -> float:
        done = {
            ConditionKind.DISTANCE: now.distance_m - start.row.distance_m,
            ConditionKind.TIME: (now.stamp_ns - start.row.stamp_ns) / NS_PER_S,
            ConditionKind.FRAMES: self._frames - start.frame,
        }
        return done[self.condition.kind] / self.condition.value


def _point(values: FloatArray) -> Point:
    x, y, z = values.tolist()
    return x, y, z


def _rounded(values: Point | None, digits: int = 5) -> list[float] | None:
    return None if values is None else [round(value, digits) for value in values]
