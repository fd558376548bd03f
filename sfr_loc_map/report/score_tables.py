"""The tables of a score: views of the rows of its table of figures. Each cell names its key in the JSON.

Figures without a table are shown in a final table, so that every report contains every row of the score.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import msgspec

from sfr_loc_map.metrics.calls import AFTER_FIRST, FIRST
from sfr_loc_map.metrics.catalogue import ALIGNED, DIRECTIONS, KINDS, Subject, statistic_title, title_of
from sfr_loc_map.metrics.config import CallKind, Rebase, label_of
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.row_part import Place
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import NUMBERS, Figure
from sfr_loc_map.metrics.verdict import Verdict
from sfr_loc_map.report.tables import (
    ABSENT,
    NOT_ENOUGH,
    UNKNOWN,
    Cell,
    Column,
    Row,
    Table,
    Unit,
    fitting,
    number,
    to_markdown,
)
from sfr_loc_map.report.verdict_view import name_of, verdict_views

SUMMARY = (
    *("headline", "aligned", "map", "time", "memory", "target-time", "target-memory", "external", "method"),
    *("readings", "covered", "verdicts"),
)
"""Tables of the terminal. The verdicts are last, so that they stay visible."""
HOST = "host"  #: First word of the name of a clock of the host.
UNNAMED = "not named"
EXACT = "The truth is assumed exact; --set truth.sigma_m=M and truth.sigma_deg=DEG of sfr score set its noise."
NO_INTERVAL = (
    "Only mean + 3 sigma over sub-trajectories has a 95 % interval, if at least two sub-trajectories are independent. "
    "Without an interval no verdict is certain (-)."
)
EVIDENCE = (
    "Mean + 3 sigma of n independent sub-trajectories exceeds the stated fraction of all position errors with this "
    "confidence, if errors are normally distributed. A dominant axis lowers the confidence."
)
CALL_PARTS = (None, FIRST, AFTER_FIRST)  #: Parts of the times of complete calls on this host.
READINGS = {
    Rebase.POSE: "the estimate is re-based at the start by its full pose, then poses are compared",
    Rebase.DISPLACEMENT: "displacements in DS and changes of attitude and heading since the start are compared, as the "
    "document literally states; an attitude error at the start counts in the position error",
    Rebase.POSITION: "the estimate is re-based at the start by its position only; earlier attitude errors count",
}
TERMS: Mapping[str, str] = {
    "sub-trajectory": "the part of the drive from a start to the frame at which the condition is met",
    "re-based": "the estimate is moved to the true pose at each start, so that errors before the start do not count",
    "position error": "estimated minus true position at the end, as a vector; the mean is the norm of the mean vector",
    "attitude error": "angle between the estimated and the true attitude at the end of a sub-trajectory",
    "heading error": "estimated minus true heading (about the vertical) at the end, signed",
    "chord error": "straight distance from start to end, estimated minus true; requires no attitudes",
    "fitted": "aligned by one rotation (about the vertical unless z is tilted) and one translation per drive",
    "mean + 3 sigma": "norm of the mean plus three standard deviations, the statistic that the specification limits",
    "95 % interval": "confidence interval that contains the true mean + 3 sigma in 95 of 100 such drives",
    "independent": "number of sub-trajectories divided by the mean number of overlapping sub-trajectories",
    "rmse": "root mean square of the norms of the errors",
    "p50, p95, p99": "quantiles: 50, 95 or 99 % of the norms of the errors are at most this large",
    "not enough data": "the figure is undefined, or computed from fewer values than the limits require",
    "DS": "the fixed world frame of the drive: x east, y north, z up",
    "LM": "the local map frame of the map coordinates: fixed to the ground, z up",
    "along, across": "in the direction of the true path, and to its left",
    "NEES": "squared error normalised by its covariance; equal to the number of components on average if consistent",
    "point error": "distance from a map point to the true point of its pixel",
    "distance to the nearest true point": "distance from a map point to any true point; at most the point error",
    "coverage": "fraction of the true points in the scored range that have a map point",
    "disparity error": "depth error converted to disparity, in pixels; it does not grow with range",
    "time": "duration of a call of the localiser or mapper, without transport and queueing",
    "first call": "reported separately, because it may include one-time initialisation",
    "peak memory": "largest resident memory of the process during a call",
    "above the idle process": "peak memory minus the resident memory between start and first call",
    "certain": "the 95 % interval lies on one side of the limit",
    "margin": "distance from the value to the limit; negative if the limit is missed",
    "missing": "images without an estimate; if the images are unknown, true poses in gaps between estimates",
    "judged fraction": "fraction of images with an estimate; if unknown, fraction of the true path outside gaps",
    "lost": "no pose could be estimated; scored with the last known pose",
    "degraded": "a pose was estimated, but a check failed; its covariance is inflated and a reason is reported",
}
"""Definitions of the terms in the tables."""


class Placed(NamedTuple):
    """A row of the table of figures and its index in the score."""

    place: int
    row: Figure


# ---- assignment of rows to tables


def is_headline(score: Score, row: Figure) -> bool:
    """Return whether a row is in the first table: full figures of the catalogue, and limited figures."""
    if is_limited(score, row):
        return True
    if row.figure not in KINDS or not KINDS[row.figure].shown:
        return False
    if row.subject is Subject.MEMORY:  # the part of a peak is the kind of call
        return row.value is not None and row.place is not Place.TARGET
    return row is score.judged_row(row.figure, condition=row.condition)


def is_limited(score: Score, row: Figure) -> bool:
    """Return whether a limit is on a row."""
    return any(
        score.row_of(item) is row and item.subject is not Subject.COMPLETENESS and item.value is not None
        for item in score.verdicts
    )


class View(NamedTuple):
    """A table of figures: name, title, selected rows and explanation."""

    name: str
    title: str
    shows: Callable[[Score, Figure], bool]
    note: Callable[[Score], str] = lambda score: ""
    #: Statistics of a row, in addition to limited ones.
    columns: Callable[[Figure], Sequence[str]] = lambda row: NUMBERS


def shown_statistics(row: Figure) -> Sequence[str]:
    """Return the statistics of a figure that every view shows, from the catalogue."""
    return KINDS[row.figure].shown if row.figure in KINDS else NUMBERS


def compared_statistics(row: Figure) -> Sequence[str]:
    """Return the statistics by which runs are compared, from the catalogue."""
    return KINDS[row.figure].compared if row.figure in KINDS else NUMBERS


def is_of_a_reading(score: Score, row: Figure) -> bool:
    """Return whether a row has the errors of sub-trajectories by one reading of the document."""
    return row.subject is Subject.TRAJECTORY and row.condition is not None and row.part in [*Rebase]


def is_growth(score: Score, row: Figure) -> bool:
    """Return whether a row has the errors of sub-trajectories of one length."""
    return row.subject is Subject.TRAJECTORY and row.condition is None and row.figure not in ALIGNED


def is_time(score: Score, row: Figure) -> bool:
    """Return whether a row has the times of calls on this host."""
    return row.subject is Subject.TIMING and row.part in CALL_PARTS


def is_stage(score: Score, row: Figure) -> bool:
    """Return whether a row has the times of a stage of calls on this host."""
    is_of_calls = row.subject is Subject.TIMING and row.figure in [*CallKind]
    return is_of_calls and row.part not in CALL_PARTS and row.place is not Place.TARGET


def is_deadline(score: Score, row: Figure) -> bool:
    """Return whether a row compares calls on this host with the period of the pairs."""
    return row.subject is Subject.TIMING and row.figure not in [*CallKind] and row.place is not Place.TARGET


def deadline_note(score: Score) -> str:
    """Return the explanation of the period."""
    return "The period is the median difference of the stamps of the pairs. Times are of one call, wall-clock."


def is_by_direction(score: Score, row: Figure) -> bool:
    """Return whether a row has the position errors along one direction."""
    return row.subject is Subject.TRAJECTORY and row.part in DIRECTIONS


def is_memory(score: Score, row: Figure) -> bool:
    """Return whether a row has the memory of calls on this host."""
    return row.subject is Subject.MEMORY and row.place is not Place.TARGET


def memory_note(score: Score) -> str:
    """Return the method of the memory measurement."""
    return f"Method: {UNKNOWN if score.calls is None else score.calls.memory_method or UNKNOWN}."


def directions_note(score: Score) -> str:
    """Return the explanation of errors by direction."""
    return "x, y, z of DS. Means are signed."


def stages_note(score: Score) -> str:
    """Return the explanation of the times of stages."""
    return "Over the calls that ran the stage."


def score_tables(score: Score) -> list[Table]:
    """Return all non-empty tables of a score, the most important first."""
    placed = [Placed(place, row) for place, row in enumerate(score.figures)]
    shown: set[int] = set()
    found = []
    for view in VIEWS:
        rows = [item for item in placed if view.shows(score, item.row)]
        shown |= {item.place for item in rows}
        found.append(figure_table(view.name, view.title, rows, view.note(score), columns_of(view, score, rows)))
    others = [item for item in placed if item.place not in shown]
    found.append(figure_table("others", "Other figures", others))
    tables = [verdict_table(score), *found, external_table(score), method_table(score), association_table(score)]
    return [table for table in tables if table.rows]


def summary_tables(score: Score) -> list[Table]:
    """Return the tables for the terminal. Completeness is shown without zeros and without the note of the verdict."""
    named = {table.name: table for table in score_tables(score)}
    if (covered := named.get("covered")) is not None:
        rows = tuple(row for row in covered.rows if any(cell.value for cell in row))
        named["covered"] = replace(covered, rows=rows, note="")
    return [named[name] for name in SUMMARY if name in named]


def table_of(score: Score, name: str) -> Table:
    """Return one of the tables of figures, which may have no rows."""
    view = next(view for view in VIEWS if view.name == name)
    placed = (Placed(place, row) for place, row in enumerate(score.figures))
    rows = [item for item in placed if view.shows(score, item.row)]
    return figure_table(name, view.title, rows, view.note(score), columns_of(view, score, rows))


def columns_of(view: View, score: Score, placed: Sequence[Placed]) -> tuple[str, ...]:
    """Return the statistics that a table shows: those of its rows, and the limited statistics."""
    wanted = {item.statistic for item in score.verdicts}
    for _, row in placed:
        wanted.update(view.columns(row))
    return tuple(key for key in NUMBERS if key in wanted)


def glossary() -> Table:
    """Return the terms of the tables with their definitions."""
    rows = tuple((Cell.head(word), Cell(text)) for word, text in TERMS.items())
    return Table("words", "Words", (Column("word", words=True), Column("meaning", words=True)), rows)


def score_markdown(score: Score) -> str:
    """Return all tables as Markdown."""
    return to_markdown([*score_tables(score), glossary()], "Score")


# ---- the one renderer of figures


def figure_table(
    name: str, title: str, placed: Sequence[Placed], note: str = "", wanted: Sequence[str] = NUMBERS
) -> Table:
    """Return rows of the table of figures as a table; columns that no row has are omitted."""
    rows = [item.row for item in placed]
    statistics = [key for key in wanted if any(row.statistic(key) is not None for row in rows)]
    has_interval = any(row.interval for row in rows)
    is_detailed = tuple(wanted) == NUMBERS
    has_independent = is_detailed and any(row.independent is not None for row in rows)
    columns = [Column("figure", words=True), Column("unit", words=True)]
    columns += [Column(statistic_title(key)) for key in statistics]
    columns += [Column("95 % interval")] if has_interval else []
    columns.append(Column("n"))
    columns += [Column("independent")] if has_independent else []
    cells: list[Row] = []
    for index, row in placed:
        unit, place = row_unit(row), f"figures.{index}"
        line = [Cell.head(row_title(row)), Cell(unit.symbol)]
        for key in statistics:
            value = row.statistic(key)
            line.append(Cell.number(value, "" if value is None else f"{place}.{key}", unit, undefined_of(row, key)))
        if has_interval:
            line.append(Cell.interval(row.interval, place, unit, ABSENT))
        line.append(Cell(ABSENT) if row.n is None else Cell.number(row.n, f"{place}.n"))
        if has_independent:
            independent = row.independent
            line.append(Cell(ABSENT) if independent is None else Cell.number(independent, f"{place}.independent"))
        cells.append(tuple(line))
    return Table(name, title, tuple(columns), tuple(cells), note)


def undefined_of(row: Figure, statistic: str) -> str:
    """Return the text of an undefined number: not enough data if the figure could have this number."""
    if row.is_one_number or row.value is not None:
        return UNKNOWN if statistic == "value" else ABSENT
    return NOT_ENOUGH if statistic != "value" and not row.is_defined else ABSENT


def row_title(row: Figure) -> str:
    """Return the displayed name of a row: `position error over 5 m, along the path`."""
    over = f" over {label_of(row.condition)}" if row.condition else ""
    part = "" if row.part is None else f", {DIRECTIONS.get(row.part, row.part.replace('_', ' '))}"
    return f"{title_of(row.figure)}{over}{part}"


def row_unit(row: Figure) -> Unit:
    """Return the unit that suits the numbers of a row."""
    if row.unit == "bytes":
        return Unit("MiB")
    if row.unit == "1":
        return Unit()
    return fitting(Unit(row.unit), *(row.statistic(key) for key in NUMBERS), row.high95)


# ---- verdicts


def verdict_table(score: Score) -> Table:
    """Return the verdict on each limit."""
    rows: list[Row] = []
    has_ids = any(item.id for item in score.verdicts)
    for view in verdict_views(score):
        row = (
            Cell.verdict(view.item.state.value),
            *([Cell(view.item.id or ABSENT)] if has_ids else []),
            Cell.head(view.name),
            Cell(view.unit.symbol),
            view.value,
            view.limit,
            view.margin,
            view.interval,
            view.count,
            Cell(view.confidence),
        )
        rows.append(row)
    titles = ("unit", "value", "limit", "margin", "95 % interval", "n", "certain")
    columns = (Column("figure", words=True), *(Column(title) for title in titles))
    heads = (Column("verdict", words=True), *([Column("requirement", words=True)] if has_ids else []))
    note = NO_INTERVAL if any(item.certain is None for item in score.verdicts) else ""
    return Table("verdicts", "Verdicts", (*heads, *columns), tuple(rows), note)


def limits_on(
    score: Score, figure: str, condition: str | None = None, part: str | None = None
) -> list[tuple[str, float]]:
    """Return the limits on a figure with their statistics; two requirements can limit the same statistic."""
    found = [
        (item.statistic, item.limit)
        for item in score.verdicts
        if item.figure == figure
        and item.condition == condition
        and item.statistic is not None
        and (part is None or item.part == part)
        and not item.is_of_target
    ]
    return list(dict.fromkeys(found))


# ---- notes


def headline_note(score: Score) -> str:
    """Return the explanation of the figures of the specification."""
    note = f"n: sub-trajectories, map points or calls. {NO_INTERVAL} "
    if (drive := score.association) is not None:
        note += f"{drive.matched} frames of {drive.estimate_poses} estimates, {drive.lost} lost, "
        note += f"{drive.degraded} degraded; re-based by {drive.rebase.replace('_', ' ')}. "
        if drive.rebase.is_fit:
            note += "Position errors are those of the estimate fitted to the truth. "
    return f"{note}{truth_text(score)}{clock_text(score)}".rstrip()


def covered_note(score: Score) -> str:
    """Return the reason why the estimate does not cover the whole drive."""
    return f"Incomplete: {score.incomplete}." if score.incomplete else ""


DS_IS_COMMON = (
    "The readings by displacement and by position compare vectors in DS. They require an estimate that starts at a "
    "true pose (--start truth, initialpose)."
)


def readings_note(score: Score) -> str:
    """Return the definitions of the readings, and the verdicts that depend on the reading."""
    note = "".join(f"{rebase.capitalize()}: {text}. " for rebase, text in READINGS.items())
    judged = [item for item in score.verdicts if item.by_reading]
    if not judged:
        return note
    said = [f"{name_of(item)}: {readings_text(item)}" for item in judged if len(set(item.by_reading.values())) > 1]
    if not said:
        return note + "Each reading gives the same verdicts."
    return f"{note}The verdict depends on the reading: {'; '.join(said)}. {DS_IS_COMMON}"


def readings_text(item: Verdict) -> str:
    """Return the verdict by each reading of the document."""
    return ", ".join(f"{state} by {name}" for name, state in item.by_reading.items())


def aligned_note(score: Score) -> str:
    """Return the settings of APE and RPE."""
    if (how := score.alignment) is None:
        return ""
    return (
        f"Alignment: {how.align}. {how.association}, within {how.max_difference_s:g} s. RPE over "
        f"{label_of(how.rpe_delta)}, consecutive. Not figures of the specification."
    )


def map_note(score: Score) -> str:
    """Return the explanation of coverage."""
    if (cloud := score.cloud) is None:
        return ""
    low, high = (number(bound) for bound in cloud.scored_range_m)
    kind = f"The cloud is {cloud.kind}. " if cloud.kind is not None else ""
    return f"{kind}Coverage: fraction of the true points from {low} to {high} m, or in the named range."


def evidence_note(score: Score) -> str:
    """Return the explanation of the confidence in the figures."""
    return EVIDENCE


def nees_note(score: Score) -> str:
    """Return the explanation of the consistency of the uncertainty."""
    return (
        "value: the expected mean. For consistent covariances, 95 of 100 means are in the interval. Above the interval "
        "the estimated sigma is too small, below it too large. n: sub-trajectories without a common frame, or points "
        "of distant blocks. The covariance of our localiser assumes a baseline error within 0.1 %. The sigma of a map "
        "point assumes the errors of baseline, focal length and yaw in mapping.calibration, which are unobservable in "
        f"a pair. {truth_text(score) or EXACT}"
    )


def target_note(score: Score) -> str:
    """Return the name of the target on which calls were measured."""
    if (target := score.target) is None:
        return ""
    method = "" if target.memory_method is None else f" Memory: {target.memory_method}."
    return f"Target and clock: {target.name}.{method}"


def clock_text(score: Score) -> str:
    """Return the clock of the times, with a remark if the times are of the host."""
    clocks = [] if score.calls is None else sorted(set(score.calls.clocks.values()))
    if not clocks:
        return ""
    text = f"Clock: {', '.join(clocks)}."
    if any(clock.startswith(HOST) for clock in clocks):
        target = "" if score.target is None else f", not of {score.target.name}"
        text += f" Host times are of the machine of the run{target}."
    return text


def truth_text(score: Score) -> str:
    """Return the properties of a truth with noise or without attitudes; empty for an exact truth."""
    about, said = score.truth, []
    if about is None or about.is_exact:
        return ""
    if about.sigma_m or about.sigma_deg:
        sigmas = ((about.sigma_m, "m"), (about.sigma_deg, "deg"))
        named = ", ".join(f"{number(value)} {unit}" for value, unit in sigmas if value)
        said.append(f"Noise of the truth: {named} (standard deviation along an axis), counted in NEES. ")
    if not about.attitude:
        point = ", ".join(map(number, about.lever_arm_m))
        said.append(f"The truth has no attitudes{f' and refers to a point at {point} m in RB' if point else ''}. ")
        tilt = "" if about.tilt_deg is None else f", a tilt of {number(about.tilt_deg)} deg"
        said.append(f"The estimate was aligned to the truth: yaw {number(about.yaw_deg)} deg{tilt} and a translation. ")
    return "".join(said)


# ---- facts


def association_table(score: Score) -> Table:
    """Return the counts of scored frames and poses."""
    columns = (Column("frames and poses", words=True), Column("number"))
    if score.association is None:
        return Table("frames", "What was scored", columns, ())
    facts = msgspec.structs.asdict(score.association)
    rows = tuple(
        (Cell.head(name.replace("_", " ")), Cell.number(value, f"association.{name}"))
        for name, value in facts.items()
        if isinstance(value, int | float)
    )
    return Table("frames", "What was scored", columns, rows)


def method_table(score: Score) -> Table:
    """Return the description of the method under test."""
    method, facts = score.method, dict[str, str]()
    if method is not None:
        facts = {"method": method.name, "version": method.version or UNNAMED, "kind": method.kind.value}
        if method.isolation is not None:
            facts["isolated from"] = method.isolation
    if (usage := score.processes) is not None:
        facts["processor time"] = f"{usage.cpu_s:.3g} s, {number(usage.cpu_outside_s)} s of it outside the calls"
        threads, processes = (UNKNOWN if count is None else count for count in (usage.threads, usage.processes))
        facts["largest numbers"] = f"{threads} threads, {processes} processes"
    if text := convention_text(score):
        facts["converted"] = text
    rows = tuple((Cell.head(name), Cell(text)) for name, text in facts.items())
    return Table("method", "Method under test", (Column("property", words=True), Column("value", words=True)), rows)


def convention_text(score: Score) -> str:
    """Return the conversion of the poses before scoring, in words; empty if there was none."""
    convention = score.convention
    if convention is None:
        return ""
    parts = [f"declared: {', '.join(convention.declared)}"] if convention.declared else []
    if convention.diagnosed is not None:
        fitted = ", numbers fitted to the truth" if convention.fitted else ""
        parts.append(f"by the diagnosis: {convention.diagnosed} (--apply-diagnosis{fitted})")
    return "; ".join(parts)


def external_table(score: Score) -> Table:
    """Return the answers, latency and resources of an external node."""
    columns = (Column("external node", words=True), Column("unit"), Column("value"))
    if (node := score.external) is None:
        return Table("external", "External node", columns, ())
    shown: list[tuple[str, str, float | None, Unit]] = [
        (name.replace("_", " "), f"answers.{name}", value, Unit())
        for name, value in msgspec.structs.asdict(node.answers).items()
    ]
    if (latency := node.latency_s) is not None:
        for name in STATISTICS:
            value = getattr(latency, name)
            shown.append((f"latency {statistic_title(name)}", f"latency_s.{name}", value, Unit("ms")))
    if (usage := node.process) is not None:
        shown.append(("processor time", "process.cpu_s", usage.cpu_s, Unit("s")))
        shown.append(("peak resident memory", "process.peak_rss_bytes", usage.peak_rss_bytes, Unit("MiB")))
    rows = tuple(
        (Cell.head(title), Cell(unit.symbol or ABSENT), Cell.number(value, f"external.{key}", unit, NOT_ENOUGH))
        for title, key, value, unit in shown
    )
    note = (
        f"On {node.topic}, frames {node.frames or UNNAMED}. Latency: from the last image of a pair to the receipt of "
    )
    note += "the answer, including transport and queueing, unlike a time per call."
    note += f" Processes: {node.process.method}." if node.process is not None else ""
    note += f" The node {node.ended}." if node.ended else ""
    return Table("external", f"External node: {node.task}", columns, rows, note)


# ---- the tables of figures


def about(subject: Subject) -> Callable[[Score, Figure], bool]:
    """Return a predicate that is true for rows about a subject."""
    return lambda score, row: row.subject is subject


def on_target(subject: Subject) -> Callable[[Score, Figure], bool]:
    """Return a predicate that is true for rows about a subject that were measured on the target."""
    return lambda score, row: row.subject is subject and row.place is Place.TARGET


VIEWS = (
    View("headline", "Figures", is_headline, headline_note, shown_statistics),
    View("covered", "Completeness", about(Subject.COMPLETENESS), covered_note),
    View("readings", "Each reading of the document", is_of_a_reading, readings_note, compared_statistics),
    View("aligned", "Absolute and relative pose error", lambda score, row: row.figure in ALIGNED, aligned_note),
    View("growth", "Error against the length of the sub-trajectory", is_growth),
    View("directions", "Position error by direction", is_by_direction, directions_note),
    View("map", "Map", about(Subject.MAP), map_note),
    View("evidence", "Confidence", about(Subject.EVIDENCE), evidence_note),
    View("consistency", "Consistency of the uncertainty", about(Subject.CONSISTENCY), nees_note),
    View("time", "Time per call", is_time, clock_text),
    View("deadline", "Calls against the period", is_deadline, deadline_note),
    View("stages", "Time of stages", is_stage, stages_note),
    View("memory", "Peak resident memory during a call", is_memory, memory_note),
    View("target-time", "Time per call on the target", on_target(Subject.TIMING), target_note),
    View("target-memory", "Peak memory on the target", on_target(Subject.MEMORY), target_note),
)
"""The tables of figures. Other rows are in a final table."""
