"""The calls of a run as columns. `growing_calls` makes the columns from records, and `call_files` from a file."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from msgspec.structs import replace as struct_replace
from numpy.typing import NDArray

from sfr_loc_map.calls.run_identity import RunIdentity
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls.call_score import STATED_CLOCK, Calls, concatenated, stacked
from sfr_loc_map.metrics.figures.records import FindingRecord, MethodKind, MethodRecord, ProcessUsage
from sfr_loc_map.suite_names import Task

SEVERITIES = {TrackingState.DEGRADED.value: 1, TrackingState.LOST.value: 2}  #: Severity of states; 0 for others.
USAGE_METHOD = "of the method's processes and all that they started, at each call, from outside (psutil)"
ADAPTER_S = 0.015  #: Processor time of a method's adapter per call, s, with the resolution of 0.01 s.


@dataclass(frozen=True, slots=True, eq=False)
class CallStats:
    """Calls as columns, as in the CSV file."""

    calls: Calls
    covariance: FloatArray | None  #: `(N, 21)` upper triangles, NaN if unknown; None if all are unknown.
    steps: FloatArray | None  #: `(N, 48)` steps between the poses (`CallRecord.step`); NaN and None as above.
    methods: Mapping[Task, MethodRecord] = field(default_factory=dict)  #: Known methods by the task of their calls.
    findings: tuple[FindingRecord, ...] = ()  #: Errors of the method, one record for each kind.
    processes: ProcessUsage | None = None  #: Usage of the method's processes; None if not measured.
    identity: RunIdentity = field(default_factory=RunIdentity)  #: What identifies the run of the calls.
    has_stamps: bool = True  #: Whether the calls have stamps; otherwise they are numbered.
    #: Tasks of whose calls nodes state time and memory in messages. Those of other calls were measured.
    stated_tasks: frozenset[Task] = frozenset()

    @classmethod
    def of_columns(
        cls,
        calls: Calls,
        *,
        covariance: FloatArray | None,
        steps: FloatArray | None,
        findings: tuple[FindingRecord, ...],
        usage: Mapping[str, FloatArray] | None,
        methods: Mapping[Task, MethodRecord] = MappingProxyType({}),
        identity: RunIdentity | None = None,
        has_stamps: bool = True,
        stated_tasks: Collection[Task] = (),
    ) -> CallStats:
        """Return the calls of records, of a file or of messages.

        `usage` has the columns of USAGE_NAMES, None if they are missing. The other arguments are the fields of the same
        name.
        """
        processes = None if usage is None else processes_of(usage, calls)
        if stated_tasks:
            is_stated = is_of_tasks(calls, stated_tasks)
            calls = replace(calls, memory_method=_memory_method(calls, is_stated))
            if usage is not None and processes is not None and is_stated[np.isfinite(usage["cpu_s"])].all():
                processes = struct_replace(processes, method=STATED_CLOCK)
        return cls(
            calls,
            known_or_none(covariance),
            known_or_none(steps),
            methods=methods,
            findings=findings,
            processes=processes,
            identity=identity or RunIdentity(),
            has_stamps=has_stamps,
            stated_tasks=frozenset(stated_tasks),
        )

    @property
    def method(self) -> MethodRecord | None:
        """The method of the calls, or that under test if the tasks have different methods; None if unknown."""
        return method_under_test(self.methods.values())

    @property
    def localised_ns(self) -> IntArray:
        """Stamps of the calls of a localiser; calls of a mapper may have the same stamps."""
        return self.calls.stamps_ns[self.calls.is_localisation]

    def has_task(self, task: Task) -> bool:
        """Return whether there is a call of a task."""
        return bool(is_of_tasks(self.calls, (task,)).any())

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


def is_of_tasks(calls: Calls, tasks: Collection[Task]) -> Mask:
    """Return which calls `(N,)` belong to one of the tasks."""
    return np.where(calls.is_localisation, Task.LOCALISATION in tasks, Task.MAPPING in tasks)


def _memory_method(calls: Calls, is_stated: Mask) -> str | None:
    """Return how memory was measured, by calls `(N,)` whose memory a node states and by others; None if in no call."""
    has_memory = np.isfinite(calls.peak_bytes)
    methods = [] if calls.memory_method is None or not (has_memory & ~is_stated).any() else [calls.memory_method]
    if (has_memory & is_stated).any():
        methods.append(STATED_CLOCK)
    return "; ".join(methods) or None


def method_under_test(methods: Iterable[MethodRecord]) -> MethodRecord | None:
    """Return the method under test, or else the first built-in method; None without a method."""
    ordered = sorted(methods, key=lambda method: method.kind is MethodKind.BUILT_IN)  # stable
    return ordered[0] if ordered else None


def known_or_none(values: FloatArray | None) -> FloatArray | None:
    """Return an array, or None if all its values are unknown (NaN)."""
    return values if values is not None and not np.isnan(values).all() else None


def processes_of(usage: Mapping[str, FloatArray], calls: Calls) -> ProcessUsage | None:
    """Return the usage of the processes of a method in all calls, from the columns of USAGE_NAMES; None if unknown.

    Processor time is outside a call if it was used between two calls, or if it exceeds the time that the reported
    threads could use within the call.
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
        method=USAGE_METHOD,
    )


def united(parts: Sequence[CallStats]) -> CallStats:
    """Return the calls of one or more files of one run, with covariances and steps but without the other fields."""
    counts = [len(part.calls.stamps_ns) for part in parts]
    covariance = stacked([part.covariance for part in parts], counts)
    steps = stacked([part.steps for part in parts], counts)
    return CallStats(concatenated([part.calls for part in parts]), covariance, steps)
