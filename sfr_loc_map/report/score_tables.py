"""The tables of a score, made from the JSON alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from sfr_loc_map.report.cells import (
    MIB,
    NOT_ENOUGH,
    UNKNOWN,
    Cell,
    Table,
    cell_of,
    condition_text,
    conditions_of,
    dig,
    interval_of,
    number,
    scaled_value,
)

_STATISTICS = ("mean", "sigma", "mean_plus_3sigma")
_LEFT_OUT = {
    "estimate_duplicates": "estimates with the stamp of another one",
    "truth_duplicates": "true poses with the stamp of another one",
    "estimate_unordered": "estimates out of order (put in order)",
    "truth_unordered": "true poses out of order (put in order)",
    "late": "estimates that came too late to be scored",
}


def score_tables(score: Mapping[str, Any]) -> list[Table]:
    """Return all tables of a score that have something to show, the most important first."""
    makers = (
        verdict_table,
        headline_table,
        growth_table,
        component_table,
        map_table,
        consistency_table,
        time_table,
        stage_table,
        memory_table,
        association_table,
    )
    return [table for maker in makers if (table := maker(score)) is not None]


def verdict_table(score: Mapping[str, Any]) -> Table | None:
    """Return the verdicts on the limits, None if no limits were given."""
    rows = []
    for k, item in enumerate(score.get("verdicts") or []):
        key, metric = f"verdicts.{k}", str(item.get("metric"))
        unit, scale = unit_of(metric)
        sign = "≥" if metric.endswith("_min") else "≤"
        over = condition_text(item.get("condition"))
        rows.append(
            (
                Cell(str(item.get("verdict")), kind="verdict"),
                Cell(f"{limit_name(metric)}{', over ' + over if over else ''}", kind="head"),
                Cell(unit),
                Cell(f"{sign} {number(scaled_value(item.get('limit'), scale))}", item.get("limit"), f"{key}.limit"),
                cell_of(score, f"{key}.value", NOT_ENOUGH, scale),
                interval_of(score, f"{key}.ci95", scale),
                cell_of(score, f"{key}.count", "-"),
                Cell({True: "yes", False: "no"}.get(item.get("certain"), "-")),
            )
        )
    if not rows:
        return None
    columns = ("verdict", "figure", "unit", "limit", "value", "95 % interval", "n", "certain")
    note = "Certain: the 95 % interval does not span the limit."
    return Table("verdicts", "Verdicts", columns, tuple(rows), note)


def limit_name(metric: str) -> str:
    """Return the name of a limit in words, without its unit: `position mean + 3 sigma`."""
    if metric == "coverage_min":
        return "map coverage"
    words = re.sub(r"_(m|deg|s|bytes)$", "", metric).replace("mean_plus_3sigma", "mean + 3 sigma")
    return re.sub(r"\b(localisation|mapping|fusion) (?!peak|above)", r"\1 time ", words.replace("_", " "))


def unit_of(metric: str) -> tuple[str, float]:
    """Return the unit to show a figure in and what its value is divided by, from the name with its unit."""
    if metric.endswith("_bytes"):
        return "MiB", MIB
    if metric == "coverage_min":
        return "share", 1.0
    return metric.rsplit("_", 1)[-1], 1.0


def headline_table(score: Mapping[str, Any]) -> Table | None:
    """Return the figures of the specification with their 95 % intervals."""
    rows = []
    for key, part in conditions_of(score):
        for name, unit in (("position_m", "m"), ("attitude_deg", "deg"), ("heading_deg", "deg")):
            title = f"{name.split('_')[0]} error over {condition_text(part.get('condition'))}"
            rows.append(_statistics_row(score, title, unit, f"{key}.{name}", f"{key}.count"))
    name, title = map_figure(score)
    if name:
        rows.append(_statistics_row(score, title, "m", f"map.{name}", f"map.{name}.count"))
    for kind in ("localisation", "mapping", "fusion"):
        if dig(score, f"timing.{kind}_s"):
            label = f"{kind} time per call"
            rows.append(_statistics_row(score, label, "s", f"timing.{kind}_s", f"timing.{kind}_s.count"))
    if not rows:
        return None
    columns = ("figure", "unit", "mean", "sigma", "mean + 3 sigma", "95 % interval", "n")
    note = "Interval: of mean + 3 sigma. n: sub-trajectories, map points or calls. " + clock_text(score)
    return Table("headline", "Figures", columns, tuple(rows), note)


def map_figure(score: Mapping[str, Any]) -> tuple[str, str]:
    """Return key and name of the map's error: by pixel, or only to the nearest true point; empty without a map."""
    if not score.get("map"):
        return "", ""
    if dig(score, "map.nearest_only"):
        return "nearest_distance_m", "map: distance to the nearest true point"
    return "point_error_m", "map: point error"


def clock_text(score: Mapping[str, Any]) -> str:
    """Return which clock the times were measured with, and that a host time is no other time."""
    clocks = sorted({str(item.get("clock", UNKNOWN)) for item in (score.get("timing") or {}).values()})
    if not clocks:
        return "Not measured."
    text = f"Clock: {', '.join(clocks)}."
    if any(clock.startswith("host") for clock in clocks):
        text += " Host times are of the machine the run was made on, not of the target (GR740)."
    return text


def component_table(score: Mapping[str, Any]) -> Table | None:
    """Return the position error by axes, and along, across and above the way."""
    names = {"x_m": "x (east)", "y_m": "y (north)", "z_m": "z (up)"}
    names |= {"along_m": "along the way", "cross_m": "across the way, to the left", "vertical_m": "vertical"}
    rows = []
    for key, part in conditions_of(score):
        over = condition_text(part.get("condition"))
        for name in part.get("components") or {}:
            place = f"{key}.components.{name}"
            head = Cell(f"{names.get(name, name)}, over {over}", kind="head")
            rows.append((head, Cell("m"), *(cell_of(score, f"{place}.{s}", NOT_ENOUGH) for s in _STATISTICS)))
    if not rows:
        return None
    columns = ("position error", "unit", "mean", "sigma", "mean + 3 sigma")
    return Table("components", "Position error by direction", columns, tuple(rows), "Means with their signs.")


def map_table(score: Mapping[str, Any]) -> Table | None:
    """Return the error and the coverage of the map: all, by range, by pair."""
    name, title = map_figure(score)
    if not name:
        return None
    low, high = dig(score, "map.coverage_range_m") or (None, None)
    rows = [_map_row(score, "all points", f"map.{name}", "map.coverage")]
    for k, item in enumerate(dig(score, "map.by_range") or []):
        place = f"map.by_range.{k}"
        rows.append(_map_row(score, f"{item['from_m']:g} to {item['to_m']:g} m", place, f"{place}.coverage"))
    for k, item in enumerate(dig(score, "map.by_pair") or []):
        place = f"map.by_pair.{k}"
        rows.append(_map_row(score, f"pair {item['pair']}", f"{place}.{name}", f"{place}.coverage"))
    columns = ("points", "mean, m", "sigma, m", "mean + 3 sigma, m", "p50, m", "p95, m", "|disparity error| p50, px")
    note = f"{number(dig(score, 'map.points'))} points of {number(dig(score, 'map.pairs'))} pairs"
    note += f", {number(dig(score, 'map.points_without_truth'), '0')} of them without truth (not scored)."
    note += f" Coverage: share of the true points from {number(low)} to {number(high)} m, or of the range named."
    return Table("map", title.capitalize(), (*columns, "n", "coverage"), tuple(rows), note)


def _map_row(score: Mapping[str, Any], title: str, key: str, coverage: str) -> tuple[Cell, ...]:
    figures = (cell_of(score, f"{key}.{name}", NOT_ENOUGH) for name in (*_STATISTICS, "p50", "p95"))
    place = "map" if key.startswith("map.point_error") else key
    disparity = cell_of(score, f"{place}.disparity_error_px.p50_abs", "-")
    return (
        Cell(title, kind="head"),
        *figures,
        disparity,
        cell_of(score, f"{key}.count"),
        cell_of(score, coverage, "no true points"),
    )


def consistency_table(score: Mapping[str, Any]) -> Table | None:
    """Return whether the uncertainties that were estimated are as large as the errors (NEES)."""
    rows = []
    for key, part in conditions_of(score):
        for name in ("pose", "position", "attitude"):
            words = f"covariance of the odometry: {name}, over {condition_text(part.get('condition'))}"
            rows.append(_consistency_row(score, words, f"{key}.nees.{name}", f"{key}.nees.count"))
    rows.append(_consistency_row(score, "sigma of the map points", "map.sigma_nees", "map.sigma_nees.count"))
    known = tuple(row for row in rows if row)
    if not known:
        return None
    columns = ("normalised error squared", "mean", "expected", "95 % of consistent ones", "n", "in words")
    note = "Above the interval the estimated sigma is too small (errors are larger than it says), below it too large. "
    note += "n: sub-trajectories that share no frame, or points of blocks far apart."
    return Table("consistency", "Honesty of the estimated uncertainty (NEES)", columns, known, note)


def _consistency_row(score: Mapping[str, Any], words: str, key: str, count: str) -> tuple[Cell, ...]:
    mean, interval = dig(score, f"{key}.mean"), dig(score, f"{key}.interval95")
    if mean is None or not interval:
        return ()
    judged = "too small a sigma" if mean > interval[1] else "too large a sigma" if mean < interval[0] else "consistent"
    figures = (cell_of(score, f"{key}.{name}") for name in ("mean", "expected"))
    bounds = interval_of(score, f"{key}.interval95")
    return Cell(words, kind="head"), *figures, bounds, cell_of(score, count), Cell(judged)


def growth_table(score: Mapping[str, Any]) -> Table | None:
    """Return the errors of sub-trajectories of growing length."""
    rows = []
    for k, item in enumerate(dig(score, "trajectory.by_distance") or []):
        key = f"trajectory.by_distance.{k}"
        names = [f"{name}.{s}" for name in ("position_m", "attitude_deg", "heading_deg") for s in _STATISTICS[::2]]
        figures = (cell_of(score, f"{key}.{name}", NOT_ENOUGH) for name in names)
        rows.append((Cell(f"{item['distance_m']:g} m", kind="head"), *figures, cell_of(score, f"{key}.count")))
    if not rows:
        return None
    heads = [f"{n}, {s}" for n in ("position, m", "attitude, deg", "heading, deg") for s in ("mean", "mean + 3 sigma")]
    return Table("growth", "Error against the length of the sub-trajectory", ("over", *heads, "n"), tuple(rows))


def time_table(score: Mapping[str, Any]) -> Table | None:
    """Return the times of the calls."""
    rows = []
    names = ("p50", "p95", "p99", "max", "mean_plus_3sigma", "first", "max_after_first")
    for kind in score.get("timing") or {}:
        place = f"timing.{kind}"
        figures = (cell_of(score, f"{place}.{name}", NOT_ENOUGH) for name in names)
        clock = Cell(str(dig(score, f"{place}.clock") or UNKNOWN))
        rows.append((Cell(kind.removesuffix("_s"), kind="head"), *figures, cell_of(score, f"{place}.count"), clock))
    if not rows:
        return None
    heads = ("p50, s", "p95, s", "p99, s", "max, s", "mean + 3 sigma, s", "first call, s", "max without it, s")
    return Table("time", "Time per call", ("call", *heads, "n", "clock"), tuple(rows), clock_text(score))


def stage_table(score: Mapping[str, Any]) -> Table | None:
    """Return the times of the stages of the calls, None where no call told them."""
    rows = []
    names = ("mean", "p50", "p95", "max")
    for kind in score.get("timing") or {}:
        for stage in dig(score, f"timing.{kind}.stages") or {}:
            place = f"timing.{kind}.stages.{stage}"
            figures = (cell_of(score, f"{place}.{name}", NOT_ENOUGH) for name in names)
            title = f"{kind.removesuffix('_s')}: {stage}"
            rows.append((Cell(title, kind="head"), *figures, cell_of(score, f"{place}.count")))
    if not rows:
        return None
    note = (
        "Over the calls that had the stage. Keyframe: work of a thread of its own after its call; the next call waits "
        "for what is left of it (wait)."
    )
    return Table("stages", "Time of stages", ("stage", *(f"{name}, s" for name in names), "n"), tuple(rows), note)


def memory_table(score: Mapping[str, Any]) -> Table | None:
    """Return the peak memory of the calls."""
    rows = []
    for kind in ("localisation", "mapping", "fusion"):
        places = [f"memory.{kind}_{what}_bytes" for what in ("peak", "above_idle")]
        if any(dig(score, place) is not None for place in places):
            rows.append((Cell(kind, kind="head"), *(cell_of(score, place, UNKNOWN, MIB) for place in places)))
    if not rows:
        return None
    columns = ("call", "peak, MiB", "above the idle process, MiB")
    note = f"Method: {dig(score, 'memory.method') or UNKNOWN}."
    return Table("memory", "Peak resident memory during a call", columns, tuple(rows), note)


def association_table(score: Mapping[str, Any]) -> Table | None:
    """Return what was scored, what was left out and why."""
    place = "trajectory.association"
    facts = dig(score, place)
    if not facts:
        return None
    rows = [
        _fact(score, "estimates", f"{place}.estimate_poses"),
        _fact(score, "true poses", f"{place}.truth_poses"),
        _fact(score, "frames: estimates with a truth", "trajectory.matched"),
        _fact(score, "of them marked lost (scored with the last pose)", "trajectory.lost"),
        _fact(score, "truth of the very stamp", f"{place}.exact"),
        _fact(score, f"truth within {number(facts.get('tolerance_s'))} s", f"{place}.near"),
        _fact(score, f"truth interpolated, in gaps up to {number(facts.get('max_gap_s'))} s", f"{place}.interpolated"),
    ]
    rows += [_fact(score, words, f"{place}.{name}") for name, words in _LEFT_OUT.items()]
    rows += [
        _fact(score, "true path length, m", "trajectory.path_length_m"),
        _fact(score, "duration, s", "trajectory.duration_s"),
    ]
    return Table("frames", "What was scored", ("frames", "number"), tuple(rows))


def _fact(score: Mapping[str, Any], words: str, key: str) -> tuple[Cell, ...]:
    return Cell(words, kind="head"), cell_of(score, key)


def _statistics_row(score: Mapping[str, Any], title: str, unit: str, key: str, count: str) -> tuple[Cell, ...]:
    figures = (cell_of(score, f"{key}.{name}", NOT_ENOUGH) for name in _STATISTICS)
    expected = NOT_ENOUGH if "mean_plus_3sigma_ci95" in (dig(score, key) or {}) else "-"
    interval = interval_of(score, f"{key}.mean_plus_3sigma_ci95", undefined=expected)
    return Cell(title, kind="head"), Cell(unit), *figures, interval, cell_of(score, count)
