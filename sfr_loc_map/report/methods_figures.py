"""Figures of several methods on the same data: paths, growth of error, cost against accuracy, maps over range.

Names of methods are a user's: they are cut to plain letters before they come into a figure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import PathRows, Score
from sfr_loc_map.report.map_tables import map_error
from sfr_loc_map.report.plots import Column, Plot, Trace, axis, error_scale, largest, line, log_axis, marks, scaled

COLORS = ("@one", "@two", "@three", "@four", "@five")
DASHES = ("solid", "dash", "dot")
SYMBOLS = ("circle", "square", "diamond")
LOG_RATIO = 20.0
"""Errors that differ more than so many times are drawn on a logarithmic axis."""
Named = Sequence[tuple[str, Score]]


def methods_figures(scores: Sequence[Score], names: Sequence[str]) -> list[tuple[str, list[Plot]]]:
    """Return the figures by heading, as far as the scores have their data.

    Args:
        scores: Scores of the same data.
        names: Name of each.
    """
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


def _style(number: int) -> tuple[str, str, str]:
    """Return colour, dash and symbol of a method."""
    turn = number // len(COLORS) % len(DASHES)
    return COLORS[number % len(COLORS)], DASHES[turn], SYMBOLS[turn]


def _path_of(score: Score) -> PathRows | None:
    details = None if score.details is None else score.details.trajectory
    return None if details is None or not details.path.stamp_ns else details.path


def _paths(named: Named) -> list[Plot]:
    known = [(k, name, path) for k, (name, score) in enumerate(named) if (path := _path_of(score)) is not None]
    if not known:
        return []
    longest = max((path for _, _, path in known), key=lambda path: len(path.stamp_ns))
    above: list[Trace] = [line("truth", (longest.truth_x_m, longest.truth_y_m), "@truth", width=3)]
    errors: list[Trace] = []
    sizes = [(k, name, path, _error_sizes(path)) for k, name, path in known]
    factor, unit = error_scale(largest(*(size for *_, size in sizes)))
    for k, name, path, size in sizes:
        color, dash, _ = _style(k)
        above.append(line(name, (path.estimate_x_m, path.estimate_y_m), color, dash=dash, width=1.5))
        errors.append(line(name, (path.travelled_m, scaled(size, factor)), color, dash=dash))
    layout = {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }
    ends = [factor * last for *_, size in sizes if (last := largest(size)) > 0.0]
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


def _error_sizes(path: PathRows) -> Column:
    truth, estimate = (path.truth_x_m, path.truth_y_m, path.truth_z_m), (path.estimate_x_m, path.estimate_y_m)
    sizes: list[float | None] = []
    for row in zip(*truth, *estimate, path.estimate_z_m, strict=True):
        known = [value for value in row if value is not None]
        sizes.append(math.dist(known[:3], known[3:]) if len(known) == len(row) else None)
    return sizes


def _growth(named: Named) -> list[Plot]:
    series = [(k, name, steps) for k, (name, score) in enumerate(named) if (steps := _growth_steps(score))]
    if not series:
        return []
    distances, errors = zip(*(step for *_, steps in series for step in steps), strict=True)
    factor, unit = error_scale(largest(errors))
    data = []
    for k, name, steps in series:
        (over, values), (color, dash, _) = zip(*steps, strict=True), _style(k)
        data.append(line(name, (over, scaled(values, factor)), color, dash=dash, mode="lines+markers"))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", min(distances), max(distances)),
        "yaxis": log_axis(f"position error, mean + 3 sigma, {unit}", *_span(scaled(errors, factor)), steps=(1,)),
    }
    return [Plot("growths", "Position error against path length", "Re-based at each start.", data, layout)]


def _growth_steps(score: Score) -> list[tuple[float, float]]:
    """Return length and mean + 3 sigma of the position error of sub-trajectories, where it is known."""
    steps = () if score.trajectory is None else score.trajectory.by_distance
    known = [(item.distance_m, item.position_m.mean_plus_3sigma) for item in steps]
    return [(distance, value) for distance, value in known if value is not None]


def _span(values: Column) -> tuple[float, float]:
    """Return bounds of a logarithmic axis around values."""
    known = [value for value in values if value is not None and value > 0] or [1.0]
    return 0.8 * min(known), 1.25 * max(known)


def _cost(named: Named, kind: CallKind) -> list[Plot]:
    """Return the median time of a call against the error, one mark for each method; an open mark is a latency."""
    data, times, errors = [], [], []
    for k, (name, score) in enumerate(named):
        seconds, is_latency = _median_s(score, kind)
        error = _error_m(score, kind)
        if not seconds or not error:
            continue
        color, _, symbol = _style(k)
        symbol += "-open" if is_latency else ""
        label = f"{name} (latency)" if is_latency else name
        times.append(1e3 * seconds)
        errors.append(1e3 * error)
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


def _median_s(score: Score, kind: CallKind) -> tuple[float | None, bool]:
    calls = None if score.timing is None else score.timing.of(kind)
    if calls is not None:
        return calls.p50, False
    node = score.external
    if node is None or node.task != kind or node.latency_s is None:
        return None, False
    return node.latency_s.p50, True


def _error_m(score: Score, kind: CallKind) -> float | None:
    if kind is CallKind.LOCALISATION:
        return None if score.trajectory is None else score.trajectory.first.position_m.mean_plus_3sigma
    error = None if score.map is None else map_error(score.map)
    return None if error is None else error.value.mean_plus_3sigma


def _over_range(named: Named) -> list[Plot]:
    data, values = [], []
    for k, (name, score) in enumerate(named):
        errors = None if score.map is None else score.map.errors
        steps = () if errors is None else errors.by_range
        known = [(item.from_m, item.to_m, item.point_error_m.p50) for item in steps]
        x: list[float | None] = []
        y: list[float | None] = []
        for low, high, value in known:
            if value is not None:
                x += [low, high, None]
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
