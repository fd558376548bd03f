"""The tables of a score: verdicts and figures first, then all the others; each cell with its place in the JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, NamedTuple

from sfr_loc_map.metrics.config import CallKind, Condition, Rebase
from sfr_loc_map.metrics.limits import value_at
from sfr_loc_map.metrics.score import ConditionScore, SampleStatistic, Score, Statistic, TargetScore, Verdict
from sfr_loc_map.report.tables import (
    ABSENT,
    NONE,
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

SUMMARY = (
    *("headline", "aligned", "map", "time", "memory", "target-time", "target-memory", "external", "method"),
    *("readings", "covered", "map-covered", "verdicts"),
)
"""Tables of the terminal; the verdicts stand last, where they are seen."""
HOST = "host"  #: First word of the name of a clock of this machine.
UNTOLD = "not told"
EXACT = "The truth is taken as exact; --set truth.sigma_m=M and truth.sigma_deg=DEG of sfr score state its noise."
NO_INTERVAL = (
    "Only mean + 3 sigma over sub-trajectories has an interval, where two of them or more are independent; without one "
    "nothing is certain (-)."
)
FITTED = "position error, estimate fitted to the truth,"
"""How the position error is called where the truth has no attitudes."""
STATISTIC = {"mean": "mean", "sigma": "sigma", "mean_plus_3sigma": "mean + 3 sigma"}
READINGS = {
    Rebase.POSE: "the whole pose at the start is taken away, then poses are compared",
    Rebase.DISPLACEMENT: "displacements in DS and changes of attitude and heading since the start are compared: the "
    "document to the letter",
    Rebase.POSITION: "the position at the start alone is taken away, as other tools do: earlier attitude error counts",
}
DIRECTIONS = {
    **{"x_m": "x (east)", "y_m": "y (north)", "z_m": "z (up)"},
    **{"along_m": "along the path", "cross_m": "to the left of it", "vertical_m": "vertical"},
}
TERMS: Mapping[str, str] = {
    "sub-trajectory": "the part of the drive from a start to where the condition is met, so many m, s or frames later",
    "re-based": "the estimate is placed on the true pose at each start: its error at the end is what was added since",
    "position error": "estimated less true position at the end, as a vector; the mean is the length of the mean vector",
    "attitude error": "angle between the estimated and the true attitude at the end of a sub-trajectory",
    "heading error": "estimated less true heading (about the vertical) at the end, with its sign",
    "chord error": "straight distance from start to end of a sub-trajectory, estimated less true: needs no attitudes",
    "fitted": "one turn (about the vertical unless z is tilted) and one move of the whole estimate over the drive",
    "mean + 3 sigma": "size of the mean plus three standard deviations: what the specification limits",
    "95 % interval": "range that holds the true mean + 3 sigma in 95 of 100 such drives",
    "not enough data": "the figure is not defined, or made of fewer values than the limits ask for",
    "DS": "the fixed world frame of the drive: x east, y north, z up",
    "LM": "the local map frame: fixed to the ground, z up; coordinates of the map are in it",
    "along, across": "in the direction of the true path, and to its left",
    "NEES": "squared error divided by the variance estimated for it; if that is honest, about the number of components",
    "95 % of consistent ones": "range in which the mean NEES of an honest estimate lies in 95 of 100 cases",
    "point error": "distance from a map point to the true point of its pixel",
    "distance to the nearest true point": "distance from a map point to any true point; reads lower than point error",
    "coverage": "share of the true points within the scored range that have a map point",
    "disparity error": "disparity, in pixels, that the error in depth amounts to; it does not grow with range",
    "p50, p95, p99": "50, 95 or 99 of 100 values are not larger",
    "time per call": "from the call of the localiser or mapper to its return, without transport and queues",
    "first call": "shown apart, as it may pay for what later calls find done",
    "peak": "largest resident memory of the process during a call",
    "above the idle process": "the peak less what was resident after start and before the first call",
    "certain": "the 95 % interval lies on one side of the limit",
    "margin": "from the value to the limit; negative where the limit is missed",
    "missing": "images without an estimate; where images are not known, true poses in gaps between estimates",
    "judged share": "of the images those with an estimate; else of the true path what lies outside of gaps",
    "lost": "no pose could be estimated; scored with the last known one",
    "degraded": "a pose with a larger covariance, and a reason",
}
"""What the words of the tables are, each in one sentence."""


def score_tables(score: Score) -> list[Table]:
    """Return all tables of a score that have something to show, the most important first."""
    target = score.target
    tables = (
        _verdict_table(score),
        headline_table(score),
        *covered_tables(score),
        readings_table(score),
        _aligned_table(score),
        _growth_table(score),
        _component_table(score),
        _map_table(score),
        _consistency_table(score),
        _time_table(score),
        _stage_table(score),
        _memory_table(score),
        *(() if target is None else (_time_table(target), _memory_table(target))),
        _external_table(score),
        _method_table(score),
        _association_table(score),
    )
    return [table for table in tables if table is not None and table.rows]


def summary_tables(score: Score) -> list[Table]:
    """Return the tables for the terminal."""
    named = {table.name: table for table in score_tables(score)}
    return [named[name] for name in SUMMARY if name in named]


def glossary() -> Table:
    """Return the words of the tables with their meaning."""
    rows = tuple((Cell.head(word), Cell(text)) for word, text in TERMS.items())
    return Table("words", "Words", (Column("word", words=True), Column("meaning", words=True)), rows)


def score_markdown(score: Score) -> str:
    """Return all tables as Markdown."""
    return to_markdown([*score_tables(score), glossary()], "Score")


# ---- what tables share


def _figures(value: object, names: Mapping[str, str] | tuple[str, ...], key: str, unit: Unit = NONE) -> Row:
    return tuple(Cell.number(getattr(value, name), f"{key}.{name}", unit, NOT_ENOUGH) for name in names)


def _count(value: Any, key: str) -> Cell:  # noqa: ANN401 - what has a count
    return Cell.number(value.count, f"{key}.count")


def _columns(titles: Mapping[str, str] | tuple[str, ...], unit: Unit = NONE) -> Iterator[Column]:
    return (Column(title, unit) for title in (titles.values() if isinstance(titles, Mapping) else titles))


def _headed(first: str, *titles: str) -> tuple[Column, ...]:
    return (Column(first, words=True), *_columns(titles))


def keyed_conditions(score: Score) -> Iterator[tuple[str, ConditionScore]]:
    """Yield the score of each condition with the key that leads to it."""
    if score.trajectory is None:
        return
    if not score.trajectory.several:
        yield "trajectory", score.trajectory.first
    for k, part in enumerate(score.trajectory.several):
        yield f"trajectory.conditions.{k}", part


class MapError(NamedTuple):
    """The error of a map, by pixel or only to the nearest true point: value in m, place in the JSON, name."""

    value: SampleStatistic
    key: str
    title: str


def map_error(score: Score) -> MapError | None:
    """Return the error of a map, None without one."""
    part = score.map
    if part is not None and part.errors is not None:
        return MapError(part.errors.point_error_m, "map.point_error_m", "map: point error")
    if part is not None and part.nearest_distance_m is not None:
        return MapError(part.nearest_distance_m, "map.nearest_distance_m", "map: distance to the nearest true point")
    return None


# ---- verdicts and figures


def _verdict_table(score: Score) -> Table:
    rows: list[Row] = []
    has_ids = any(item.id for item in score.verdicts)
    for k, item in enumerate(score.verdicts):
        unit, key = fitting(limit_unit(item.metric), item.limit, item.value, *(item.ci95 or ())), f"verdicts.{k}"
        sign = "≥" if item.metric.endswith("_min") else "≤"
        over = f", over {item.condition}" if item.condition is not None else ""
        total = item.condition is not None and "mean_plus_3sigma" in item.metric
        row = (
            Cell.verdict(item.state.value),
            *([Cell(item.id or ABSENT)] if has_ids else []),
            Cell.head(limit_name(item.metric) + over),
            Cell(unit.symbol),
            Cell.number(item.value, f"{key}.value", unit, NOT_ENOUGH),
            Cell(f"{sign} {number(item.limit, unit=unit)}", item.limit, f"{key}.limit"),
            Cell(ABSENT) if item.margin is None else Cell.number(item.margin, f"{key}.margin", unit),
            Cell.interval(item.ci95, f"{key}.ci95", unit, NOT_ENOUGH if total else ABSENT),
            Cell.number(item.count, f"{key}.count", undefined=ABSENT),
            Cell({True: "yes", False: "no", None: ABSENT}[item.certain] + " (asked for)" * item.needs_certainty),
        )
        rows.append(row)
    columns = _headed("figure", "unit", "value", "limit", "margin", "95 % interval", "n", "certain")
    heads = (Column("verdict", words=True), *([Column("requirement", words=True)] if has_ids else []))
    note = NO_INTERVAL if any(item.certain is None for item in score.verdicts) else ""
    return Table("verdicts", "Verdicts", (*heads, *columns), tuple(rows), note)


def limit_name(metric: str) -> str:
    """Return the name of a limit in words, without its unit: `position mean + 3 sigma`."""
    if metric == "coverage_min":
        return "map coverage"
    words = re.sub(r"_(max_share|m|deg|s|bytes|min)$", "", metric).replace("mean_plus_3sigma", "mean + 3 sigma")
    words = words.replace("_", " ") + (" share" if metric.endswith("_max_share") else "")
    if metric.endswith("_s"):
        words = re.sub(r"\b(localisation|mapping call|mapping|fusion)\b", r"\1 time", words)
    return words


def name_of(item: Verdict) -> str:
    """Return the name of a limit in words, with its condition."""
    return limit_name(item.metric) + ("" if item.condition is None else f" over {item.condition.label}")


def unit_of(item: Verdict, *more: float | None) -> Unit:
    """Return the unit that suits a limit, its figure and more values beside them; shares in per cent."""
    unit = limit_unit(item.metric)
    return Unit("%") if unit == Unit("share") else fitting(unit, item.limit, item.value, *more)


def limit_unit(metric: str) -> Unit:
    """Return the unit to show a figure in, from its name in the limits, which ends in the unit of its value."""
    if metric.endswith(("_min", "_share")):
        return Unit("share")
    return Unit("MiB") if metric.endswith("_bytes") else Unit(metric.rpartition("_")[2])


def headline_table(score: Score) -> Table | None:
    """Return the figures of the specification with their 95 % intervals."""
    part = score.trajectory
    shown: list[tuple[str, Unit, Statistic | SampleStatistic, str, Cell]] = []
    note = "Statistic: the one that is limited, else mean + 3 sigma. n: sub-trajectories, map points or calls. "
    note += f"{NO_INTERVAL} "
    for key, condition in keyed_conditions(score):
        names = {"position": Unit("m"), "chord": Unit("m"), "attitude": Unit("deg"), "heading": Unit("deg")}
        of_chord = condition.rebase.is_fit or limits_on(score, "chord_m", condition.condition)
        if condition.chord_m is None or not of_chord:
            del names["chord"]
        for name, unit in names.items():
            fitted = name == "position" and condition.rebase.is_fit
            figure = f"{name}_{unit.symbol}"
            title = f"{FITTED if fitted else f'{name} error'} over {condition.condition}"
            shown.append((title, unit, getattr(condition, figure), f"{key}.{figure}", _count(condition, key)))
    if part is not None:
        note += f"{part.matched} frames of {part.estimate_poses} estimates, {part.lost} lost, "
        note += f"{part.degraded} degraded; re-based by {part.first.rebase.replace('_', ' ')}. {truth_text(score)}"
    if (error := map_error(score)) is not None:
        shown.append((error.title, Unit("m"), error.value, error.key, _count(error.value, error.key)))
    for kind, calls in () if score.timing is None else score.timing.kinds():
        key = f"timing.{kind}_s"
        shown.append((f"{kind.words} time per call", Unit("s"), calls, key, _count(calls, key)))
    rows: list[Row] = []
    for title, unit, value, key, count in shown:
        owner, _, figure = key.rpartition(".")
        over = value_at(dict(keyed_conditions(score)).get(owner), "condition")
        for judged in limits_on(score, figure, over) or ["mean_plus_3sigma"]:
            bounds = getattr(value, f"{judged}_ci95", None)
            unit = fitting(unit, value.mean, value.sigma, getattr(value, judged), *(bounds or ()))
            cells = _figures(value, ("mean", "sigma", judged), key, unit)
            few = NOT_ENOUGH if hasattr(value, f"{judged}_ci95") else ABSENT
            interval = Cell.interval(bounds, f"{key}.{judged}_ci95", unit, few)
            word = Cell(STATISTIC.get(judged, judged))
            rows.append((Cell.head(title), Cell(unit.symbol), *cells[:2], word, cells[2], interval, count))
    columns = _headed("figure", "unit", "mean", "sigma", "statistic", "value", "95 % interval", "n")
    note = (note + clock_text(score)).rstrip()
    return Table("headline", "Figures", columns, tuple(rows), note) if rows else None


def limits_on(score: Score, figure: str, condition: Condition | None) -> dict[str, float]:
    """Return the limits on a figure such as `position_m` by the statistic that they are on."""
    start, _, unit = figure.rpartition("_")
    found = {
        "max" if item.metric == figure else item.metric.removeprefix(f"{start}_").removesuffix(f"_{unit}"): item.limit
        for item in score.verdicts
        if item.metric.startswith(f"{start}_") and item.condition == condition
    }
    return {name: limit for name, limit in found.items() if name in (*STATISTIC, "p50", "p95", "p99", "max")}


# ---- what of the drive and the map is judged, by which reading


def covered_tables(score: Score) -> Iterator[Table]:
    """Yield what of the drive the estimate covers, and what of the map can be judged."""
    of_drive: tuple[str, ...] = ("images", "truth_poses", "matched", "missing", "lost", "degraded")
    of_drive += ("unmatched_estimates", "doubled_stamps", "judged_share", "longest_gap_m", "longest_gap_s")
    of_map = ("pairs", "pairs_without_cloud", "points_without_truth", "points_without_truth_share")
    for table, head, part, names in (
        ("covered", "drive", "trajectory", of_drive),
        ("map-covered", "map", "map", of_map),
    ):
        if (record := value_at(score, f"{part}.completeness")) is None:
            continue
        titles = [re.sub(r"_(?=[ms]$)", ", ", each).replace("_", " ") for each in names]
        known = ((f"{part}.completeness.{each}", getattr(record, each)) for each in names)
        cells = (Cell(UNKNOWN) if value is None else Cell.number(value, key) for key, value in known)
        why = value_at(record, "incomplete")
        rows, note = ((Cell.head(head), *cells),), f"Incomplete: {why}." if why else ""
        yield Table(table, f"What of the {head} is judged", _headed("of", *titles), rows, note)


def readings_table(score: Score) -> Table:
    """Return mean + 3 sigma by each reading of the document, and which verdicts depend on it."""
    rows: list[Row] = []
    units = {"position_m": Unit("mm"), "attitude_deg": Unit("deg"), "heading_deg": Unit("deg")}
    for key, part in keyed_conditions(score):
        for rebase in READINGS if part.readings is not None else ():
            figures = getattr(part.readings, rebase)
            cells = chain.from_iterable(
                _figures(getattr(figures, name), ("mean_plus_3sigma",), f"{key}.readings.{rebase}.{name}", unit)
                for name, unit in units.items()
            )
            used = ", as judged" if part.rebase == rebase else ""
            rows.append((Cell.head(f"{rebase}, over {part.condition}{used}"), *cells))
    columns = [Column("reading", words=True), *(Column(name.rpartition("_")[0], unit) for name, unit in units.items())]
    note = "".join(f"{rebase.capitalize()}: {text}. " for rebase, text in READINGS.items())
    if any(item.by_reading for item in score.verdicts):
        said = [
            f"{limit_name(item.metric)}, over {item.condition}: "
            + ", ".join(f"{state} by {name}" for name, state in item.by_reading.items())
            for item in score.verdicts
            if len(set(item.by_reading.values())) > 1
        ]
        note += f"The reading decides: {'; '.join(said)}." if said else "No verdict would differ by another reading."
    return Table("readings", "Mean + 3 sigma by each reading of the document", tuple(columns), tuple(rows), note)


# ---- trajectory


def _aligned_table(score: Score) -> Table | None:
    if score.aligned is None:
        return None
    names = ("rmse", "mean", "median", "std", "min", "max")
    rows: list[Row] = []
    for key, part in (("ape", score.aligned.ape), ("rpe", score.aligned.rpe)):
        for name, unit, values, place in (
            ("position", Unit("m"), part.translation, key),
            ("attitude", Unit("deg"), part.rotation_deg, f"{key}.rotation_deg"),
        ):
            head = Cell.head(f"{key.upper()}, {name}, align {part.alignment}")
            rows.append((head, Cell(unit.symbol), *_figures(values, names, place), _count(part, key)))
    note = f"{score.aligned.ape.description}. {score.aligned.rpe.description}. Not figures of the specification."
    title = "Absolute and relative error as other tools give it"
    return Table("aligned", title, _headed("error", "unit", *names, "n"), tuple(rows), note)


def _growth_table(score: Score) -> Table | None:
    steps = () if score.trajectory is None else score.trajectory.by_distance
    names, rows = ("mean", "mean_plus_3sigma"), []
    position = fitting(Unit("m"), *(item.position_m.mean_plus_3sigma for item in steps))
    units = {"position_m": position, "attitude_deg": Unit("deg"), "heading_deg": Unit("deg")}
    for k, item in enumerate(steps):
        key = f"trajectory.by_distance.{k}"
        cells = (_figures(getattr(item, name), names, f"{key}.{name}", unit) for name, unit in units.items())
        rows.append((Cell.head(f"{item.distance_m:g} m"), *chain(*cells), _count(item, key)))
    heads = [Column(f"{name.partition('_')[0]} {STATISTIC[each]}", units[name]) for name in units for each in names]
    columns = (Column("over", words=True), *heads, Column("n"))
    return Table("growth", "Error against the length of the sub-trajectory", columns, tuple(rows))


def _component_table(score: Score) -> Table:
    rows: list[Row] = []
    for key, part in keyed_conditions(score):
        for name, title in DIRECTIONS.items():
            value: Statistic = getattr(part.components, name)
            unit = fitting(Unit("m"), value.mean, value.sigma, value.mean_plus_3sigma)
            head = Cell.head(f"{title}, over {part.condition}")
            rows.append((head, Cell(unit.symbol), *_figures(value, STATISTIC, f"{key}.components.{name}", unit)))
    columns, note = _headed("position error", "unit", *STATISTIC.values()), "x, y, z of DS. Means with their signs."
    return Table("components", "Position error by direction", columns, tuple(rows), note)


def _consistency_table(score: Score) -> Table:
    shown: list[tuple[str, Any, str, Cell, str]] = []
    for key, part in keyed_conditions(score):
        if part.nees is not None:
            count = _count(part.nees, f"{key}.nees")
            for name in ("pose", "position", "attitude"):
                title = f"covariance of the odometry: {name}, over {part.condition}"
                shown.append((title, getattr(part.nees, name), f"{key}.nees.{name}", count, "too large a sigma"))
    errors = score.map.errors if score.map is not None else None
    if errors is not None and errors.sigma_nees is not None:
        below = "calibration better than stated"  # its part of sigma is common to all points
        count = _count(errors.sigma_nees, "map.sigma_nees")
        shown.append(("sigma of the map points", errors.sigma_nees, "map.sigma_nees", count, below))
    rows: list[Row] = []
    for title, nees, key, count, below in shown:
        if nees.mean is not None and nees.interval95 is not None:
            low, high = nees.interval95
            words = "too small a sigma" if nees.mean > high else below if nees.mean < low else "consistent"
            figures = Cell.number(nees.mean, f"{key}.mean"), Cell.number(nees.expected, f"{key}.expected")
            bounds = Cell.interval(nees.interval95, f"{key}.interval95")
            rows.append((Cell.head(title), *figures, bounds, count, Cell(words)))
    columns = _headed("normalised error squared", "mean", "expected", "95 % of consistent ones", "n", "in words")
    note = "Above the interval the estimated sigma is too small (errors are larger than it says), below it too large. "
    note += "n: sub-trajectories that share no frame, or points of blocks far apart. The covariance of our localiser "
    note += "assumes the baseline within 0.1 %, sigma of a map point baseline, focal length and yaw as exact as "
    note += "mapping.calibration states: no pair can show them."
    note += "" if score.trajectory is None else f" {truth_text(score) or EXACT}"
    return Table("consistency", "Consistency of the estimated uncertainty (NEES)", columns, tuple(rows), note)


def truth_text(score: Score) -> str:
    """Return what is known of a truth that has noise, or positions alone; nothing of any other."""
    about, said = value_at(score, "trajectory.truth"), []
    if about is None:
        return ""
    if about.sigma_m or about.sigma_deg:
        sigmas = ((about.sigma_m, "m"), (about.sigma_deg, "deg"))
        named = ", ".join(f"{number(value)} {unit}" for value, unit in sigmas if value)
        said.append(f"Noise of the truth: {named} (standard deviation along an axis), counted in NEES. ")
    if not about.attitude:
        said.append("The truth has positions alone")
        said += [f" of a point at {', '.join(map(number, about.lever_arm_m))} m in RB"] * bool(about.lever_arm_m)
        tilt = "" if about.tilt_deg is None else f" and its z by {number(about.tilt_deg)} deg"
        said.append(f": the estimate was turned by {number(about.yaw_deg)} deg about z{tilt} and moved to it. ")
    return "".join(said)


def _association_table(score: Score) -> Table | None:
    part = score.trajectory
    if part is None:
        return None
    names = ("matched", "lost", "degraded", "path_length_m", "duration_s")
    facts = [(name, name, getattr(part, name)) for name in names]
    facts += [("frames from one start to the next", "spacing_frames", part.first.spacing_frames)]
    facts += [(name, f"association.{name}", value) for name, value in vars(part.association.counts).items()]
    rows = ((Cell.head(name.replace("_", " ")), Cell.number(value, f"trajectory.{key}")) for name, key, value in facts)
    return Table("frames", "What was scored", _headed("of frames and poses", "number"), tuple(rows))


# ---- map


def _map_table(score: Score) -> Table | None:
    part, error = score.map, map_error(score)
    if part is None or error is None:
        return None
    errors = part.errors
    unit = fitting(Unit("m"), error.value.mean_plus_3sigma, error.value.p95)
    disparities = None if errors is None else errors.disparity_error_px
    shown = [("all points", error.value, error.key, "map", part.coverage, disparities)]
    for k, item in enumerate(() if errors is None else errors.by_range):
        title, key = f"{item.from_m:g} to {item.to_m:g} m", f"map.by_range.{k}"
        shown.append((title, item.point_error_m, key, key, item.coverage, item.disparity_error_px))
    for k, pair in enumerate(() if errors is None else errors.by_pair):
        key = f"map.by_pair.{k}"
        shown.append((f"pair {pair.pair}", pair.point_error_m, f"{key}.point_error_m", key, pair.coverage, None))
    rows: list[Row] = []
    for title, value, key, place, coverage, disparity in shown:
        pixels = Cell(ABSENT)
        if disparity is not None:
            pixels = Cell.number(disparity.p50_abs, f"{place}.disparity_error_px.p50_abs", undefined=ABSENT)
        covered = Cell.number(coverage, f"{place}.coverage", undefined="no true points")
        cells = _figures(value, (*STATISTIC, "p50", "p95"), key, unit)
        rows.append((Cell.head(title), *cells, pixels, _count(value, key), covered))
    figures = _columns((*STATISTIC.values(), "p50", "p95"), unit)
    columns = (Column("points", words=True), *figures, Column("|disparity error| p50", Unit("px")))
    low, high = (number(bound) for bound in part.coverage_range_m)
    without_truth = 0 if errors is None else errors.points_without_truth
    note = f"{part.points} points of {part.pairs} pairs, {without_truth} of them without truth (not scored). "
    note += f"Coverage: share of the true points from {low} to {high} m, or of the range named."
    return Table("map", error.title.capitalize(), (*columns, *_columns(("n", "coverage"))), tuple(rows), note)


# ---- calls, of this host and of a target


def clock_text(of: Score | TargetScore) -> str:
    """Return which clock the times were measured with, and that a host time is no time of the target."""
    clocks = sorted({calls.clock for _, calls in of.timing.kinds()}) if of.timing is not None else []
    text, target = f"Clock: {', '.join(clocks)}.", value_at(of, "target.name")
    if any(clock.startswith(HOST) for clock in clocks):
        text += f" Host times are of the machine the run was made on{f', not of {target}' if target else ''}."
    return text if clocks else ""


def _time_table(of: Score | TargetScore) -> Table:
    name, on, place = ("time", "", "") if isinstance(of, Score) else ("target-time", f" on {of.name}", "target.")
    titles = {name: name for name in ("p50", "p95", "p99", "max")}
    titles |= {"mean_plus_3sigma": "mean + 3 sigma", "first": "first call", "max_after_first": "max without it"}
    rows: list[Row] = []
    for kind, calls in () if of.timing is None else of.timing.kinds():
        key = f"{place}timing.{kind}_s"
        unit = fitting(Unit("s"), calls.max, calls.mean_plus_3sigma)
        cells = (*_figures(calls, titles, key, unit), _count(calls, key), Cell(calls.clock))
        rows.append((Cell.head(kind.words), Cell(unit.symbol), *cells))
    columns = _headed("call", "unit", *titles.values(), "n", "clock")
    return Table(name, f"Time per call{on}", columns, tuple(rows), clock_text(of))


def _stage_table(score: Score) -> Table | None:
    kinds = [] if score.timing is None else list(score.timing.kinds())
    names = ("mean", "p50", "p95", "max")
    unit = fitting(Unit("s"), *(times.max for _, calls in kinds for times in calls.stages.values()))
    rows: list[Row] = []
    for kind, calls in kinds:
        for stage, times in calls.stages.items():
            key = f"timing.{kind}_s.stages.{stage}"
            rows.append((Cell.head(f"{kind.words}: {stage}"), *_figures(times, names, key, unit), _count(times, key)))
    note = "Over the calls that had the stage. "
    note += "Keyframe: in a thread of its own; the next call waits for the rest (wait)."
    columns = (Column("stage", words=True), *_columns(names, unit), Column("n"))
    return Table("stages", "Time of stages", columns, tuple(rows), note)


def _memory_table(of: Score | TargetScore) -> Table:
    name, place, title = "memory", "", "Peak resident memory during a call"
    if isinstance(of, TargetScore):
        name, place, title = "target-memory", "target.", f"Peak memory on {of.name}"
    rows: list[Row] = []
    for kind in CallKind:
        sizes = {size: value_at(of, f"memory.{kind}.{size}") for size in ("peak_bytes", "above_idle_bytes")}
        if any(value is not None for value in sizes.values()):
            cells = (Cell.number(value, f"{place}memory.{kind}_{size}", Unit("MiB")) for size, value in sizes.items())
            rows.append((Cell.head(kind.words), *cells))
    columns = (Column("call", words=True), Column("peak", Unit("MiB")), Column("above the idle process", Unit("MiB")))
    return Table(name, title, columns, tuple(rows), f"Method: {value_at(of, 'memory.method') or UNKNOWN}.")


# ---- a method under test


def _method_table(score: Score) -> Table:
    method, facts = score.method, {}
    if method is not None:
        facts = {"method": method.name, "version": method.version or UNTOLD, "kind": method.kind.value}
        if method.isolation is not None:
            facts["shut off from"] = method.isolation
    if (usage := score.processes) is not None:
        facts["processor time"] = f"{usage.cpu_s:.3g} s, {usage.cpu_outside_s or 0.0:.3g} s of it outside the calls"
        facts["at most"] = f"{usage.threads} threads in {usage.processes} processes"
    if text := convention_text(score):
        facts["converted"] = text
    rows = tuple((Cell.head(name), Cell(text)) for name, text in facts.items())
    return Table("method", "Method under test", (Column("of", words=True), Column("is", words=True)), rows)


def convention_text(score: Score) -> str:
    """Return in words how poses were converted before they were scored, empty where they were not."""
    convention = score.convention
    if convention is None:
        return ""
    parts = [f"declared: {', '.join(convention.declared)}"] if convention.declared else []
    if convention.diagnosed is not None:
        fitted = ", numbers fitted to the truth" if convention.fitted else ""
        parts.append(f"by the diagnosis: {convention.diagnosed} (--apply-diagnosis{fitted})")
    return "; ".join(parts)


def _external_table(score: Score) -> Table | None:
    node = score.external
    if node is None:
        return None
    counts = vars(node.answers).items()
    shown = [(name.replace("_", " "), value, f"answers.{name}", Unit()) for name, value in counts]
    for title, key, unit in (
        *((f"latency {name}", f"latency_s.{name}", Unit("ms")) for name in ("p50", "p95", "max")),
        ("processor time", "process.cpu_s", Unit("s")),
        ("peak resident memory", "process.peak_rss_bytes", Unit("MiB")),
    ):
        if getattr(node, key.partition(".")[0]) is not None:
            shown.append((title, value_at(node, key), key, unit))
    rows = tuple(
        (Cell.head(title), Cell(unit.symbol or ABSENT), Cell.number(value, f"external.{key}", unit, NOT_ENOUGH))
        for title, value, key, unit in shown
    )
    note = f"On {node.topic}, frames {node.frames or UNTOLD}. Latency: from the last image of a pair to the receipt of "
    note += "its answer, with transport and waiting; it is no time per call."
    note += f" Processes: {node.process.method}." if node.process is not None else ""
    note += f" It {node.ended}." if node.ended else ""
    return Table("external", f"External node: {node.task}", _headed("external node", "unit", "value"), rows, note)
