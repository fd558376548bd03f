"""The calls of a run as columns. `growing_calls` makes the columns from records, and `call_files` from a file."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.calls.call_record import task_of
from sfr_loc_map.calls.run_identity import RunIdentity
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE
from sfr_loc_map.metrics.calls.calls import Calls, concatenated, stacked
from sfr_loc_map.metrics.figures.records import FindingRecord, MethodKind, MethodRecord, ProcessUsage
from sfr_loc_map.suite_names import Task

SEVERITIES = {TrackingState.DEGRADED.value: 1, TrackingState.LOST.value: 2}  #: Severity of states; 0 for others.
USAGE_METHOD = "of the method's processes and all that they started, at each call, from outside (psutil)"
ADAPTER_S = 0.015  #: Allowance for the processor time of an adapter in a call, s, with the resolution of 0.01 s.


@dataclass(frozen=True, slots=True, eq=False)
class CallStats:
    """The calls of a run, with one array for each column of the CSV file."""

    calls: Calls
    covariance: FloatArray | None  #: `(N, 21)` upper triangles, NaN if unknown; None if all are unknown.
    steps: FloatArray | None  #: `(N, 48)` steps between the poses (`CallRecord.step`); NaN and None as above.
    methods: Mapping[Task, MethodRecord] = field(default_factory=dict)  #: Known methods by the task of their calls.
    findings: tuple[FindingRecord, ...] = ()  #: Errors of the method, one record for each kind.
    processes: ProcessUsage | None = None  #: Usage of the method's processes; None if not measured.
    identity: RunIdentity = field(default_factory=RunIdentity)  #: What identifies the run of the calls.
    has_stamps: bool = True  #: Whether the calls have stamps; otherwise they are numbered.
    #: Tasks whose nodes state the time and memory of their calls in messages. For other tasks, both were measured.
    stated_tasks: frozenset[Task] = frozenset()

    @classmethod
    def of_columns(
        cls,
        calls: Calls,
        *,
        usage: Mapping[str, FloatArray] | None,
        covariance: FloatArray | None,
        steps: FloatArray | None,
        stated_tasks: Collection[Task],
    ) -> CallStats:
        """Return the calls with covariance, steps, and the usage of the method's processes; NaN: unknown.

        `calls.memory_method` is the method of memory measurement for tasks other than `stated_tasks`. `usage` has a
        column `(N,)` for each of USAGE_NAMES, and is None if the usage is unknown.
        """
        is_stated = np.array([task_of(state) in stated_tasks for state in calls.states], np.bool_)
        calls = replace(calls, memory_method=_memory_method(calls, is_stated))
        return cls(
            calls,
            covariance=_known_or_none(covariance),
            steps=_known_or_none(steps),
            processes=None if usage is None else _processes(usage, calls, is_stated),
            stated_tasks=frozenset(stated_tasks),
        )

    @property
    def method(self) -> MethodRecord | None:
        """The method of the calls, or that under test if the tasks have different methods; None if unknown."""
        return judged_method(self.methods.values())

    @property
    def localised_ns(self) -> IntArray:
        """Stamps of the calls of a localiser; calls of a mapper may have the same stamps."""
        return self.calls.stamps_ns[self.calls.is_localisation]

    def has_task(self, task: Task) -> bool:
        """Return whether there is a call of a task."""
        return any(task_of(state) is task for state in self.calls.states)

    def localised_rows(self, stamps_ns: IntArray) -> NDArray[np.intp]:
        """Return the row of the call of a localiser for each stamp, -1 where there is no call.

        If several calls have one stamp, the row is that of the worst state; for equal states, that of the last call.
        """
        rows = np.flatnonzero(self.calls.is_localisation)
        severity = np.array([SEVERITIES.get(self.calls.states[row], 0) for row in rows.tolist()], np.intp)
        order = np.lexsort((severity, self.calls.stamps_ns[rows]))  # stable
        rows = np.append(-1, rows[order])
        called_ns = self.calls.stamps_ns[rows[1:]]
        last = np.searchsorted(called_ns, stamps_ns, "right")
        is_called = np.isin(stamps_ns, called_ns)
        return rows[np.where(is_called, last, 0)]


def judged_method(methods: Iterable[MethodRecord]) -> MethodRecord | None:
    """Return the method under test, or else the first built-in method; None without a method."""
    ordered = sorted(methods, key=lambda method: method.kind is MethodKind.BUILT_IN)  # stable
    return ordered[0] if ordered else None


def united(parts: Sequence[CallStats]) -> CallStats:
    """Return the calls of one or more files of one run, with covariances and steps but without the other fields."""
    counts = [len(part.calls.stamps_ns) for part in parts]
    covariance = stacked([part.covariance for part in parts], counts)
    steps = stacked([part.steps for part in parts], counts)
    return CallStats(concatenated([part.calls for part in parts]), covariance, steps)


def _memory_method(calls: Calls, is_stated: Mask) -> str | None:
    """Return how the memory of calls was measured; None if unknown.

    `is_stated` `(N,)` are the calls whose memory a node states. `calls.memory_method` applies to the other calls.
    """
    measured_by = calls.memory_method
    if not is_stated.any():
        return measured_by
    has_memory = np.isfinite(calls.peak_bytes)
    methods = []
    if measured_by is not None and (has_memory & ~is_stated).any():
        methods.append(measured_by)
    if (has_memory & is_stated).any():
        methods.append(STATED_BY_NODE)
    return "; ".join(methods) or None


def _known_or_none(values: FloatArray | None) -> FloatArray | None:
    """Return an array, or None if all its values are unknown (NaN)."""
    return values if values is not None and not np.isnan(values).all() else None


def _processes(usage: Mapping[str, FloatArray], calls: Calls, is_stated: Mask) -> ProcessUsage | None:
    """Return the usage of the processes of a method in all calls; None if unknown.

    `is_stated` `(N,)` are the calls whose usage a node states; the usage of other calls was measured. Processor time is
    outside a call if it was used between two calls, or if it exceeds the time that the reported threads could use
    within the call.
    """
    known = np.isfinite(usage["cpu_s"]) & np.isfinite(usage["cpu_between_s"])
    if not known.any():
        return None
    of_calls = {name: np.nan_to_num(values[known]) for name, values in usage.items()}
    cpu_s, between_s, threads = of_calls["cpu_s"], of_calls["cpu_between_s"], of_calls["threads"]
    within_s = threads * np.nan_to_num(calls.seconds[known]) + ADAPTER_S
    return ProcessUsage(
        cpu_s=float(cpu_s.sum() + between_s.sum()),
        cpu_outside_s=float(between_s.sum() + np.maximum(cpu_s - within_s, 0.0).sum()),
        peak_rss_bytes=int(np.nanmax(np.append(calls.peak_bytes, 0.0))),
        processes=int(of_calls["processes"].max()),
        threads=int(threads.max()),
        method=STATED_BY_NODE if is_stated[known].all() else USAGE_METHOD,
    )
