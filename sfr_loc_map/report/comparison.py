"""Several scores of the same data on one page: paired differences, a row for each method, their figures together.

Names of methods are a user's: they are cut to plain letters before they come into a figure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from sfr_loc_map.metrics.comparison import Comparison
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import PathRows, Score
from sfr_loc_map.report.plots import (
    COLORS,
    Plot,
    Trace,
    axis,
    error_scale,
    largest,
    line,
    log_axis,
    marks,
    scaled,
)
from sfr_loc_map.report.plots import (
    Column as Values,
)
from sfr_loc_map.report.score_tables import UNTOLD, convention_text, map_error
from sfr_loc_map.report.tables import (
    ABSENT,
    DEGREE,
    METRE,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    NONE,
    Cell,
    Column,
    Row,
    Table,
    Unit,
    fitting,
    number,
)

DASHES = ("solid", "dash", "dot")
SYMBOLS = ("circle", "square", "diamond")
LOG_RATIO = 20.0
"""Errors that differ more than so many times are drawn on a logarithmic axis."""
KINDS = (CallKind.LOCALISATION, CallKind.MAPPING)
Named = Sequence[tuple[str, Score]]


def comparison_tables(result: Comparison) -> list[Table]:
    """Return the tables of a comparison: pairs of sub-trajectories, whole runs side by side."""
    names, tables = result.names, []
    if result.pairs:
        rows: list[Row] = []
        for pair in result.pairs:
            name, _, symbol = pair.figure.partition("_")
            unit = fitting(Unit(symbol), pair.first, pair.other)
            row = (
                Cell.head(f"{name}, {unit.symbol}, over {pair.condition.label}"),
                Cell(pair.name),
                _cell(pair.first, unit),
                _cell(pair.other, unit),
                _cell(pair.difference, unit, signed=True),
                Cell.interval(pair.ci95, unit=unit, signed=True),
                Cell.number(pair.count),
                _cell(pair.p_corrected),
                Cell(pair.outcome.value),
            )
            rows.append(row)
        titles = (names[0], "other", "difference", "95 % interval", "n", "p, corrected")
        words = (Column(title, words=True) for title in ("figure", "of", "the other is"))
        columns = (next(words), next(words), *map(Column, titles), next(words))
        title = f"Mean + 3 sigma, compared with {names[0]}, paired by sub-trajectory"
        note = "The other is better or worse where the interval does not hold zero. p: of such a difference by chance, "
        note += f"corrected for {len(result.pairs)} comparisons (Holm)."
        tables.append(Table("pairs", title, columns, tuple(rows), note))
    if result.side_by_side:
        title = "Whole runs, side by side (not paired: no interval)"
        columns = (Column("figure", words=True), *map(Column, names))
        whole = tuple((Cell.head(row.figure), *map(_cell, row.values)) for row in result.side_by_side)
        tables.append(Table("runs", title, columns, whole))
    return tables


def _cell(value: float | int | None, unit: Unit = NONE, *, signed: bool = False) -> Cell:
    return Cell.number(value, unit=unit, undefined=ABSENT, signed=signed)


# ---- tables of methods


def methods_tables(scores: Sequence[Score], names: Sequence[str]) -> list[Table]:
    """Return the tables of several methods side by side: a row each, maps as differences, what each was made of."""
    named = list(zip(names, scores, strict=True))
    return [_methods(named), *_map_differences(named), _provenance(named)]


def _methods(named: Named) -> Table:
    over = next((s.trajectory.first.condition.label for _, s in named if s.trajectory is not None), "")
    drives = any(score.trajectory is not None for _, score in named)
    maps = any(score.map is not None for _, score in named)
    columns = [Column("method", words=True), Column("kind", words=True)]
    if drives:
        figures = (("position", MILLIMETRE), ("attitude", DEGREE), ("heading", DEGREE))
        columns += [Column(f"{name} over {over}", unit) for name, unit in figures]
        columns += [Column("frames"), Column("lost")]
    if maps:
        columns += [Column("map point", MILLIMETRE), Column("coverage")]
    columns += [Column("time p50", MILLISECOND), Column("time p95", MILLISECOND), Column("memory", MIB)]
    columns.append(Column("findings"))
    rows: list[Row] = []
    for name, score in named:
        cells = [Cell.head(name), Cell(ABSENT if score.method is None else score.method.kind.value)]
        if drives:
            cells += _drive_cells(score)
        if maps:
            error = map_error(score.map)
            cells.append(_cell(None if error is None else error.value.mean_plus_3sigma, MILLIMETRE))
            cells.append(_cell(None if score.map is None else score.map.coverage))
        peaks = [] if score.memory is None else [score.memory.of(kind) for kind in KINDS]
        known = [number(peak.peak_bytes, unit=MIB) for peak in peaks if peak and peak.peak_bytes is not None]
        cells += [Cell(_times(score, "p50")), Cell(_times(score, "p95")), Cell(" / ".join(known) or ABSENT)]
        rows.append((*cells, Cell.number(sum(item.count for item in score.findings))))
    note = (
        "Errors: mean + 3 sigma, of position with its 95 % interval. Time per call: localisation / mapping; a latency "
        "is marked, it has transport and waiting in it, and is not a time per call. Memory: largest peak."
    )
    return Table("counts", "Methods", tuple(columns), tuple(rows), note)


def _drive_cells(score: Score) -> list[Cell]:
    part = score.trajectory
    if part is None:
        return [Cell(ABSENT)] * 5
    position = Cell(ABSENT)
    if (total := part.first.position_m.mean_plus_3sigma) is not None:
        text, bounds = number(1e3 * total), part.first.position_m.mean_plus_3sigma_ci95
        if bounds is not None:
            text += f" ({number(1e3 * bounds[0])} to {number(1e3 * bounds[1])})"
        position = Cell(text, 1e3 * total)
    angles = [_cell(value.mean_plus_3sigma) for value in (part.first.attitude_deg, part.first.heading_deg)]
    return [position, *angles, Cell.number(part.matched), Cell.number(part.lost)]


def _times(score: Score, name: str) -> str:
    kinds = [] if score.timing is None else [score.timing.of(kind) for kind in KINDS]
    known = [number(getattr(calls, name), unit=MILLISECOND) for calls in kinds if calls is not None]
    if not known and score.external is not None and score.external.latency_s is not None:
        return f"latency {number(getattr(score.external.latency_s, name), unit=MILLISECOND)}"
    return " / ".join(known) or ABSENT


def _map_differences(named: Named) -> list[Table]:
    """Return the maps by range, each less the first one; nothing for fewer than two maps with pixels."""
    maps = [(name, score.map.errors.by_range) for name, score in named if score.map and score.map.errors]
    if len(maps) < 2:
        return []
    (first_name, first), *others = maps
    mine = {(item.from_m, item.to_m): item for item in first}
    rows: list[Row] = []
    for name, by_range in others:
        for item in by_range:
            if (same := mine.get((item.from_m, item.to_m))) is not None:
                a, b = same.point_error_m, item.point_error_m
                row = (
                    Cell.head(name),
                    Cell(f"{item.from_m:g} to {item.to_m:g} {METRE.symbol}"),
                    _cell(a.p50, MILLIMETRE),
                    _cell(b.p50, MILLIMETRE),
                    _less(b.p50, a.p50, MILLIMETRE),
                    _cell(b.p95, MILLIMETRE),
                    _less(b.p95, a.p95, MILLIMETRE),
                    _cell(item.coverage),
                    _less(item.coverage, same.coverage, NONE),
                )
                rows.append(row)
    columns = (
        Column("map", words=True),
        Column("range", words=True),
        *(Column(title, MILLIMETRE) for title in (f"p50 of {first_name}", "p50", "difference", "p95", "difference")),
        Column("coverage"),
        Column("difference"),
    )
    note = f"Point error and coverage by true range; differences: less {first_name}. Not paired by pixel: no interval."
    return [Table("map-differences", "Maps as differences", columns, tuple(rows), note)]


def _less(value: float | None, first: float | None, unit: Unit) -> Cell:
    return _cell(None if value is None or first is None else value - first, unit, signed=True)


def _provenance(named: Named) -> Table:
    rows: list[Row] = []
    for name, score in named:
        method, origin = score.method, score.provenance
        inputs = {} if origin is None else origin.inputs
        own = inputs.get("estimate") or inputs.get("cloud")
        texts = (
            UNTOLD if method is None else f"{method.name} {method.version or ''}".strip(),
            ABSENT if score.convention is None else convention_text(score.convention),
            ABSENT if own is None else own.path,
            ABSENT if own is None else own.sha256[:16],
            UNTOLD if origin is None else f"sfr_loc_map {origin.version}",
            UNTOLD if origin is None or origin.time is None else origin.time,
        )
        rows.append((Cell.head(name), *map(Cell, texts)))
    titles = ("method", "name and version", "poses converted", "estimate or cloud", "sha256", "scored by", "time")
    columns = tuple(Column(title, words=True) for title in titles)
    return Table("provenance", "What each was made of", columns, tuple(rows))


# ---- figures of methods


def methods_figures(scores: Sequence[Score], names: Sequence[str]) -> list[tuple[str, list[Plot]]]:
    """Return the figures by heading, as far as the scores have their data."""
    named = [(plain(name), score) for name, score in zip(names, scores, strict=True)]
    groups = (
        ("Localisation", [*_paths(named), *_growth(named)]),
        ("Cost against accuracy", [*_cost(named, CallKind.LOCALISATION), *_cost(named, CallKind.MAPPING)]),
        ("Maps", _over_range(named)),
    )
    return [(title, plots) for title, plots in groups if plots]


def plain(name: str) -> str:
    """Return a name without signs that plotly reads as something else."""
    return re.sub(r"[^\w .:/+()-]", "_", name)[:60]


def _style(k: int) -> tuple[str, str, str]:
    """Return colour, dash and symbol of a method."""
    turn = k // len(COLORS) % len(DASHES)
    return COLORS[k % len(COLORS)], DASHES[turn], SYMBOLS[turn]


def _paths(named: Named) -> list[Plot]:
    known: list[tuple[str, str, str, PathRows, Values]] = []
    for k, (name, score) in enumerate(named):
        details = None if score.details is None else score.details.trajectory
        if details is not None and details.path.stamp_ns:
            color, dash, _ = _style(k)
            known.append((name, color, dash, details.path, _error_sizes(details.path)))
    if not known:
        return []
    longest = max((path for *_, path, _ in known), key=lambda path: len(path.stamp_ns))
    above: list[Trace] = [line("truth", (longest.truth_x_m, longest.truth_y_m), "@truth", width=3)]
    errors: list[Trace] = []
    factor, unit = error_scale(largest(*(size for *_, size in known)))
    for name, color, dash, path, size in known:
        above.append(line(name, (path.estimate_x_m, path.estimate_y_m), color, dash=dash, width=1.5))
        errors.append(line(name, (path.travelled_m, scaled(size, factor)), color, dash=dash))
    layout = {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }
    ends = [factor * last for *_, size in known if (last := largest(size)) > 0.0]
    title = f"size of estimate - truth, {unit}"
    upright = axis(title, rangemode="tozero")
    if ends and max(ends) > LOG_RATIO * min(ends):  # on a linear axis the best would lie on zero
        low, high = 0.05 * min(ends), 1.5 * max(ends)
        upright = log_axis(title, low, high, steps=(1,)) | {"range": [math.log10(low), math.log10(high)]}
    over = {"xaxis": axis("distance travelled (truth), m"), "yaxis": upright}
    return [
        Plot("paths", "Trajectories from above", "Equal axes.", above, layout, height=560, width="full"),
        Plot("errors", "Accumulated position error", "Since the first frame, without re-basing.", errors, over),
    ]


def _error_sizes(path: PathRows) -> Values:
    truth = path.truth_x_m, path.truth_y_m, path.truth_z_m
    sizes: list[float | None] = []
    for row in zip(*truth, path.estimate_x_m, path.estimate_y_m, path.estimate_z_m, strict=True):
        known = [value for value in row if value is not None]
        sizes.append(math.dist(known[:3], known[3:]) if len(known) == len(row) else None)
    return sizes


def _growth(named: Named) -> list[Plot]:
    series: list[tuple[str, dict[float, float]]] = []
    for name, score in named:
        steps = () if score.trajectory is None else score.trajectory.by_distance
        totals = ((item.distance_m, item.position_m.mean_plus_3sigma) for item in steps)
        series.append((name, {distance: value for distance, value in totals if value is not None}))
    errors = [value for _, over in series for value in over.values()]
    if not errors:
        return []
    distances = [distance for _, over in series for distance in over]
    factor, unit = error_scale(largest(errors))
    data = []
    for k, (name, over) in enumerate(series):
        if over:
            color, dash, _ = _style(k)
            xy = list(over), scaled(list(over.values()), factor)
            data.append(line(name, xy, color, dash=dash, mode="lines+markers"))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", min(distances), max(distances)),
        "yaxis": log_axis(f"position error, mean + 3 sigma, {unit}", *_span(scaled(errors, factor)), steps=(1,)),
    }
    return [Plot("growths", "Position error against path length", "Re-based at each start.", data, layout)]


def _span(values: Values) -> tuple[float, float]:
    """Return bounds of a logarithmic axis around values."""
    known = [value for value in values if value is not None and value > 0] or [1.0]
    return 0.8 * min(known), 1.25 * max(known)


def _cost(named: Named, kind: CallKind) -> list[Plot]:
    """Return the median time of a call against the error, one mark for each method; an open mark is a latency."""
    data, times, errors = [], [], []
    for k, (name, score) in enumerate(named):
        calls, node = None if score.timing is None else score.timing.of(kind), score.external
        is_latency = calls is None and node is not None and node.task == kind
        timed = node.latency_s if is_latency and node is not None else calls
        if kind is CallKind.LOCALISATION:
            error = None if score.trajectory is None else score.trajectory.first.position_m.mean_plus_3sigma
        else:
            of_map = map_error(score.map)
            error = None if of_map is None else of_map.value.mean_plus_3sigma
        if timed is None or not timed.p50 or not error:
            continue
        color, _, symbol = _style(k)
        times.append(1e3 * timed.p50)
        errors.append(1e3 * error)
        label, symbol = (f"{name} (latency)", f"{symbol}-open") if is_latency else (name, symbol)
        data.append(marks(label, ([times[-1]], [errors[-1]]), color, symbol=symbol, size=13, showlegend=True))
    if not data:
        return []
    what = "position error" if kind is CallKind.LOCALISATION else "point error"
    layout = {
        "xaxis": log_axis("median time of a call, ms", *_span(times)),
        "yaxis": log_axis(f"{what}, mean + 3 sigma, mm", *_span(errors)),
    }
    caption = "Lower left is better. Open marks: latency over topics, which has transport and waiting in it."
    title = f"Cost against accuracy: {kind}"
    return [Plot(f"cost-{kind}", title, caption, data, layout, width="full", height=440)]


def _over_range(named: Named) -> list[Plot]:
    data, values = [], []
    for k, (name, score) in enumerate(named):
        errors = None if score.map is None else score.map.errors
        x: list[float | None] = []
        y: list[float | None] = []
        for item in () if errors is None else errors.by_range:
            if (value := item.point_error_m.p50) is not None:
                x += [item.from_m, item.to_m, None]
                y += [1e3 * value, 1e3 * value, None]
                values.append(1e3 * value)
        if x:
            color, dash, _ = _style(k)
            data.append(line(name, (x, scaled(y, 1.0)), color, dash=dash, width=3))
    if not data:
        return []
    layout = {
        "xaxis": axis("range from the left camera, m"),
        "yaxis": log_axis("median point error, mm", *_span(values)),
    }
    return [Plot("map-ranges", "Point error over range", "Median of each range.", data, layout, width="full")]
