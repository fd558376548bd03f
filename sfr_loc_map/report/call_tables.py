"""The tables of calls: times, stages, memory; of this host and of a target."""

from __future__ import annotations

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import MemoryScore, Score, TimingScore
from sfr_loc_map.report.score_cells import figure
from sfr_loc_map.report.terms import terms
from sfr_loc_map.tables.numbers import MIB, SECOND, UNKNOWN, fitting
from sfr_loc_map.tables.table import Cell, Column, Row, Table

HOST = "host"
"""First word of the name of a clock of this machine."""


def clock_text(timing: TimingScore | None, target: str = "") -> str:
    """Return which clock the times were measured with, and that a host time is no other time.

    Args:
        timing: Times of calls; empty text without.
        target: Name of the target whose calls were read in as well, empty for none.
    """
    clocks = sorted({calls.clock for _, calls in timing.kinds()}) if timing is not None else []
    if not clocks:
        return ""
    text = f"Clock: {', '.join(clocks)}."
    if any(clock.startswith(HOST) for clock in clocks):
        text += f" Host times are of the machine the run was made on{f', not of {target}' if target else ''}."
    return text


def target_name(score: Score) -> str:
    """Return the name of the target whose calls were read in, empty for none."""
    return "" if score.target is None else score.target.name


def time_table(score: Score) -> Table | None:
    """Return the times of the calls."""
    if score.timing is None:
        return None
    return _time_table(score.timing, "time", "Time per call", "timing", target_name(score))


def target_tables(score: Score) -> list[Table | None]:
    """Return times and memory of the calls that were measured on a target."""
    target = score.target
    if target is None:
        return []
    return [
        _time_table(target.timing, "target-time", f"Time per call on {target.name}", "target.timing"),
        _memory_table(target.memory, "target-memory", f"Peak memory on {target.name}", "target.memory"),
    ]


def _time_table(timing: TimingScore, name: str, title: str, place: str, target: str = "") -> Table | None:
    rows: list[Row] = []
    for kind, calls in timing.kinds():
        key = f"{place}.{kind}_s"
        unit = fitting(SECOND, calls.max, calls.mean_plus_3sigma)
        names = ("p50", "p95", "p99", "max", "mean_plus_3sigma", "first", "max_after_first")
        cells = (figure(getattr(calls, name), f"{key}.{name}", unit) for name in names)
        count = Cell.number(calls.count, f"{key}.count")
        rows.append((Cell.head(kind.value), Cell(unit.symbol), *cells, count, Cell(calls.clock)))
    if not rows:
        return None
    titles = ("p50", "p95", "p99", "max", "mean + 3 sigma", "first call", "max without it")
    columns = (Column("call", words=True), Column("unit"), *map(Column, titles), Column("n"), Column("clock"))
    words = terms("time per call", "p50, p95, p99", "mean + 3 sigma", "first call")
    return Table(name, title, columns, tuple(rows), clock_text(timing, target), words)


def stage_table(score: Score) -> Table | None:
    """Return the times of the stages of the calls, None where no call had any."""
    rows: list[Row] = []
    stages = [times for _, calls in (score.timing.kinds() if score.timing else ()) for times in calls.stages.values()]
    unit = fitting(SECOND, *(times.max for times in stages))
    for kind, calls in score.timing.kinds() if score.timing is not None else ():
        for stage, times in calls.stages.items():
            key = f"timing.{kind}_s.stages.{stage}"
            cells = (
                figure(times.mean, f"{key}.mean", unit),
                figure(times.p50, f"{key}.p50", unit),
                figure(times.p95, f"{key}.p95", unit),
                figure(times.max, f"{key}.max", unit),
            )
            rows.append((Cell.head(f"{kind}: {stage}"), *cells, Cell.number(times.count, f"{key}.count")))
    if not rows:
        return None
    note = (
        "Over the calls that had the stage. Keyframe: work of a thread of its own after its call; the next call waits "
        "for what is left of it (wait)."
    )
    titles = (Column(title, unit) for title in ("mean", "p50", "p95", "max"))
    return Table("stages", "Time of stages", (Column("stage", words=True), *titles, Column("n")), tuple(rows), note)


def memory_table(score: Score) -> Table | None:
    """Return the peak memory of the calls."""
    if score.memory is None:
        return None
    return _memory_table(score.memory, "memory", "Peak resident memory during a call", "memory")


def _memory_table(memory: MemoryScore, name: str, title: str, place: str) -> Table | None:
    rows: list[Row] = []
    for kind in CallKind:
        peak = memory.of(kind)
        if peak is None or (peak.peak_bytes is None and peak.above_idle_bytes is None):
            continue
        key = f"{place}.{kind}"
        cells = (
            Cell.number(peak.peak_bytes, f"{key}_peak_bytes", MIB),
            Cell.number(peak.above_idle_bytes, f"{key}_above_idle_bytes", MIB),
        )
        rows.append((Cell.head(kind.value), *cells))
    if not rows:
        return None
    columns = (Column("call", words=True), Column("peak", MIB), Column("above the idle process", MIB))
    words = terms("peak", "above the idle process")
    return Table(name, title, columns, tuple(rows), f"Method: {memory.method or UNKNOWN}.", words)
