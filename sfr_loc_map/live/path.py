"""The path of a run so far: each estimate with the truth at its stamp and the error between them.

The estimate is displayed in the frame of the truth as `T_gt(0) inv(T_est(0)) T_est`, where 0 is the first pose with a
truth. These errors are only displayed; the errors of the monitor's report are judged. If the monitor converts the true
poses before it scores them, the path shows them as published, without errors.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stamped_poses import LONGEST_GAP_S, pose_at
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.live.updates import PoseSample, Track
from sfr_loc_map.message_stamps import NS_PER_S

MAX_ROWS = 4000
"""Maximum number of kept poses. Poses are divided into intervals of equal numbers of poses. In each interval, the first
lost pose and the first pose that is not lost are kept. When the maximum is exceeded, the intervals are doubled, so that
a loss of any length leaves room for later poses."""
MAX_TRUTHS = 4000  #: Maximum number of true poses.
MAX_PENDING = 400  #: Maximum number of estimates that wait for a true pose.
MAX_GAP_NS = round(LONGEST_GAP_S * NS_PER_S)
"""Longest gap of the truth in which true poses are interpolated, ns, as in a score."""
Point = tuple[float, float, float]
CovarianceXY = tuple[float, float, float]  #: Variances of x and y, and their covariance.


@dataclass(frozen=True, slots=True)
class PathRow:
    """An estimate in the frame of the truth, m."""

    n: int
    stamp_ns: int
    received_s: float
    published_s: float | None
    position_m: Point
    covariance_xy_m2: CovarianceXY | None  # None if lost or unknown
    lost: bool
    truth_m: Point | None
    error_m: Point | None
    distance_m: float  # along the true path; without truth, along the estimated path

    def to_plain(self) -> dict[str, Any]:
        """Return JSON values; the stamp is a string, because JavaScript would round the number."""
        return asdict(self) | {"stamp_ns": str(self.stamp_ns)}


class LivePath:
    """Collects poses. Its memory is bounded."""

    def __init__(self) -> None:
        self.version = -1  # changes whenever earlier rows become invalid
        self._may_have_begun_before = True  # whether the run may have started before the first received pose
        self._is_truth_of_rb = True  # whether the monitor scores the true poses as published
        self._forget()

    def restart(self) -> None:
        """Forget all poses at the start of a new run. The path of the new run is complete from its first pose."""
        self._may_have_begun_before = False
        self._forget()

    def _forget(self) -> None:
        self.version += 1
        self.before_m = 0.0  # distance travelled before the first received pose
        self.rows: list[PathRow] = []
        self.newest: PathRow | None = None  # the last pose, even if thinning drops it from `rows`
        self._last_ns: dict[Track, int] = {}  # last stamp of each track
        self._count = 0
        self._interval = 1  # number of poses in each interval
        self._truths: deque[tuple[int, Transform]] = deque(maxlen=MAX_TRUTHS)
        self._pending: deque[tuple[PoseSample, float | None]] = deque(maxlen=MAX_PENDING)
        self._to_truth: Transform | None = None
        self._positions_alone = False
        self._last: tuple[Point, Point | None, float] | None = None  # estimate as sent, truth, distance

    def is_late(self, sample: PoseSample) -> bool:
        """Return whether the stamp of a pose does not exceed the last stamp of its track."""
        return sample.stamp_ns <= self._last_ns.get(sample.track, -1)

    def add(self, sample: PoseSample, published_s: float | None = None) -> None:
        """Add a pose that is not late, and the time when its image was published."""
        self._last_ns[sample.track] = sample.stamp_ns
        if sample.track is Track.ESTIMATE:
            self._pending.append((sample, published_s))
        else:
            self._positions_alone = not sample.has_attitude
            quat = sample.quat_xyzw if sample.has_attitude else (0.0, 0.0, 0.0, 1.0)
            self._truths.append((sample.stamp_ns, Transform.from_quat(sample.position, quat)))
        while self._pending:
            estimate, published_s = self._pending[0]
            newest_ns = self._truths[-1][0] if self._truths else estimate.stamp_ns
            if 0 < estimate.stamp_ns - newest_ns <= MAX_GAP_NS:
                return  # the truth of this pose may still arrive
            self._pending.popleft()
            self._add_row(estimate, published_s, pose_at(self._truths, estimate.stamp_ns, MAX_GAP_NS))

    def note_conversion(self, *, is_converted: bool) -> None:
        """Note whether the monitor converts the true poses. If so, no pose of the path has an error."""
        self._is_truth_of_rb = not is_converted
        if is_converted and any(row.error_m is not None for row in self.rows):
            self.version += 1
            self.rows = [replace(row, error_m=None) for row in self.rows]
            self.newest = None if self.newest is None else replace(self.newest, error_m=None)

    def note_length(self, length_m: float) -> None:
        """Record the length of the true path according to a score.

        This length includes the path before the first received pose; it is not used if the start of the run was
        received. A score does not include the newest poses, so that each length gives a lower bound of the distance
        before the first received pose. The largest bound is kept.
        """
        if self._may_have_begun_before and self._last is not None:
            self.before_m = max(self.before_m, length_m - self._last[2])

    def _add_row(self, sample: PoseSample, published_s: float | None, truth: Transform | None) -> None:
        estimate = Transform.from_quat(sample.position, sample.quat_xyzw)
        if truth is not None and self._positions_alone:  # the estimate is aligned by translation only
            truth = Transform(estimate.rotation, truth.translation)
        if truth is not None and self._to_truth is None:
            to_truth = self._to_truth = truth @ estimate.inverse()
            self.version += 1
            self.rows = [replace(row, position_m=_point(to_truth.apply(row.position_m))) for row in self.rows]
        rotation = np.eye(3)
        if self._to_truth is not None:
            estimate, rotation = self._to_truth @ estimate, self._to_truth.rotation
        at = _point(estimate.translation)
        true_at = None if truth is None else _point(truth.translation)
        distance_m = self._distance_m(sample.position, true_at)
        error_m = None
        if truth is not None and self._is_truth_of_rb:
            error_m = _point(estimate.translation - truth.translation)
        row = PathRow(
            n=self._count,
            stamp_ns=sample.stamp_ns,
            received_s=sample.received_s,
            published_s=published_s,
            position_m=at,
            covariance_xy_m2=_covariance_xy(sample, rotation),
            lost=sample.is_lost,
            truth_m=true_at,
            error_m=error_m,
            distance_m=distance_m,
        )
        self._count += 1
        self.newest = row
        if self._place(row) not in map(self._place, self.rows[-2:]):
            self.rows.append(row)
        while len(self.rows) > MAX_ROWS:
            self._interval *= 2
            kept: dict[tuple[int, bool], PathRow] = {}
            for row in self.rows:
                kept.setdefault(self._place(row), row)
            self.rows = list(kept.values())
            self.version += 1

    def _place(self, row: PathRow) -> tuple[int, bool]:
        """Return the interval of a pose and whether the pose is lost.

        Of poses for which both are equal, the path keeps the first.
        """
        return row.n // self._interval, row.lost

    def _distance_m(self, sent: Point, true_at: Point | None) -> float:
        """Return the distance travelled. A step is measured along the truth if both of its poses have a truth.

        Otherwise the step is measured along the estimate, because estimate and truth may be in different frames.
        """
        distance_m = 0.0
        if self._last is not None:
            last_sent, last_true, distance_m = self._last
            if last_true is not None and true_at is not None:
                distance_m += math.dist(last_true, true_at)
            else:
                distance_m += math.dist(last_sent, sent)
        self._last = sent, true_at, distance_m
        return distance_m


def _covariance_xy(sample: PoseSample, rotation: FloatArray) -> CovarianceXY | None:
    """Return the variances of x and y and their covariance after a rotation, m^2; None if lost or unknown."""
    covariance = sample.covariance
    if covariance is None or sample.is_lost or not np.isfinite(covariance).all():
        return None
    rotated = rotation @ covariance[:3, :3] @ rotation.T
    return float(rotated[0, 0]), float(rotated[1, 1]), float(rotated[0, 1])


def _point(values: FloatArray) -> Point:
    x, y, z = values.tolist()
    return x, y, z
