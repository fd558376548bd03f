"""Figures of repeated runs: costs of calls, medians, ratios, growth with size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

JsonObject = dict[str, Any]
"""A result as it is written to a file; nothing computes with it."""
F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class CallTimes:
    """Times of the calls of a run, seconds; None without calls.

    Attributes:
        p50: Median.
        p95: 95th percentile.
        max: Largest.
        first: Time of the first call.
    """

    p50: float | None
    p95: float | None
    max: float | None
    first: float | None


@dataclass(frozen=True, slots=True)
class CallMemory:
    """Resident memory of a process, bytes; None where it cannot be measured.

    Attributes:
        peak: Largest of all calls.
        idle: Before the first call.
    """

    peak: float | None
    idle: float | None


@dataclass(frozen=True, slots=True)
class CallCosts:
    """Costs of the calls of a run."""

    time_s: CallTimes
    memory_bytes: CallMemory
    calls: float

    @classmethod
    def of(cls, seconds: Sequence[float], peaks: Sequence[int | None], idle_bytes: int | None) -> CallCosts:
        """Return the costs of calls from their times and peaks of memory."""
        known = [peak for peak in peaks if peak is not None]
        memory = CallMemory(max(known, default=None), idle_bytes)
        if not seconds:
            return cls(CallTimes(None, None, None, None), memory, 0)
        p50, p95 = np.percentile(seconds, (50.0, 95.0)).tolist()
        return cls(CallTimes(p50, p95, max(seconds), seconds[0]), memory, len(seconds))

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        return asdict(self)


def median(runs: Sequence[F]) -> F:
    """Return figures with the median of each number over the runs that have it; text is that of the first run.

    Args:
        runs: Frozen dataclasses of numbers, text, mappings and other such dataclasses.
    """
    return cast(F, _median(list(runs)))


def _median(values: Sequence[object]) -> object:
    known = [value for value in values if value is not None]
    if not known:
        return None
    first = known[0]
    if is_dataclass(first) and not isinstance(first, type):
        return replace(first, **_medians([{f.name: getattr(value, f.name) for f in fields(first)} for value in known]))
    if isinstance(first, Mapping):
        return _medians(cast(list[Mapping[str, object]], known))
    return float(np.median(cast(list[float], known))) if isinstance(first, (int, float)) else first


def _medians(runs: Sequence[Mapping[str, object]]) -> dict[str, object]:
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: _median([run.get(name) for run in runs]) for name in names}


def ratios(ours: Mapping[str, Any], other: Mapping[str, Any]) -> JsonObject:
    """Return the magnitude of ours over the other's for each number that both have; None where the other's is 0."""
    found: JsonObject = {}
    for name in ours:
        a, b = ours[name], other.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found[name] = ratios(a, b)
        elif isinstance(a, (int, float)) and isinstance(b, (int, float)):
            found[name] = abs(a / b) if b else None
    return found


def growth(work: Sequence[int], seconds: Sequence[float]) -> float | None:
    """Return the exponent with which time grows with the work (slope of a line through the logarithms)."""
    if len(set(work)) < 2:
        return None
    return float(np.polyfit(np.log(work), np.log(seconds), 1)[0])
