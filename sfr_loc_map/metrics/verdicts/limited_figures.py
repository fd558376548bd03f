"""The figures of the score that a limit can name, each with the field it stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.modes import CallKind
from sfr_loc_map.metrics.score import (
    CallScore,
    ConditionScore,
    Interval,
    IntervalStatistic,
    MapScore,
    MemoryScore,
    PeakMemory,
    SampleStatistic,
    TimingScore,
)


class LimitPart(StrEnum):
    """Part of the score that limits are on; the parts of a limits file."""

    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    TARGET = "target"


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the score.

    Attributes:
        value: The figure, None where it is undefined or absent.
        count: Number of values it is made of, None where it is not made of many.
        interval: Its 95 % interval, None where it has none.
    """

    value: float | None = None
    count: int | None = None
    interval: Interval | None = None


COVERAGE_MIN = "coverage_min"
"""The one limit that is a lower bound."""

_ERRORS: Mapping[str, Callable[[ConditionScore], IntervalStatistic]] = {
    "position_{}_m": lambda score: score.position_m,
    "attitude_{}_deg": lambda score: score.attitude_deg,
    "heading_{}_deg": lambda score: score.heading_deg,
}
_STATISTICS: Mapping[str, Callable[[IntervalStatistic], tuple[float | None, Interval | None]]] = {
    "mean": lambda error: (error.mean, None),
    "sigma": lambda error: (error.sigma, None),
    "mean_plus_3sigma": lambda error: (error.mean_plus_3sigma, error.mean_plus_3sigma_ci95),
}
_POINT_STATISTICS: Mapping[str, Callable[[SampleStatistic], float | None]] = {
    "mean": lambda error: error.mean,
    "sigma": lambda error: error.sigma,
    "mean_plus_3sigma": lambda error: error.mean_plus_3sigma,
    "p50": lambda error: error.p50,
    "p95": lambda error: error.p95,
}
_TIMES: Mapping[str, Callable[[CallScore], float | None]] = {
    "mean": lambda calls: calls.mean,
    "mean_plus_3sigma": lambda calls: calls.mean_plus_3sigma,
    "p50": lambda calls: calls.p50,
    "p95": lambda calls: calls.p95,
    "p99": lambda calls: calls.p99,
    "max": lambda calls: calls.max,
}
_PEAKS: Mapping[str, Callable[[PeakMemory], int | None]] = {
    "peak": lambda peaks: peaks.peak_bytes,
    "above_idle": lambda peaks: peaks.above_idle_bytes,
}


def _of_condition(error: str, statistic: str) -> Callable[[ConditionScore], Figure]:
    def figure(score: ConditionScore) -> Figure:
        value, interval = _STATISTICS[statistic](_ERRORS[error](score))
        return Figure(value, score.count, interval)

    return figure


def _of_points(statistic: str) -> Callable[[MapScore], Figure]:
    def figure(score: MapScore) -> Figure:
        if score.errors is None:
            return Figure()
        return Figure(_POINT_STATISTICS[statistic](score.errors.point_error_m), score.errors.point_error_m.count)

    return figure


def _of_calls(kind: CallKind, statistic: str) -> Callable[[TimingScore], Figure]:
    def figure(score: TimingScore) -> Figure:
        calls = score.of(kind)
        return Figure() if calls is None else Figure(_TIMES[statistic](calls), calls.count)

    return figure


def _of_memory(kind: CallKind, peak: str) -> Callable[[MemoryScore], Figure]:
    def figure(score: MemoryScore) -> Figure:
        peaks = score.of(kind)
        return Figure() if peaks is None else Figure(_PEAKS[peak](peaks))

    return figure


TRAJECTORY_FIGURES = {
    error.format(statistic): _of_condition(error, statistic) for error in _ERRORS for statistic in _STATISTICS
}
MAP_FIGURES: dict[str, Callable[[MapScore], Figure]] = {
    **{f"point_error_{statistic}_m": _of_points(statistic) for statistic in _POINT_STATISTICS},
    COVERAGE_MIN: lambda score: Figure(score.coverage),
}
TIMING_FIGURES = {f"{kind}_{statistic}_s": _of_calls(kind, statistic) for kind in CallKind for statistic in _TIMES}
MEMORY_FIGURES = {
    f"{kind}_{peak}_bytes": _of_memory(kind, peak)
    for kind in (CallKind.LOCALISATION, CallKind.MAPPING)
    for peak in _PEAKS
}
