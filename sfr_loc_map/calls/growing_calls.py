"""Columns of calls from records that are added one by one, during a run or from a list."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.calls.call_findings import FindingCounts
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.run_identity import POSE_SIZE, RunIdentity, poses_by_stamp
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.growing_rows import GrowingRows
from sfr_loc_map.metrics.calls.call_meter import METHOD
from sfr_loc_map.metrics.calls.calls import USAGE_NAMES, Calls, stage_of
from sfr_loc_map.metrics.figures.records import MethodRecord
from sfr_loc_map.metrics.frames.covariance import COVARIANCE_SIZE, STEP_SIZE, UPPER
from sfr_loc_map.suite_names import Task

STEP = [("row", np.int64), ("value", np.float64, STEP_SIZE)]
COVARIANCE = [("row", np.int64), ("value", np.float64, COVARIANCE_SIZE)]
USAGE = [("row", np.int64), ("value", np.float64, len(USAGE_NAMES))]
CALL = [
    ("stamp_ns", np.int64),
    ("seconds", np.float64),
    ("state", "U16"),
    ("peak", np.float64),
    ("above_idle", np.float64),
]
STAGE = [("row", np.int64), ("stage", np.int64), ("seconds", np.float64)]


class GrowingCalls:
    """The calls of a run. Values that only some calls have are stored with the number of their call."""

    def __init__(self, max_stages: int | None = None) -> None:
        """Start without calls. The times of stages beyond `max_stages` different names are ignored; None: no limit."""
        self._max_stages = max_stages
        self._calls = GrowingRows(CALL)
        self._stage_numbers = dict[str, int]()
        self._stages = GrowingRows(STAGE)
        self._steps = GrowingRows(STEP)
        self._covariances = GrowingRows(COVARIANCE)
        self._usages = GrowingRows(USAGE)
        self._findings = FindingCounts()

    def __len__(self) -> int:
        """Return the number of calls."""
        return len(self._calls)

    def add(self, record: CallRecord) -> None:
        """Add a call."""
        row = len(self)
        self._add_stages(row, record)
        if not record.statistics.keys().isdisjoint(USAGE_NAMES):
            self._usages.add(row, [record.statistics.get(name, np.nan) for name in USAGE_NAMES])
        if record.step is not None:
            self._steps.add(row, record.step)
        if record.covariance is not None:
            self._covariances.add(row, record.covariance[UPPER])
        if record.finding:
            self._findings.add_of_call(record.stamp_ns, record.finding)
        costs = (record.processing_time_s, record.peak_rss_bytes, record.above_idle_bytes)
        seconds, peak_bytes, above_idle_bytes = (np.nan if value is None else value for value in costs)
        self._calls.add(record.stamp_ns, seconds, record.state, peak_bytes, above_idle_bytes)

    def stats(self, stated_tasks: Collection[Task] = ()) -> CallStats | None:
        """Return the calls as columns; None if there are no calls.

        Nodes state time and memory of the calls of `stated_tasks` in messages. Those of other calls were measured.
        """
        rows = self._calls.all()
        if not len(rows):
            return None
        calls = Calls(
            stamps_ns=rows["stamp_ns"],
            seconds=rows["seconds"],
            states=rows["state"].tolist(),
            peak_bytes=rows["peak"],
            above_idle_bytes=rows["above_idle"],
            stage_s={name: self._times_of_stage(number) for name, number in self._stage_numbers.items()},
            memory_method=METHOD if np.isfinite(rows["peak"]).any() else None,
        )
        usage = self._column(self._usages, len(USAGE_NAMES))
        stats = CallStats.of_columns(
            calls,
            usage=None if usage is None else dict(zip(USAGE_NAMES, usage.T, strict=True)),
            covariance=self._column(self._covariances, COVARIANCE_SIZE),
            steps=self._column(self._steps, STEP_SIZE),
            stated_tasks=stated_tasks,
        )
        return replace(stats, findings=self._findings.records)

    def _add_stages(self, row: int, record: CallRecord) -> None:
        """Add the times of the stages of a call."""
        numbers = self._stage_numbers
        for figure, seconds in record.statistics.items():
            name = stage_of(figure)
            if name is None:
                continue
            if name in numbers or self._max_stages is None or len(numbers) < self._max_stages:
                self._stages.add(row, numbers.setdefault(name, len(numbers)), seconds)

    def _column(self, reported: GrowingRows, width: int) -> FloatArray | None:
        """Return the values `(N, width)` that calls report, NaN for other calls; None if no call reports a value."""
        if not len(reported):
            return None
        return self._of_calls(reported.all(), "value", width)

    def _times_of_stage(self, number: int) -> FloatArray:
        """Return the time `(N,)` of a stage in each call, NaN for a call without the stage."""
        every = self._stages.all()
        return self._of_calls(every[every["stage"] == number], "seconds")

    def _of_calls(self, reported: NDArray[Any], name: str, *shape: int) -> FloatArray:
        """Return the values `(N, *shape)` of the calls, NaN for a call that has none."""
        values = np.full((len(self), *shape), np.nan)
        values[reported["row"]] = reported[name]
        return values


def stats_of(
    records: Sequence[CallRecord],
    method: MethodRecord | None = None,
    estimate: Trajectory | None = None,
    *,
    stated_tasks: Collection[Task] = (),
) -> CallStats:
    """Return one or more calls as columns, with the poses that the estimate of the same run has at their stamps.

    Nodes state time and memory of the calls of `stated_tasks` in messages. Those of other calls were measured.
    """
    rows = GrowingCalls()
    for record in records:
        rows.add(record)
    stats = rows.stats(stated_tasks)
    if stats is None:
        raise ValueError("no call: at least one is required")
    if method is not None:
        stats = replace(stats, methods={record.task: method for record in records})
    if estimate is not None and len(estimate):
        known, unknown = poses_by_stamp(estimate), [np.nan] * POSE_SIZE
        poses = np.array([known.get(record.stamp_ns, unknown) for record in records])
        stats = replace(stats, identity=RunIdentity(poses[:, :3], poses[:, 3:]))
    return stats
