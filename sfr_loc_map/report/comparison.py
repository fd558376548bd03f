"""Several scores of the same data on one page: paired differences, a row for each method, their figures together.

Names of methods are a user's: they are cut to plain letters before they come into a figure.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

from sfr_loc_map.metrics.comparison import SIGNIFICANT, Comparison
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.limits import value_at
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.report import plots
from sfr_loc_map.report.page import overall_of
from sfr_loc_map.report.score_figures import growth, path_errors
from sfr_loc_map.report.score_tables import UNTOLD, convention_text, map_error
from sfr_loc_map.report.tables import ABSENT, MARKS, NONE, Cell, Column, Row, Table, Unit, fitting, number

NEUTRAL = ("frames",)  #: Columns whose figures are neither good nor bad.
POSITION = "trajectory.first.position_m.mean_plus_3sigma"
SYMBOLS = ("circle", "square", "diamond")
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
        note = f"The other is better or worse where p is not above {SIGNIFICANT} and the interval does not hold zero. "
        note += f"p: of such a difference by chance, corrected for {len(result.pairs)} comparisons (Holm)."
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
    """Return the tables of several methods side by side: a row each, and what each was made of."""
    named = list(zip(names, scores, strict=True))
    return [_methods(named), _provenance(named)]


def summary_of(result: Comparison) -> tuple[str, str]:
    """Return in a word and in a sentence how the others stand beside the reference, the worse first."""
    first, outcomes = result.names[0], dict[str, dict[str, list[str]]]()
    for pair in result.pairs:
        figure = f"{pair.figure.partition('_')[0]} over {pair.condition.label}"
        outcomes.setdefault(pair.name, {}).setdefault(pair.outcome.value, []).append(figure)
    counts, parts = {"worse": 0, "better": 0}, []
    for name, found in sorted(outcomes.items(), key=lambda item: "worse" not in item[1]):
        told = [f"{word} in {', '.join(found[word])}" for word in counts if word in found]
        parts.append(f"{name}: {'; '.join(told) or 'no difference is certain'}")
        counts = {word: count + (word in found) for word, count in counts.items()}
    heading = ", ".join(f"{count} of {len(outcomes)} {word}" for word, count in counts.items() if count)
    against = f"{len(result.names)} scores of the same data; the reference is {first}."
    return heading or "no difference", " ".join((f"{'. '.join(parts)}." if parts else "", against)).strip()


def _marked(column: Column, cells: list[Cell]) -> list[Cell]:
    """Mark the best and the worst figure of a column."""
    if column.words or column.title in NEUTRAL:
        return cells
    shown = [float(f"{cell.value:.4g}") if isinstance(cell.value, (int, float)) else None for cell in cells]
    known = [value for value in shown if value is not None]
    if len(set(known)) < 2:  # as it is shown: what differs in no digit is neither
        return cells
    best, worst = (max(known), min(known)) if column.title == "coverage" else (min(known), max(known))
    marks: dict[object, str] = {best: "best", worst: "worst"}
    return [replace(cell, mark=marks.get(value, "")) for cell, value in zip(cells, shown, strict=True)]


def _methods(named: Named) -> Table:
    over = next((s.trajectory.first.condition.label for _, s in named if s.trajectory is not None), "")
    kind, verdict = Column("kind", words=True), Column("verdict", words=True)
    shown: list[tuple[Column, Callable[[Score], Cell]]] = [
        (verdict, lambda s: Cell.verdict(overall_of(s).state)),
        (kind, lambda s: Cell(value_at(s, "method.kind") or ABSENT)),
    ]
    if any(score.trajectory is not None for _, score in named):
        shown += [
            (Column(f"position over {over}", Unit("mm")), _position),
            (Column(f"attitude over {over}", Unit("deg")), _value("trajectory.first.attitude_deg.mean_plus_3sigma")),
            (Column(f"heading over {over}", Unit("deg")), _value("trajectory.first.heading_deg.mean_plus_3sigma")),
            (Column("frames"), _value("trajectory.matched")),
            (Column("lost"), _value("trajectory.lost")),
        ]
    if any(score.map is not None for _, score in named):
        shown += [
            (Column("map point", Unit("mm")), lambda score: _cell(_map_error(score), Unit("mm"))),
            (Column("coverage"), _value("map.coverage")),
        ]
    shown += [
        (Column("time p50", Unit("ms")), lambda score: _times(score, "p50")),
        (Column("time p95", Unit("ms")), lambda score: _times(score, "p95")),
        (Column("memory", Unit("MiB")), lambda score: _of_kinds(score, "memory", "peak_bytes", Unit("MiB"))),
        (Column("findings"), lambda score: Cell.number(sum(item.count for item in score.findings))),
    ]
    ordered = sorted(named, key=lambda item: value_at(item[1], POSITION) or _map_error(item[1]) or float("inf"))
    columns = [_marked(column, [cell_of(score) for _, score in ordered]) for column, cell_of in shown]
    rows = tuple((Cell.head(name), *cells) for (name, _), *cells in zip(ordered, *columns, strict=True))
    note = (
        "Errors: mean + 3 sigma, of position with its 95 % interval. Time per call: localisation / mapping; a latency "
        "is marked, it has transport and waiting in it, and is not a time per call. Memory: largest peak. "
        f"{MARKS['best']} best, {MARKS['worst']} worst of its column."
    )
    return Table("counts", "Methods", (Column("method", words=True), *(column for column, _ in shown)), rows, note)


def _value(place: str, unit: Unit = NONE) -> Callable[[Score], Cell]:
    return lambda score: _cell(value_at(score, place), unit)


def _position(score: Score) -> Cell:
    total, bounds = (value_at(score, f"{POSITION}{end}") for end in ("", "_ci95"))
    if total is None:
        return Cell(ABSENT)
    interval = f" ({Cell.interval(bounds, unit=Unit('mm')).text})" if bounds is not None else ""
    return Cell(number(total, unit=Unit("mm")) + interval, total)


def _map_error(score: Score) -> float | None:
    error = map_error(score)
    return None if error is None else error.value.mean_plus_3sigma


def _times(score: Score, name: str) -> Cell:
    latency = value_at(score, f"external.latency_s.{name}")
    if latency is not None and all(value_at(score, f"timing.{kind}") is None for kind in KINDS):
        return Cell(f"latency {number(latency, unit=Unit('ms'))}")
    return _of_kinds(score, "timing", name, Unit("ms"))


def _of_kinds(score: Score, part: str, name: str, unit: Unit) -> Cell:
    values = [value for kind in KINDS if (value := value_at(score, f"{part}.{kind}.{name}")) is not None]
    text = " / ".join(number(value, unit=unit) for value in values)
    return Cell(text or ABSENT, values[0] if len(values) == 1 else None)


def _provenance(named: Named) -> Table:
    rows: list[Row] = []
    for name, score in named:
        method, origin = score.method, score.provenance
        inputs = {} if origin is None else origin.inputs
        own = inputs.get("estimate") or inputs.get("cloud")
        texts = (
            UNTOLD if method is None else f"{method.name} {method.version or ''}".strip(),
            convention_text(score) or ABSENT,
            ABSENT if own is None else own.path,
            ABSENT if own is None else own.sha256[:16],
            UNTOLD if origin is None else f"sfr_loc_map {origin.version}",
            value_at(score, "provenance.time") or UNTOLD,
        )
        rows.append((Cell.head(name), *map(Cell, texts)))
    titles = ("method", "name and version", "poses converted", "estimate or cloud", "sha256", "scored by", "time")
    columns = tuple(Column(title, words=True) for title in titles)
    return Table("provenance", "What each was made of", columns, tuple(rows))


# ---- figures of methods


def methods_figures(scores: Sequence[Score], names: Sequence[str]) -> list[tuple[str, list[plots.Plot]]]:
    """Return the figures by heading, as far as the scores have their data."""
    named = [(plain(name), score) for name, score in zip(names, scores, strict=True)]
    groups = (
        ("Localisation", [*_paths(named), *growth(named)]),
        ("Cost against accuracy", [*_cost(named, CallKind.LOCALISATION), *_cost(named, CallKind.MAPPING)]),
        ("Maps", _over_range(named)),
    )
    return [(title, figures) for title, figures in groups if figures]


def plain(name: str) -> str:
    """Return a name without signs that plotly reads as something else."""
    return re.sub(r"[^\w .:/+()-]", "_", name)[:60]


def _paths(named: Named) -> list[plots.Plot]:
    paths = [(k, name, value_at(score, "details.trajectory.path")) for k, (name, score) in enumerate(named)]
    known = [
        (plots.line_style(k), name, path, path_errors(path)[-1])
        for k, name, path in paths
        if path is not None and path.stamp_ns
    ]
    if not known:
        return []
    longest = max((path for _, _, path, _ in known), key=lambda path: len(path.stamp_ns))
    above: list[plots.Trace] = [plots.line("truth", (longest.truth_x_m, longest.truth_y_m), "@truth", width=3)]
    errors: list[plots.Trace] = []
    factor, unit = plots.error_scale(plots.largest(*(size for *_, size in known)))
    for style, name, path, size in known:
        above.append(plots.line(name, (path.estimate_x_m, path.estimate_y_m), width=1.5, **style))
        errors.append(plots.line(name, (path.travelled_m, plots.scaled(size, factor)), **style))
    upright = plots.axis(f"size of estimate - truth, {unit}", rangemode="tozero")
    over = {"xaxis": plots.axis(plots.TRAVELLED), "yaxis": upright}
    caption = "Since the first frame, without re-basing."
    return [
        plots.Plot(
            "paths", "Trajectories from above", "Equal axes.", above, plots.from_above(), height=560, width="full"
        ),
        plots.Plot("errors", "Accumulated position error", caption, errors, over),
    ]


def _cost(named: Named, kind: CallKind) -> list[plots.Plot]:
    data, times, errors = [], [], []
    for k, (name, score) in enumerate(named):
        calls, node = value_at(score, f"timing.{kind}"), score.external
        is_latency = calls is None and node is not None and node.task == kind
        timed = node.latency_s if is_latency and node is not None else calls
        error = _map_error(score)
        if kind is CallKind.LOCALISATION:
            error = value_at(score, POSITION)
        if timed is None or not timed.p50 or not error:
            continue
        color, symbol = plots.line_style(k)["color"], SYMBOLS[k // len(plots.COLORS) % len(SYMBOLS)]
        times.append(1e3 * timed.p50)
        errors.append(1e3 * error)
        label, symbol = (f"{name} (latency)", f"{symbol}-open") if is_latency else (name, symbol)
        data.append(plots.marks(label, ([times[-1]], [errors[-1]]), color, symbol=symbol, size=13, showlegend=True))
    if not data:
        return []
    what = "position error" if kind is CallKind.LOCALISATION else "point error"
    layout = {
        "xaxis": plots.log_axis("median time of a call, ms", *plots.span(times)),
        "yaxis": plots.log_axis(f"{what}, mean + 3 sigma, mm", *plots.span(errors)),
    }
    caption = "Lower left is better. Open marks: latency over topics, which has transport and waiting in it."
    title = f"Cost against accuracy: {kind}"
    return [plots.Plot(f"cost-{kind}", title, caption, data, layout, width="full", height=440)]


def _over_range(named: Named) -> list[plots.Plot]:
    data, values = [], []
    for k, (name, score) in enumerate(named):
        known = [
            (item, 1e3 * item.point_error_m.p50)
            for item in value_at(score, "map.errors.by_range") or ()
            if item.point_error_m.p50 is not None
        ]
        values += [value for _, value in known]
        if known:
            levels = [([item.from_m, item.to_m], plots.scaled([value] * 2, 1.0)) for item, value in known]
            data.append(plots.line(name, plots.segments(levels), width=3, **plots.line_style(k)))
    if not data:
        return []
    layout = {
        "xaxis": plots.axis("range from the left camera, m"),
        "yaxis": plots.log_axis("median point error, mm", *plots.span(values)),
    }
    return [plots.Plot("map-ranges", "Point error over range", "Median of each range.", data, layout, width="full")]
