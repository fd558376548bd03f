"""The tables of a suite, of a comparison of suites, and of a history."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

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
from sfr_loc_map.suite.comparison import History, SuiteComparison
from sfr_loc_map.suite.job import NO_CONFIGURATION, SHORT_KEY
from sfr_loc_map.suite.summary import PooledCondition, ScoredJob, Summary

ERRORS = (("position", "position_m", METRE), ("attitude", "attitude_deg", DEGREE), ("heading", "heading_deg", DEGREE))
"""Name, key and unit of the errors of a trajectory."""
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
    names = [_joined(group.task, group.configuration, group.faults) for group in summary.groups]
    tables = (
        _counts(summary),
        _verdicts(summary, names),
        _runs(summary),
        _pooled(summary, names),
        _maps(summary),
        _drives(summary),
        _failures(summary, commands=commands),
    )
    return [table for table in tables if table.rows]


def worst_first(summary: Summary) -> list[ScoredJob]:
    """Return the drives with a trajectory, those with the largest mean + 3 sigma of position first."""
    drives = [drive for drive in summary.drives if drive.score.trajectory is not None]
    return sorted(drives, key=lambda drive: -1.0 if drive.figure is None else drive.figure, reverse=True)


def linked(summary: Summary) -> list[ScoredJob]:
    """Return the results that have a page of their own: the worst drives, and the maps."""
    maps = [drive for drive in summary.drives if drive.score.trajectory is None]
    return (worst_first(summary) + maps)[:MAX_PAGES]


def _words(*titles: str) -> list[Column]:
    return [Column(title, words=True) for title in titles]


def _joined(*parts: str) -> str:
    """Return the parts that say something."""
    return ", ".join(part for part in parts if part not in ("", NO_CONFIGURATION))


def _in_summary(text: str) -> Cell:
    """Return the name of a row whose figures stand in the summary's file."""
    return replace(Cell.head(text), link="suite.json")


def _counts(summary: Summary) -> Table:
    columns = tuple(Column(name) for name in (*summary.counts, "sources refused"))
    cells = [Cell.number(value, f"counts.{name}") for name, value in summary.counts.items()]
    return Table("counts", "Tasks", columns, ((*cells, Cell.number(len(summary.refusals), "refusals")),))


def _runs(summary: Summary) -> Table:
    words = _words("task", "configuration", "faults")
    columns = (Column("number"), *words, Column("drives"), Column("frames"), Column("lost"))
    rows: list[Row] = []
    for index, group in enumerate(summary.groups):
        place = f"groups.{index}"
        frames = (Cell(ABSENT), Cell(ABSENT))  # of maps
        if group.conditions:
            frames = (Cell.number(group.matched, f"{place}.matched"), Cell.number(group.lost, f"{place}.lost"))
        named = (_in_summary(group.task), Cell(group.configuration), Cell(group.faults or "none"))
        rows.append((Cell.number(index + 1), *named, Cell.number(group.drives, f"{place}.drives"), *frames))
    return Table("groups", "Runs", columns, tuple(rows), "Drives of one number were run alike.")


def _verdicts(summary: Summary, names: list[str]) -> Table:
    figures = (Column("limit"), Column("value"), Column("95 % interval"))
    counts = (*_words("of"), Column("n"), Column("drives that miss it"), *_words("verdict"))
    rows: list[Row] = []
    for number, group in enumerate(summary.groups):
        for index, item in enumerate(group.verdicts):
            place = f"groups.{number}.verdicts.{index}"
            over = f" over {item.condition.label}" if item.condition is not None else ""
            rows.append(
                (
                    _in_summary(names[number]),
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
    columns = (*_words("runs", "figure"), *figures, *counts)
    return Table("verdicts", "Verdicts over all drives", columns, tuple(rows), note)


def _pooled(summary: Summary, names: list[str]) -> Table:
    figures = (Column("mean"), Column("sigma"), Column("mean + 3 sigma"), Column("95 % interval"))
    counts = (Column("sub-trajectories"), Column("drives"))
    columns = (*_words("runs", "over", "error"), *figures, *_words("unit"), *counts)
    rows = [
        row
        for number, group in enumerate(summary.groups)
        for index, part in enumerate(group.conditions)
        for row in _pooled_rows(names[number], part, f"groups.{number}.conditions.{index}")
    ]
    note = "95 % interval of mean + 3 sigma by resampling whole drives; it needs five of them."
    return Table("pooled", "Errors over the sub-trajectories of all drives", columns, tuple(rows), note)


def _pooled_rows(runs: str, part: PooledCondition, place: str) -> Iterator[Row]:
    for name, key, unit in ERRORS:
        statistic = getattr(part, key)
        shown = MILLIMETRE if unit is METRE and (statistic.mean_plus_3sigma or 0.0) < 1.0 else unit
        yield (
            _in_summary(runs),
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


def _named(drive: ScoredJob, pages: set[str]) -> tuple[Cell, Cell]:
    """Return the name of a drive, with a link to its page, and how it was run."""
    job = drive.job
    link = f"{PAGES}/{job.key}.html" if job.key in pages else ""
    repeat = f"repeat {job.repeat}" if job.repeat else ""
    return replace(Cell.head(job.source.name), link=link), Cell(_joined(*drive.runs, repeat))


def _file(drive: ScoredJob) -> Cell:
    """Return the key of a result, with a link to the whole score."""
    return Cell(drive.job.key[:SHORT_KEY], link=f"results/{drive.job.key}.json")


def _maps(summary: Summary) -> Table:
    errors = (Column("point error mean", MILLIMETRE), Column("mean + 3 sigma", MILLIMETRE))
    columns = (*_words("drive", "runs"), Column("coverage", PERCENT), *errors, *_words("result"))
    found = []
    pages = {drive.job.key for drive in linked(summary)}
    for drive in summary.drives:
        score = drive.score.map
        if score is None:
            continue
        error = None if score.errors is None else score.errors.point_error_m
        mean, figure = (None, None) if error is None else (error.mean, error.mean_plus_3sigma)
        row = (
            *_named(drive, pages),
            Cell.number(score.coverage, "map.coverage", PERCENT, ABSENT),
            Cell.number(mean, "map.point_error_m.mean", MILLIMETRE, ABSENT),
            Cell.number(figure, "map.point_error_m.mean_plus_3sigma", MILLIMETRE, ABSENT),
            _file(drive),
        )
        found.append((figure or 0.0, row))
    found.sort(key=lambda item: -item[0])
    return Table("maps", "Maps, the worst first", columns, tuple(row for _, row in found))


def _drives(summary: Summary) -> Table:
    errors = (Column("position, mean + 3 sigma", MILLIMETRE), Column("attitude", DEGREE), Column("heading", DEGREE))
    costs = (Column("call p95", MILLISECOND), Column("peak", MIB), Column("task", SECOND), Column("limits missed"))
    columns = (*_words("drive", "runs"), *errors, Column("n"), Column("lost"), Column("pairs"), *costs)
    pages = {drive.job.key for drive in linked(summary)}
    rows: list[Row] = []
    for drive in worst_first(summary):
        score, trajectory = drive.score, drive.score.trajectory
        assert trajectory is not None
        first, place = trajectory.first, "trajectory."
        calls = None if score.timing is None else score.timing.localisation
        peaks = None if score.memory is None else score.memory.localisation
        peak = None if peaks is None else peaks.peak_bytes
        position, attitude, heading = first.position_m, first.attitude_deg, first.heading_deg
        rows.append(
            (
                *_named(drive, pages),
                Cell.number(position.mean_plus_3sigma, f"{place}position_m.mean_plus_3sigma", MILLIMETRE, ABSENT),
                Cell.number(attitude.mean_plus_3sigma, f"{place}attitude_deg.mean_plus_3sigma", DEGREE, ABSENT),
                Cell.number(heading.mean_plus_3sigma, f"{place}heading_deg.mean_plus_3sigma", DEGREE, ABSENT),
                Cell.number(first.count, f"{place}count"),
                Cell.number(trajectory.lost, f"{place}lost"),
                Cell.number(trajectory.matched, f"{place}matched"),
                Cell.number(None if calls is None else calls.p95, "timing.localisation_s.p95", MILLISECOND, ABSENT),
                Cell.number(peak, "memory.localisation_peak_bytes", MIB, ABSENT),
                Cell.number(drive.seconds, "", SECOND, ABSENT),
                Cell.number(len(score.failed), "verdicts"),
                _file(drive),
            )
        )
    note = "Errors over the sub-trajectories of the first condition. A drive links to its page, a result to the file."
    return Table("drives", "Drives, the worst first", (*columns, *_words("result")), tuple(rows), note)


def _failures(summary: Summary, *, commands: bool) -> Table:
    """Return jobs that failed and sources that were refused, each with its cause."""
    columns = (
        *_words("task", "cause"),
        Column("tries"),
        *_words("message", *(("again",) if commands else ()), "result"),
    )
    rows: list[Row] = []
    for item, again in zip(summary.failures, summary.again, strict=True):
        told = (Cell.head(item.label), Cell(item.cause.value), Cell.number(item.tries, "tries"), Cell(item.message))
        link = Cell(item.key[:SHORT_KEY], link=f"failures/{item.key}.json")
        rows.append((*told, *((Cell(again or ABSENT),) if commands else ()), link))
    for refusal in summary.refusals:
        told = (Cell.head(refusal.path), Cell("source refused"), Cell.number(0, "refusals"), Cell(refusal.reason))
        rows.append((*told, *((Cell(ABSENT),) if commands else ()), Cell(ABSENT)))
    return Table("failures", "Failures", columns, tuple(rows))


def comparison_tables(result: SuiteComparison) -> list[Table]:
    """Return the table of a comparison of suites."""
    figures = (Column("drives"), Column("ratio"), Column("95 % interval"), Column("p"), Column("p, corrected"))
    columns = (*_words("runs", "figure"), *figures, *_words("the other is"), Column("largest ratio"), *_words("at"))
    rows = tuple(
        (
            Cell.head(item.runs),
            Cell(item.figure),
            Cell.number(item.drives),
            Cell.number(item.ratio),
            Cell.interval(item.ci95),
            Cell.number(item.p, undefined=ABSENT),
            Cell.number(item.p_corrected, undefined=ABSENT),
            Cell(item.outcome.value),
            Cell.number(item.worst.other / item.worst.first),
            Cell(item.worst.label),
        )
        for item in result.figures
    )
    note = (
        "Ratio: geometric mean over the drives of mean + 3 sigma, or of the cost; below 1 the other is better. "
        f"Corrected for {len(result.figures)} comparisons (Holm). Not in both: {result.left_out[0]} and "
        f"{result.left_out[1]}."
    )
    title = f"{result.names[1]} over {result.names[0]}, {result.common} drives in both"
    return [Table("comparison", title, columns, rows, note)]


def history_tables(history: History) -> list[Table]:
    """Return the table of a history: every figure of every run beside its baseline."""
    counts = (Column("drives"), Column("median"))
    ratios = (Column("ratio"), Column("95 % interval"), Column("p"))
    rows = tuple(
        (
            Cell.head(item.figure),
            Cell(item.run),
            Cell.number(item.drives),
            Cell.number(item.median),
            Cell(item.baseline),
            Cell.number(item.ratio),
            Cell.interval(item.ci95),
            Cell.number(item.p, undefined=ABSENT),
            Cell(item.outcome.value),
        )
        for item in history.points
    )
    note = f"Certain: p below {history.level:.2g}, so that a history without a change gives an alarm once in 100 times."
    columns = (*_words("figure", "run"), *counts, *_words("baseline"), *ratios, *_words("is"))
    return [Table("history", "Runs beside their baseline", columns, rows, note)]
