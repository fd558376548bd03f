"""Figures of the drive: from above, in height, and the accumulated error."""

from __future__ import annotations

import math

from sfr_loc_map.metrics.score import PathRows, Score
from sfr_loc_map.report.plots import Column, Plot, Trace, axis, error_scale, largest, line, marks, scaled
from sfr_loc_map.report.sub_trajectories import TRACE_BACK, Part, error_sizes, parts_of, sizes, traces_to

ELLIPSES = 15
ELLIPSE_STEPS = 24
DRAWN_SHARE = 0.05
"""Share of the extent of the drive that the largest error is drawn as."""


def trajectory_figures(score: Score) -> list[Plot]:
    """Return the figures of the path, as far as the score has their data."""
    details = None if score.details is None else score.details.trajectory
    if details is None or not details.path.stamp_ns:
        return []
    path = details.path
    return [_top_view(path, parts_of(score)), _height(path), _accumulated(path)]


def _errors(path: PathRows) -> list[list[float | None]]:
    """Return estimate less truth along x, y and z."""
    truth = path.truth_x_m, path.truth_y_m, path.truth_z_m
    estimate = path.estimate_x_m, path.estimate_y_m, path.estimate_z_m
    return [
        [None if e is None or t is None else e - t for t, e in zip(*columns, strict=True)]
        for columns in zip(truth, estimate, strict=True)
    ]


def _exaggerated(truth: Column, errors: Column, factor: float) -> list[float | None]:
    values = zip(truth, errors, strict=True)
    return scaled([None if t is None or e is None else t + factor * e for t, e in values], 1.0)


def _top_view(path: PathRows, parts: list[Part]) -> Plot:
    frames = [[k * path.every, str(stamp)] for k, stamp in enumerate(path.stamp_ns)]
    hover = "frame %{customdata[0]}<br>stamp %{customdata[1]} ns<br>x %{x:.3f} m, y %{y:.3f} m"
    more = {"customdata": frames, "hovertemplate": hover}
    truth, estimate = (path.truth_x_m, path.truth_y_m), (path.estimate_x_m, path.estimate_y_m)
    factor = _exaggeration(path)
    drawn = [_exaggerated(t, e, factor) for t, e in zip(truth, _errors(path)[:2], strict=True)]
    data = [
        line("truth", truth, "@truth", width=3, **more),
        line("estimate", estimate, "@one", dash="dash", **more),
    ]
    if factor > 1:
        name = f"estimate, error drawn {factor:g} times"
        data.append(line(name, drawn, "@two", dash="dot", width=1.5, hoverinfo="skip"))
    if path.sigma_x_m:
        data.append(_covariances(path, drawn, factor))
    for name, flags, colour, symbol in (
        ("degraded", path.degraded, "@three", "triangle-up"),
        ("lost", path.lost, "@bad", "x"),
    ):
        rows = [k for k, value in enumerate(flags) if value]
        if rows:
            data.append(marks(name, [[column[k] for k in rows] for column in estimate], colour, symbol=symbol, size=8))
    if parts:
        data.append(_ends(path, parts[0]))
    data.append(line("chosen sub-trajectory", ([], []), "@chosen", width=7, opacity=0.5, hoverinfo="skip"))
    data.append(marks("start", (truth[0][:1], truth[1][:1]), "@truth", symbol="star", size=13, hoverinfo="skip"))
    layout = {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }
    caption = (
        "Equal axes. Marks: ends of the sub-trajectories, coloured by their position error. A click on the mark of "
        "a sub-trajectory, here or in a figure below, shows its segment of the path."
    )
    return Plot("top-view", "Trajectory from above", caption, data, layout, height=560, width="full")


def _covariances(path: PathRows, centres: list[list[float | None]], factor: float) -> Trace:
    """Return ellipses with 3 sigma of x and y as half axes about some estimates, as large as the errors are drawn."""
    x: list[float | None] = []
    y: list[float | None] = []
    turns = [2 * math.pi * k / ELLIPSE_STEPS for k in range(ELLIPSE_STEPS + 1)]
    known = [
        (a, b, 3 * factor * sigma_x, 3 * factor * sigma_y)
        for a, b, sigma_x, sigma_y, lost in zip(*centres, path.sigma_x_m, path.sigma_y_m, path.lost, strict=True)
        if not (lost or a is None or b is None or sigma_x is None or sigma_y is None)
    ]
    for a, b, half_x, half_y in known[:: max(1, -(-len(known) // ELLIPSES))]:
        x += [*(a + half_x * math.cos(turn) for turn in turns), None]
        y += [*(b + half_y * math.sin(turn) for turn in turns), None]
    name = "3 sigma of its covariance" + (f", drawn {factor:g} times" if factor > 1 else "")
    return line(name, (scaled(x, 1.0), scaled(y, 1.0)), "@three", width=1, hoverinfo="skip")


def _exaggeration(path: PathRows) -> float:
    """Return 1, 2 or 5 times a power of ten by which the largest error is a twentieth of the drive's extent."""
    error = largest(*_errors(path)[:2])
    truth = [[value for value in column if value is not None] for column in (path.truth_x_m, path.truth_y_m)]
    extent = max((max(column) - min(column) for column in truth if column), default=0.0)
    if error <= 0 or extent <= 0:
        return 1.0
    wanted = DRAWN_SHARE * extent / error
    if wanted < 2:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted)


def _ends(path: PathRows, part: Part) -> Trace:
    """Return marks at the ends of the sub-trajectories, coloured by their errors."""
    factor, unit = error_scale(largest(error_sizes(part.rows)))
    last = len(path.stamp_ns) - 1
    rows = [min(frame // path.every, last) for frame in part.rows.end_frame]
    places = [[column[k] for k in rows] for column in (path.truth_x_m, path.truth_y_m)]
    bar = {"title": {"text": f"error over {part.rows.condition}, {unit}", "side": "right"}, "thickness": 12}
    style = {"colorscale": "@sequential", "showscale": True, "colorbar": bar, "line": {"color": "@ink", "width": 0.5}}
    return marks(
        "ends of sub-trajectories",
        places,
        scaled(error_sizes(part.rows), factor),
        size=9,
        marker=style,
        customdata=traces_to(part.rows),
        hovertemplate=f"{TRACE_BACK}<br>position error %{{marker.color:.4g}} {unit}<extra></extra>",
    )


def _height(path: PathRows) -> Plot:
    data = [
        line("truth", (path.travelled_m, path.truth_z_m), "@truth", width=3),
        line("estimate", (path.travelled_m, path.estimate_z_m), "@one", dash="dash"),
    ]
    layout = {"xaxis": axis("distance travelled (truth), m"), "yaxis": axis("z of DS (up), m")}
    return Plot("height", "Height", "Axes not to one scale.", data, layout)


def _accumulated(path: PathRows) -> Plot:
    errors = _errors(path)
    size = sizes(*errors)
    factor, unit = error_scale(largest(size))
    styles = (("x (east)", "@one", "dash"), ("y (north)", "@two", "dot"), ("z (up)", "@three", "dashdot"))
    data = [line("size", (path.travelled_m, scaled(size, factor)), "@truth", width=2.5)]
    data += [
        line(name, (path.travelled_m, scaled(values, factor)), color, dash=dash, width=1.5)
        for values, (name, color, dash) in zip(errors, styles, strict=True)
    ]
    if path.sigma_x_m:
        sigma = _three_sigma(path, factor)
        data.append(line("3 sigma of the covariance", (path.travelled_m, sigma), "@five", width=1.5))
    layout = {
        "xaxis": axis("distance travelled (truth), m"),
        "yaxis": axis(f"estimate - truth in DS, {unit}", zeroline=True),
    }
    caption = "Error accumulated since the first frame, without re-basing; not a figure of the specification."
    return Plot("accumulated", "Accumulated position error", caption, data, layout)


def _three_sigma(path: PathRows, factor: float) -> list[float | None]:
    """Return 3 times the norm of the sigmas of the axes, None where they are not known or the frame is lost."""
    rows = zip(path.sigma_x_m, path.sigma_y_m, path.sigma_z_m, path.lost, strict=True)
    return scaled(
        [None if lost or x is None or y is None or z is None else 3 * math.hypot(x, y, z) for x, y, z, lost in rows],
        factor,
    )
