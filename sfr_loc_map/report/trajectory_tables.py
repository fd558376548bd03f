"""The tables of the trajectory: error against length, by direction, consistency, what was scored."""

from __future__ import annotations

from sfr_loc_map.metrics.score import Interval, NeesPart, Score, SigmaNees
from sfr_loc_map.report.score_cells import (
    figure,
    keyed_conditions,
    statistic_cells,
    statistic_columns,
    statistic_values,
)
from sfr_loc_map.report.terms import terms
from sfr_loc_map.tables.numbers import DEGREE, METRE, fitting, number
from sfr_loc_map.tables.table import Cell, Column, Row, Table


def growth_table(score: Score) -> Table | None:
    """Return the errors of sub-trajectories of growing length."""
    if score.trajectory is None or not score.trajectory.by_distance:
        return None
    rows: list[Row] = []
    totals = [item.position_m.mean_plus_3sigma for item in score.trajectory.by_distance]
    units = fitting(METRE, *totals), DEGREE, DEGREE
    for k, item in enumerate(score.trajectory.by_distance):
        key = f"trajectory.by_distance.{k}"
        cells: list[Cell] = []
        errors = {"position_m": item.position_m, "attitude_deg": item.attitude_deg, "heading_deg": item.heading_deg}
        for unit, (name, value) in zip(units, errors.items(), strict=True):
            cells.append(figure(value.mean, f"{key}.{name}.mean", unit))
            cells.append(figure(value.mean_plus_3sigma, f"{key}.{name}.mean_plus_3sigma", unit))
        rows.append((Cell.head(f"{item.distance_m:g} m"), *cells, Cell.number(item.count, f"{key}.count")))
    heads = (
        Column(f"{name} {statistic}", unit)
        for name, unit in zip(("position", "attitude", "heading"), units, strict=True)
        for statistic in ("mean", "mean + 3 sigma")
    )
    columns = (Column("over", words=True), *heads, Column("n"))
    words = terms("sub-trajectory", "re-based", "mean + 3 sigma")
    return Table("growth", "Error against the length of the sub-trajectory", columns, tuple(rows), terms=words)


def component_table(score: Score) -> Table | None:
    """Return the position error by axes, and along, across and above the path."""
    rows: list[Row] = []
    for key, part in keyed_conditions(score):
        for title, name, value in (
            ("x (east)", "x_m", part.components.x_m),
            ("y (north)", "y_m", part.components.y_m),
            ("z (up)", "z_m", part.components.z_m),
            ("along the path", "along_m", part.components.along_m),
            ("across the path, to the left", "cross_m", part.components.cross_m),
            ("vertical", "vertical_m", part.components.vertical_m),
        ):
            head = Cell.head(f"{title}, over {part.condition}")
            unit = fitting(METRE, *statistic_values(value))
            rows.append((head, Cell(unit.symbol), *statistic_cells(value, f"{key}.components.{name}", unit)))
    if not rows:
        return None
    columns = (Column("position error", words=True), Column("unit"), *statistic_columns())
    words = terms("DS", "along, across", "mean + 3 sigma")
    title = "Position error by direction"
    return Table("components", title, columns, tuple(rows), "x, y, z of DS. Means with their signs.", words)


def consistency_table(score: Score) -> Table | None:
    """Return whether the estimated uncertainties are as large as the errors (NEES)."""
    rows: list[Row] = []
    for key, part in keyed_conditions(score):
        if part.nees is None:
            continue
        count = Cell.number(part.nees.count, f"{key}.nees.count")
        for name, value in (
            ("pose", part.nees.pose),
            ("position", part.nees.position),
            ("attitude", part.nees.attitude),
        ):
            title = f"covariance of the odometry: {name}, over {part.condition}"
            rows += _consistency_row(title, value, f"{key}.nees.{name}", count)
    errors = score.map.errors if score.map is not None else None
    if errors is not None and errors.sigma_nees is not None:
        count = Cell.number(errors.sigma_nees.count, "map.sigma_nees.count")
        below = "calibration better than stated"  # its part of sigma is common to all points
        rows += _consistency_row("sigma of the map points", errors.sigma_nees, "map.sigma_nees", count, below)
    if not rows:
        return None
    titles = ("mean", "expected", "95 % of consistent ones", "n", "in words")
    columns = (Column("normalised error squared", words=True), *(Column(title) for title in titles))
    note = "Above the interval the estimated sigma is too small (errors are larger than it says), below it too large. "
    note += "n: sub-trajectories that share no frame, or points of blocks far apart."
    words = terms("NEES", "95 % of consistent ones")
    return Table("consistency", "Consistency of the estimated uncertainty (NEES)", columns, tuple(rows), note, words)


def _consistency_row(
    title: str, nees: NeesPart | SigmaNees, key: str, count: Cell, below: str = "too large a sigma"
) -> list[Row]:
    if nees.mean is None or nees.interval95 is None:
        return []
    figures = Cell.number(nees.mean, f"{key}.mean"), Cell.number(nees.expected, f"{key}.expected")
    bounds = Cell.interval(nees.interval95, f"{key}.interval95")
    return [(Cell.head(title), *figures, bounds, count, Cell(_in_words(nees.mean, nees.interval95, below)))]


def _in_words(mean: float, interval: Interval, below: str) -> str:
    if mean > interval[1]:
        return "too small a sigma"
    return below if mean < interval[0] else "consistent"


def association_table(score: Score) -> Table | None:
    """Return what was scored, what was left out and why."""
    part = score.trajectory
    if part is None:
        return None
    counts, key = part.association.counts, "trajectory.association"
    tolerance, gap = (number(value) for value in (part.association.tolerance_s, part.association.max_gap_s))
    facts: tuple[tuple[str, float | int | None, str], ...] = (
        ("estimates", counts.estimate_poses, f"{key}.estimate_poses"),
        ("true poses", counts.truth_poses, f"{key}.truth_poses"),
        ("frames: estimates with a truth", part.matched, "trajectory.matched"),
        ("of them marked lost (scored with the last pose)", part.lost, "trajectory.lost"),
        ("of them degraded (a pose in doubt)", part.degraded, "trajectory.degraded"),
        ("truth of the very stamp", counts.exact, f"{key}.exact"),
        (f"truth within {tolerance} s", counts.near, f"{key}.near"),
        (f"truth interpolated, in gaps up to {gap} s", counts.interpolated, f"{key}.interpolated"),
        ("estimates with a duplicate stamp", counts.estimate_duplicates, f"{key}.estimate_duplicates"),
        ("true poses with a duplicate stamp", counts.truth_duplicates, f"{key}.truth_duplicates"),
        ("estimates out of order (sorted)", counts.estimate_unordered, f"{key}.estimate_unordered"),
        ("true poses out of order (sorted)", counts.truth_unordered, f"{key}.truth_unordered"),
        ("estimates too late to be scored", counts.late, f"{key}.late"),
        ("frames from one start to the next (spacing)", part.first.spacing_frames, "trajectory.spacing_frames"),
        ("true path length, m", part.path_length_m, "trajectory.path_length_m"),
        ("duration, s", part.duration_s, "trajectory.duration_s"),
    )
    rows = tuple((Cell.head(title), Cell.number(value, place)) for title, value, place in facts)
    words = terms("lost", "degraded")
    return Table("frames", "What was scored", (Column("frames", words=True), Column("number")), rows, terms=words)
