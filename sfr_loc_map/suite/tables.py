"""The tables of a suite, of a comparison of suites, and of a history, made of their JSON values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.report.score_tables import limit_name, limit_unit
from sfr_loc_map.report.tables import (
    ABSENT,
    DEGREE,
    METRE,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    NONE,
    PERCENT,
    SHARE,
    Cell,
    Column,
    Table,
    Unit,
    fitting,
)
from sfr_loc_map.suite.comparison import SuiteComparison
from sfr_loc_map.suite.history import MIN_REFERENCE, History
from sfr_loc_map.suite.job import NO_CONFIGURATION, SHORT_KEY
from sfr_loc_map.suite.summary import ScoredJob, Summary

PAGES = "pages"  #: Folder of the pages of single results, beside the page of the suite.
MAX_PAGES = 200  #: Pages of the worst results; of the others the score is there, of which `sfr report` makes a page.
HEAD, WORDS, INTERVAL, VERDICT, FILE, SHOWN = "head", "words", "interval", "verdict", "file", "shown"
"""Kinds of columns without one unit; of `SHOWN` each row names its own."""
Columns = tuple[tuple[str, Unit | str, str], ...]
"""Title, unit or kind, and the keys that lead to the value in a row, joined by dots."""
GROUPS: Columns = (
    ("number", NONE, "number"),
    ("task", HEAD, "task"),
    ("configuration", WORDS, "configuration"),
    ("faults", WORDS, "faults"),
    ("drives", NONE, "drives"),
    ("frames", NONE, "matched"),
    ("lost", NONE, "lost"),
)
VERDICTS: Columns = (
    ("verdict", VERDICT, "verdict"),
    ("runs", HEAD, "runs"),
    ("figure", WORDS, "figure"),
    ("unit", WORDS, "unit"),
    ("value", SHOWN, "value"),
    ("limit", SHOWN, "limit"),
    ("95 % interval", INTERVAL, "ci95"),
    ("of", WORDS, "over"),
    ("n", NONE, "count"),
    ("drives that miss it", NONE, "missed_by"),
)
POOLED: Columns = (
    ("runs", HEAD, "runs"),
    ("over", WORDS, "over"),
    ("error", WORDS, "error"),
    ("mean", SHOWN, "mean"),
    ("sigma", SHOWN, "sigma"),
    ("mean + 3 sigma", SHOWN, "mean_plus_3sigma"),
    ("95 % interval", INTERVAL, "mean_plus_3sigma_ci95"),
    ("unit", WORDS, "unit"),
    ("sub-trajectories", NONE, "count"),
    ("drives", NONE, "drives"),
)
DRIVES: Columns = (
    ("drive", HEAD, "source"),
    ("runs", WORDS, "runs"),
    ("position, mean + 3 sigma", MILLIMETRE, "trajectory.position_m.mean_plus_3sigma"),
    ("attitude", DEGREE, "trajectory.attitude_deg.mean_plus_3sigma"),
    ("heading", DEGREE, "trajectory.heading_deg.mean_plus_3sigma"),
    ("covered", PERCENT, "trajectory.completeness.judged_share"),
    ("n", NONE, "trajectory.count"),
    ("lost", NONE, "trajectory.lost"),
    ("pairs", NONE, "trajectory.matched"),
    ("call p95", MILLISECOND, "timing.localisation_s.p95"),
    ("peak", MIB, "memory.localisation_peak_bytes"),
    ("limits missed", NONE, "missed"),
    ("result", FILE, "key"),
)
MAPS: Columns = (
    ("drive", HEAD, "source"),
    ("runs", WORDS, "runs"),
    ("coverage", PERCENT, "map.coverage"),
    ("point error mean", MILLIMETRE, "map.point_error_m.mean"),
    ("mean + 3 sigma", MILLIMETRE, "map.point_error_m.mean_plus_3sigma"),
    ("result", FILE, "key"),
)
WORKERS: Columns = (
    ("worker", HEAD, "worker"),
    ("host", WORDS, "host"),
    ("version", WORDS, "version"),
    ("code", WORDS, "code"),
    ("data checked", NONE, "data_checked"),
    ("tasks done", NONE, "done"),
    ("set aside", WORDS, "set_aside"),
)
FAILURES: Columns = (
    ("task", HEAD, "label"),
    ("cause", WORDS, "cause"),
    ("message", WORDS, "message"),
    ("result", FILE, "key"),
)
COMPARISON: Columns = (
    ("runs", HEAD, "runs"),
    ("figure", WORDS, "figure"),
    ("drives", NONE, "drives"),
    ("ratio", NONE, "ratio"),
    ("95 % interval", INTERVAL, "ci95"),
    ("p", NONE, "p"),
    ("p, corrected", NONE, "p_corrected"),
    ("the other is", WORDS, "outcome"),
    ("largest ratio", NONE, "largest"),
    ("at", WORDS, "worst.label"),
)
HISTORY: Columns = (
    ("since", HEAD, "night"),
    ("commits", WORDS, "range"),
    ("figure", WORDS, "figure"),
    ("is", WORDS, "outcome"),
    ("drives", WORDS, "which"),
    ("before", NONE, "before"),
    ("after", NONE, "after"),
    ("found", WORDS, "found"),
    ("see", WORDS, "command"),
)
WORST = ("fail", "incomplete", "not enough data")  #: Verdicts that stand first.
NAMED = 5  #: Drives of a change that are named in a table.


def _table(name: str, title: str, columns: Columns, rows: Iterable[Mapping[str, Any]], note: str = "") -> Table:
    heads = tuple(
        Column(title, kind if isinstance(kind, Unit) else NONE, kind in (HEAD, WORDS, VERDICT, FILE))
        for title, kind, _ in columns
    )
    cells = tuple(tuple(_cell(row, kind, keys) for _, kind, keys in columns) for row in rows)
    return Table(name, title, heads, cells, note)


def _cell(row: Mapping[str, Any], kind: Unit | str, keys: str) -> Cell:
    value: Any = row
    for key in keys.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    text = ABSENT if value in (None, "") else str(value)
    if isinstance(kind, Unit) or kind == SHOWN:
        return Cell.number(value, keys, kind if isinstance(kind, Unit) else row["shown"], ABSENT)
    if kind == INTERVAL:
        return Cell.interval(value, keys, row.get("shown", NONE))
    if kind == HEAD:
        return replace(Cell.head(text), link=row.get("link", ""))
    if kind == FILE:
        return Cell(text[:SHORT_KEY], link="" if text == ABSENT else f"{row.get('folder', 'results')}/{text}.json")
    return Cell.verdict(text) if kind == VERDICT else Cell(text)


def suite_tables(summary: Summary) -> list[Table]:
    """Return the tables of a suite: counts, verdicts, pooled errors, drives from the worst on, failures."""
    groups, verdicts, pooled = [], [], []
    for number, group in enumerate(summary.groups, 1):
        head = {"runs": _joined(*group.runs), "link": "suite.json"}
        row = {**to_plain(group), **head, "number": number, "faults": group.faults or "none"}
        groups.append(row if group.conditions else row | {"matched": None, "lost": None})  # maps have no frames
        for part in group.conditions:
            for key, unit in (("position_m", METRE), ("attitude_deg", DEGREE), ("heading_deg", DEGREE)):
                figures = to_plain(getattr(part, key))
                shown = MILLIMETRE if unit is METRE and (figures["mean_plus_3sigma"] or 0.0) < 1.0 else unit
                named = {"over": part.condition.label, "error": key.partition("_")[0], "unit": shown.symbol}
                pooled.append(figures | head | named | {"count": part.count, "drives": part.drives, "shown": shown})
        for item in group.verdicts:
            figure = limit_name(item.metric) + ("" if item.condition is None else f" over {item.condition.label}")
            unit = fitting(limit_unit(item.metric), item.limit, item.value, *(item.ci95 or ()))
            unit = PERCENT if unit is SHARE else unit
            verdicts.append({**to_plain(item), **head, "figure": figure, "unit": unit.symbol, "shown": unit})
    verdicts.sort(key=lambda row: WORST.index(row["verdict"]) if row["verdict"] in WORST else len(WORST))
    failures = [to_plain(item) | {"folder": "failures"} for item in summary.failures]
    failures += [{"label": item.path, "cause": "source refused", "message": item.reason} for item in summary.refusals]
    pages = {drive.job.key for drive in linked(summary)}
    maps = [_row(drive, pages) for drive in summary.drives if drive.score.map is not None]
    maps.sort(key=lambda row: -((row["map"].get("point_error_m") or {}).get("mean_plus_3sigma") or 0.0))
    counts = summary.counts | {"sources refused": len(summary.refusals)}
    of_verdicts = "Pooled: the sub-trajectories of all drives are one sample. Worst drive: the figure cannot be pooled."
    of_pooled = "95 % interval of mean + 3 sigma by resampling whole drives; it needs five of them."
    of_workers = "Data checked: sources whose hash was that of the plan. One that was set aside got no more tasks."
    of_drives = "Errors over the sub-trajectories of the first condition."
    drives = [_row(drive, pages) for drive in worst_first(summary)]
    tables = (
        _table("verdicts", "Verdicts over all drives", VERDICTS, verdicts, of_verdicts),
        _table("failures", "Tasks without a result", FAILURES, failures),
        _table("counts", "Tasks", tuple((name, NONE, name) for name in counts), [counts]),
        _table("groups", "Runs", GROUPS, groups, "Drives of one number were run alike."),
        _table("pooled", "Errors over the sub-trajectories of all drives", POOLED, pooled, of_pooled),
        _table("maps", "Maps, the worst first", MAPS, maps),
        _table("drives", "Drives, the worst first", DRIVES, drives, of_drives),
        _table("workers", "Workers", WORKERS, map(to_plain, summary.workers), of_workers),
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


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part not in ("", NO_CONFIGURATION))


def _row(drive: ScoredJob, pages: set[str]) -> dict[str, Any]:
    job, score = drive.job, drive.score
    return {
        **drive.names(),
        **{part: to_plain(getattr(score, part)) for part in ("trajectory", "timing", "memory", "map")},
        "runs": _joined(*drive.runs, f"repeat {job.repeat}" if job.repeat else ""),
        "link": f"{PAGES}/{job.key}.html" if job.key in pages else "",
        "missed": len(score.failed),
    }


def comparison_tables(result: SuiteComparison) -> list[Table]:
    """Return the table of a comparison of suites."""
    rows = [{**to_plain(item), "largest": item.worst.other / item.worst.first} for item in result.figures]
    note = (
        "Ratio: geometric mean over the drives of mean + 3 sigma, or of the cost; below 1 the other is better. "
        f"Corrected for {len(result.figures)} comparisons (Holm). Not in both: {result.left_out[0]} and "
        f"{result.left_out[1]}."
    )
    title = f"{result.names[1]} over {result.names[0]}, {result.common} drives in both"
    return [_table("comparison", title, COMPARISON, rows, note)]


def history_tables(history: History) -> list[Table]:
    """Return the table of a history: every change of a figure."""
    note = (
        f"Nights: {len(history.nights)}. Before and after: means over the drives named. A night without a change gives "
        f"an alarm once in {history.alarm:g} nights at most."
    )
    if len(history.nights) <= MIN_REFERENCE:
        note += f" Of fewer than {MIN_REFERENCE + 1} nights only a change of most drives is found."
    rows: list[dict[str, Any]] = []
    for change in history.changes:
        named = ", ".join(change.drives[:NAMED]) + (", ..." if len(change.drives) > NAMED else "")
        which = f"{len(change.drives)} of {change.of}" + ("" if len(change.drives) == change.of else f": {named}")
        rows.append(to_plain(change) | {"range": change.range, "which": which, "command": change.command})
    return [_table("history", "Changes" if rows else "No figure changed", HISTORY, rows, note)]
