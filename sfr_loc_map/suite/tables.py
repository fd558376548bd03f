"""The tables of a suite."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from sfr_loc_map.metrics.score import IntervalStatistic
from sfr_loc_map.report.tables import (
    ABSENT,
    DEGREE,
    METRE,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    PERCENT,
    SECOND,
    Cell,
    Column,
    Row,
    Table,
)
from sfr_loc_map.suite.failure_table import failure_table
from sfr_loc_map.suite.groups import Drive, Group
from sfr_loc_map.suite.pooling import PooledCondition
from sfr_loc_map.suite.store import SHORT_KEY
from sfr_loc_map.suite.summary import Summary
from sfr_loc_map.suite.task import NO_CONFIGURATION

ERRORS = (("position", "position_m", METRE), ("attitude", "attitude_deg", DEGREE), ("heading", "heading_deg", DEGREE))
"""Name, key and unit of the errors of a trajectory."""


SUMMARY = "suite.json"
PAGES = "pages"
"""Folder of the pages of single results, beside the page of the suite."""
MAX_PAGES = 200
"""Pages of the worst results; of the others the score is there, of which `sfr report` makes a page."""


def suite_tables(summary: Summary, *, commands: bool = False) -> list[Table]:
    """Return the tables of a suite: counts, verdicts, pooled errors, drives from the worst on, failures.

    Args:
        summary: What is shown.
        commands: Whether each failure has the command that repeats it, which is too long for a terminal's table.
    """
    found = [
        _counts(summary),
        _verdicts(summary),
        _runs(summary),
        _pooled(summary),
        _maps(summary),
        _drives(summary),
        failure_table(summary, commands=commands),
    ]
    return [table for table in found if table is not None and table.rows]


def _counts(summary: Summary) -> Table:
    columns = tuple(Column(name) for name in ("tasks", "done", "failed", "waiting", "sources refused"))
    values = (summary.tasks, summary.done, summary.failed, summary.waiting)
    names = ("tasks", "done", "failed", "waiting")
    cells = tuple(Cell.number(value, f"counts.{name}") for name, value in zip(names, values, strict=True))
    return Table("counts", "Tasks", columns, ((*cells, Cell.number(len(summary.refusals), "refusals")),))


def _name(group: Group) -> str:
    return _joined(group.task, group.configuration, group.faults)


def _joined(*parts: str) -> str:
    """Return the parts that say something."""
    return ", ".join(part for part in parts if part not in ("", NO_CONFIGURATION))


def _in_summary(text: str) -> Cell:
    """Return the name of a row whose figures stand in the summary's file."""
    return replace(Cell.head(text), link=SUMMARY)


def _runs(summary: Summary) -> Table:
    columns = (
        Column("number"),
        Column("task", words=True),
        Column("configuration", words=True),
        Column("faults", words=True),
        Column("drives"),
        Column("frames"),
        Column("lost"),
    )
    rows = tuple(
        (
            Cell.number(number),
            _in_summary(group.task),
            Cell(group.configuration),
            Cell(group.faults or "none"),
            Cell.number(group.drives, f"groups.{number - 1}.drives"),
            *_frames(group, f"groups.{number - 1}"),
        )
        for number, group in enumerate(summary.groups, 1)
    )
    return Table("groups", "Runs", columns, rows, "Drives of one number were run alike.")


def _frames(group: Group, place: str) -> tuple[Cell, Cell]:
    """Return frames and lost frames; maps have none."""
    if not group.conditions:
        return Cell(ABSENT), Cell(ABSENT)
    return Cell.number(group.matched, f"{place}.matched"), Cell.number(group.lost, f"{place}.lost")


def _verdicts(summary: Summary) -> Table:
    columns = (
        Column("runs", words=True),
        Column("figure", words=True),
        Column("limit"),
        Column("value"),
        Column("95 % interval"),
        Column("of", words=True),
        Column("n"),
        Column("drives that miss it"),
        Column("verdict", words=True),
    )
    rows: list[Row] = []
    for number, group in enumerate(summary.groups):
        for index, item in enumerate(group.verdicts):
            place = f"groups.{number}.verdicts.{index}"
            over = f" over {item.condition.label}" if item.condition is not None else ""
            rows.append(
                (
                    _in_summary(_name(group)),
                    Cell(f"{item.metric}{over}"),
                    Cell.number(item.limit, f"{place}.limit"),
                    Cell.number(item.value, f"{place}.value", undefined=ABSENT),
                    Cell.interval(item.ci95, f"{place}.ci95"),
                    Cell(item.over.value),
                    Cell.number(item.count, f"{place}.count"),
                    Cell.number(item.missed_by, f"{place}.missed_by"),
                    Cell.verdict(item.state.value),
                )
            )
    note = "Pooled: the sub-trajectories of all drives are one sample. Worst drive: the figure cannot be pooled."
    return Table("verdicts", "Verdicts over all drives", columns, tuple(rows), note)


def _pooled(summary: Summary) -> Table:
    columns = (
        Column("runs", words=True),
        Column("over", words=True),
        Column("error", words=True),
        Column("mean"),
        Column("sigma"),
        Column("mean + 3 sigma"),
        Column("95 % interval"),
        Column("unit", words=True),
        Column("sub-trajectories"),
        Column("drives"),
    )
    rows = [
        row
        for number, group in enumerate(summary.groups)
        for index, part in enumerate(group.conditions)
        for row in _pooled_rows(group, part, f"groups.{number}.conditions.{index}")
    ]
    note = "95 % interval of mean + 3 sigma by resampling whole drives; it needs five of them."
    return Table("pooled", "Errors over the sub-trajectories of all drives", columns, tuple(rows), note)


def _pooled_rows(group: Group, part: PooledCondition, place: str) -> Iterator[Row]:
    for name, key, unit in ERRORS:
        statistic: IntervalStatistic = getattr(part, key)
        shown = MILLIMETRE if unit is METRE and (statistic.mean_plus_3sigma or 0.0) < 1.0 else unit
        yield (
            _in_summary(_name(group)),
            Cell(part.condition.label),
            Cell(name),
            *(
                Cell.number(getattr(statistic, figure), f"{place}.{key}.{figure}", shown, ABSENT)
                for figure in ("mean", "sigma", "mean_plus_3sigma")
            ),
            Cell.interval(statistic.mean_plus_3sigma_ci95, f"{place}.{key}.mean_plus_3sigma_ci95", shown),
            Cell(shown.symbol),
            Cell.number(part.count, f"{place}.count"),
            Cell.number(part.drives, f"{place}.drives"),
        )


def _maps(summary: Summary) -> Table:
    columns = (
        Column("drive", words=True),
        Column("runs", words=True),
        Column("coverage", PERCENT),
        Column("point error mean", MILLIMETRE),
        Column("mean + 3 sigma", MILLIMETRE),
        Column("result", words=True),
    )
    found = [(drive, drive.score.map) for drive in summary.drives if drive.score.map is not None]
    rows, pages = [], {drive.key for drive in linked(summary)}
    for drive, score in found:
        error = None if score.errors is None else score.errors.point_error_m
        rows.append(
            (
                _page(drive, pages),
                Cell(_of(drive)),
                Cell.number(score.coverage, "map.coverage", PERCENT, ABSENT),
                Cell.number(None if error is None else error.mean, "map.point_error_m.mean", MILLIMETRE, ABSENT),
                Cell.number(
                    None if error is None else error.mean_plus_3sigma,
                    "map.point_error_m.mean_plus_3sigma",
                    MILLIMETRE,
                    ABSENT,
                ),
                _file(drive),
            )
        )
    rows.sort(key=lambda row: -float(row[4].value or 0.0))  # type: ignore[arg-type]
    return Table("maps", "Maps, the worst first", columns, tuple(rows))


def _of(drive: Drive) -> str:
    return _joined(drive.task, drive.configuration, drive.faults, f"repeat {drive.repeat}" if drive.repeat else "")


def worst_first(summary: Summary) -> list[Drive]:
    """Return the drives with a trajectory, those with the largest mean + 3 sigma of position first, then the others."""

    def figure(drive: Drive) -> float:
        trajectory = drive.score.trajectory
        value = None if trajectory is None else trajectory.first.position_m.mean_plus_3sigma
        return -1.0 if value is None else value

    return sorted((drive for drive in summary.drives if drive.score.trajectory is not None), key=figure, reverse=True)


def linked(summary: Summary) -> list[Drive]:
    """Return the results that have a page of their own: the worst drives, and the maps."""
    maps = [drive for drive in summary.drives if drive.score.trajectory is None]
    return (worst_first(summary) + maps)[:MAX_PAGES]


def _page(drive: Drive, pages: set[str]) -> Cell:
    """Return the name of a drive, with a link to its page."""
    return replace(Cell.head(drive.source), link=f"{PAGES}/{drive.key}.html" if drive.key in pages else "")


def _file(drive: Drive) -> Cell:
    """Return the key of a result, with a link to the whole score."""
    return Cell(drive.key[:SHORT_KEY], link=f"results/{drive.key}.json")


def _drives(summary: Summary) -> Table:
    columns = (
        Column("drive", words=True),
        Column("runs", words=True),
        Column("position, mean + 3 sigma", MILLIMETRE),
        Column("attitude", DEGREE),
        Column("heading", DEGREE),
        Column("n"),
        Column("lost"),
        Column("pairs"),
        Column("call p95", MILLISECOND),
        Column("peak", MIB),
        Column("task", SECOND),
        Column("limits missed"),
        Column("result", words=True),
    )
    pages = {drive.key for drive in linked(summary)}
    rows = tuple(_drive_row(drive, pages) for drive in worst_first(summary))
    note = "Errors over the sub-trajectories of the first condition. A drive links to its page, a result to the file."
    return Table("drives", "Drives, the worst first", columns, rows, note)


def _drive_row(drive: Drive, pages: set[str]) -> Row:
    score, trajectory = drive.score, drive.score.trajectory
    assert trajectory is not None
    first = trajectory.first
    calls = None if score.timing is None else score.timing.localisation
    peaks = None if score.memory is None else score.memory.localisation
    place = "trajectory."
    missed = [item.metric for item in score.failed]
    return (
        _page(drive, pages),
        Cell(_of(drive)),
        Cell.number(first.position_m.mean_plus_3sigma, f"{place}position_m.mean_plus_3sigma", MILLIMETRE, ABSENT),
        Cell.number(first.attitude_deg.mean_plus_3sigma, f"{place}attitude_deg.mean_plus_3sigma", DEGREE, ABSENT),
        Cell.number(first.heading_deg.mean_plus_3sigma, f"{place}heading_deg.mean_plus_3sigma", DEGREE, ABSENT),
        Cell.number(first.count, f"{place}count"),
        Cell.number(trajectory.lost, f"{place}lost"),
        Cell.number(trajectory.matched, f"{place}matched"),
        Cell.number(None if calls is None else calls.p95, "timing.localisation_s.p95", MILLISECOND, ABSENT),
        Cell.number(None if peaks is None else peaks.peak_bytes, "memory.localisation_peak_bytes", MIB, ABSENT),
        Cell.number(drive.seconds, "", SECOND, ABSENT),
        Cell.number(len(missed), "verdicts"),
        _file(drive),
    )
