"""Figures of the drive and of the errors of its sub-trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sfr_loc_map.metrics.config import ConditionKind
from sfr_loc_map.metrics.score import ConditionScore, PathRows, Score, Statistic, SubTrajectoryRows
from sfr_loc_map.report.plots import (
    COLORS,
    Column,
    Plot,
    Trace,
    axis,
    band,
    error_scale,
    largest,
    line,
    log_axis,
    marks,
    scaled,
)

SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross")
TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)
"""What a mark says when pointed at; `customdata` is a row of `_traces_to`."""
DRAWN_SHARE = 0.05
"""Share of the extent of the drive that the largest error is drawn as."""
ELLIPSES = 15


class Part(NamedTuple):
    """What figures show of one condition; `travelled_m` at the end of each sub-trajectory."""

    score: ConditionScore
    rows: SubTrajectoryRows
    travelled_m: list[float]


class Panel(NamedTuple):
    """One of several panels below each other: errors with their mean and the band of 3 sigma, cut at a floor."""

    title: str
    values: Column
    statistic: Statistic
    floor: float = -math.inf


def trajectory_figures(score: Score) -> list[Plot]:
    """Return the figures of the path and of its sub-trajectories, as far as the score has their data."""
    details, parts = None if score.details is None else score.details.trajectory, parts_of(score)
    figures = []
    if details is not None and details.path.stamp_ns:
        figures += [_top_view(details.path, parts), _height(details.path), _accumulated(details.path)]
    if not parts:
        return figures
    rows, means = parts[0].rows, parts[0].score.components
    axes = (
        Panel("x (east)", rows.x_m, means.x_m),
        Panel("y (north)", rows.y_m, means.y_m),
        Panel("z (up)", rows.z_m, means.z_m),
    )
    directions = (
        Panel("along", rows.along_m, means.along_m),
        Panel("across", rows.cross_m, means.cross_m),
        Panel("vertical", rows.vertical_m, means.vertical_m),
    )
    angles = (
        Panel("heading", rows.heading_deg, parts[0].score.heading_deg),
        Panel("attitude", rows.attitude_deg, parts[0].score.attitude_deg, floor=0.0),
    )
    over = f"Over {parts[0].score.condition}"
    caption = f"{over}; mean and 3 sigma of each direction."
    by_axis, by_direction = (_panels(parts[0], panels, *_scale(panels)) for panels in (axes, directions))
    data, of_angles = _panels(parts[0], angles, 1.0, "deg")
    of_angles_text = f"{over}. Heading has a sign; attitude is the angle of the shortest rotation."
    return [
        *figures,
        _position(parts),
        *_growth(score, parts),
        Plot("axes", "Position error by the axes of DS", caption, *by_axis, height=560),
        Plot("directions", "Position error along and across the path", caption, *by_direction, height=560),
        _vectors(parts[0], "top"),
        _vectors(parts[0], "side"),
        Plot("angles", "Heading and attitude error", of_angles_text, data, of_angles, height=480, width="full"),
    ]


def parts_of(score: Score) -> list[Part]:
    """Return figures and sub-trajectories of each condition that has any."""
    details = None if score.details is None else score.details.trajectory
    if details is None or score.trajectory is None:
        return []
    known, every = np.array(details.path.travelled_m, np.float64), details.path.every
    parts = []
    for part, rows in zip(score.trajectory.conditions, details.sub_trajectories, strict=False):
        if rows.start_frame:  # in a straight line between the rows of a thinned path
            travelled = np.interp(rows.end_frame, np.arange(len(known)) * every, known)
            parts.append(Part(part, rows, [round(value, 4) for value in travelled.tolist()]))
    return parts


def error_sizes(rows: SubTrajectoryRows) -> list[float]:
    """Return the size of each position error, m."""
    return _sizes(rows.x_m, rows.y_m, rows.z_m)


def _sizes(*columns: Column) -> list[float]:
    """Return the norm of each row; what is undefined counts as zero."""
    return [math.hypot(*(value or 0.0 for value in row)) for row in zip(*columns, strict=True)]


def _traces_to(rows: SubTrajectoryRows) -> list[list[str | int]]:
    """Return what leads back to the frames of each sub-trajectory; stamps as text, since they need all 64 bits."""
    frames = zip(rows.start_frame, rows.end_frame, rows.start_stamp_ns, rows.end_stamp_ns, strict=True)
    return [[str(rows.condition), first, last, str(start), str(end)] for first, last, start, end in frames]


# ---- the drive


def _errors(path: PathRows) -> list[list[float | None]]:
    """Return estimate less truth along x, y and z."""
    truth = path.truth_x_m, path.truth_y_m, path.truth_z_m
    estimate = path.estimate_x_m, path.estimate_y_m, path.estimate_z_m
    return [
        [None if e is None or t is None else e - t for t, e in zip(*columns, strict=True)]
        for columns in zip(truth, estimate, strict=True)
    ]


def _top_view(path: PathRows, parts: list[Part]) -> Plot:
    frames = [[k * path.every, str(stamp)] for k, stamp in enumerate(path.stamp_ns)]
    hover = "frame %{customdata[0]}<br>stamp %{customdata[1]} ns<br>x %{x:.3f} m, y %{y:.3f} m"
    more = {"customdata": frames, "hovertemplate": hover}
    truth, estimate = (path.truth_x_m, path.truth_y_m), (path.estimate_x_m, path.estimate_y_m)
    factor = _exaggeration(path)
    drawn = [
        scaled([None if t is None or e is None else t + factor * e for t, e in zip(*columns, strict=True)], 1.0)
        for columns in zip(truth, _errors(path)[:2], strict=True)
    ]
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
        data.append(_ends(path, parts[0].rows))
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


def _covariances(path: PathRows, centres: Sequence[Column], factor: float) -> Trace:
    """Return ellipses with 3 sigma of x and y as half axes about some estimates, as large as the errors are drawn."""
    x: list[float | None] = []
    y: list[float | None] = []
    known = [
        (a, b, 3 * factor * sigma_x, 3 * factor * sigma_y)
        for a, b, sigma_x, sigma_y, lost in zip(*centres, path.sigma_x_m, path.sigma_y_m, path.lost, strict=True)
        if not (lost or a is None or b is None or sigma_x is None or sigma_y is None)
    ]
    for a, b, half_x, half_y in known[:: max(1, -(-len(known) // ELLIPSES))]:
        around = _ellipse((a, b), (half_x, half_y), steps=24)
        x, y = [*x, *around[0], None], [*y, *around[1], None]
    name = "3 sigma of its covariance" + (f", drawn {factor:g} times" if factor > 1 else "")
    return line(name, (scaled(x, 1.0), scaled(y, 1.0)), "@three", width=1, hoverinfo="skip")


def _ellipse(centre: tuple[float, float], half: tuple[float, float], steps: int) -> tuple[list[float], list[float]]:
    turns = [2 * math.pi * k / steps for k in range(steps + 1)]
    return [centre[0] + half[0] * math.cos(t) for t in turns], [centre[1] + half[1] * math.sin(t) for t in turns]


def _exaggeration(path: PathRows) -> float:
    """Return 1, 2 or 5 times a power of ten by which the largest error is a twentieth of the drive's extent."""
    error = largest(*_errors(path)[:2])
    truth = [[value for value in column if value is not None] for column in (path.truth_x_m, path.truth_y_m)]
    extent = max((max(column) - min(column) for column in truth if column), default=0.0)
    if error <= 0 or DRAWN_SHARE * extent / error < 2:
        return 1.0
    wanted = DRAWN_SHARE * extent / error
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted)


def _ends(path: PathRows, rows: SubTrajectoryRows) -> Trace:
    """Return marks at the ends of the sub-trajectories, coloured by their errors."""
    factor, unit = error_scale(largest(error_sizes(rows)))
    ends = [min(frame // path.every, len(path.stamp_ns) - 1) for frame in rows.end_frame]
    bar = {"title": {"text": f"error over {rows.condition}, {unit}", "side": "right"}, "thickness": 12}
    style = {"colorscale": "@sequential", "showscale": True, "colorbar": bar, "line": {"color": "@ink", "width": 0.5}}
    return marks(
        "ends of sub-trajectories",
        [[column[k] for k in ends] for column in (path.truth_x_m, path.truth_y_m)],
        scaled(error_sizes(rows), factor),
        size=9,
        marker=style,
        customdata=_traces_to(rows),
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
    size = _sizes(*errors)
    factor, unit = error_scale(largest(size))
    styles = (("x (east)", "@one", "dash"), ("y (north)", "@two", "dot"), ("z (up)", "@three", "dashdot"))
    data = [line("size", (path.travelled_m, scaled(size, factor)), "@truth", width=2.5)]
    data += [
        line(name, (path.travelled_m, scaled(values, factor)), color, dash=dash, width=1.5)
        for values, (name, color, dash) in zip(errors, styles, strict=True)
    ]
    if path.sigma_x_m:  # the norm of the sigmas, where they are known and the frame is not lost
        rows = zip(path.sigma_x_m, path.sigma_y_m, path.sigma_z_m, path.lost, strict=True)
        sigma = [
            None if lost or x is None or y is None or z is None else 3 * math.hypot(x, y, z) for x, y, z, lost in rows
        ]
        data.append(line("3 sigma of the covariance", (path.travelled_m, scaled(sigma, factor)), "@five", width=1.5))
    layout = {
        "xaxis": axis("distance travelled (truth), m"),
        "yaxis": axis(f"estimate - truth in DS, {unit}", zeroline=True),
    }
    caption = "Error accumulated since the first frame, without re-basing; not a figure of the specification."
    return Plot("accumulated", "Accumulated position error", caption, data, layout)


# ---- sub-trajectories


def _marked(part: Part, name: str, errors: Column, unit: str, *, color: str = COLORS[0], **more: Any) -> Trace:  # noqa: ANN401
    """Return a mark for each sub-trajectory of a part, over the distance travelled."""
    hover = f"{TRACE_BACK}<br>error %{{y:.4g}} {unit}<extra></extra>"
    trace_back = {"customdata": _traces_to(part.rows), "hovertemplate": hover}
    return marks(name, (part.travelled_m, errors), color, **trace_back, **more)


def _position(parts: list[Part]) -> Plot:
    factor, unit = error_scale(largest(*(error_sizes(part.rows) for part in parts)))
    data: list[Trace] = []
    for k, part in enumerate(parts):
        over, figure = str(part.score.condition), part.score.position_m
        group: dict[str, Any] = {"legendgroup": over, "visible": True if k == 0 else "legendonly"}
        color, symbol = COLORS[k % len(COLORS)], SYMBOLS[k % len(SYMBOLS)]
        errors = scaled(error_sizes(part.rows), factor)
        data.append(_marked(part, f"error over {over}", errors, unit, color=color, symbol=symbol, **group))
        ends = [part.travelled_m[0], part.travelled_m[-1]]
        for name, value, dash in (
            ("norm of the mean", figure.mean, "dash"),
            ("mean + 3 sigma", figure.mean_plus_3sigma, "solid"),
        ):
            if value is not None:
                data.append(line(f"{name}, {over}", (ends, scaled([value] * 2, factor)), color, dash=dash, **group))
        if figure.mean_plus_3sigma_ci95 is not None:
            low, high = (bound * factor for bound in figure.mean_plus_3sigma_ci95)
            data.append(band(f"95 % interval of it, {over}", ends, low, high, f"{color}-soft", **group))
    layout = {
        "xaxis": axis("distance travelled at the end of the sub-trajectory, m"),
        "yaxis": axis(f"size of the position error, {unit}", rangemode="tozero"),
    }
    caption = "Each mark is one sub-trajectory: point at it for its frames and stamps. A click on a name of the legend "
    caption += "shows or hides a condition."
    return Plot("position", "Position error against distance travelled", caption, data, layout, width="full")


def _growth(score: Score, parts: list[Part]) -> list[Plot]:
    """Return the error against length, with intervals where they are known; nothing for fewer than two lengths."""
    by_distance = score.trajectory.by_distance if score.trajectory is not None else ()
    steps = [item for item in by_distance if item.position_m.sigma is not None]
    if len(steps) < 2:
        return []
    over = [item.distance_m for item in steps]
    mean = [item.position_m.mean for item in steps]
    total = [item.position_m.mean_plus_3sigma for item in steps]
    factor, unit = error_scale(largest(total))
    filled = {"fill": "tonexty", "fillcolor": "@one-soft"}
    data = [
        line("norm of the mean", (over, scaled(mean, factor)), "@one", dash="dash", mode="lines+markers"),
        line("mean + 3 sigma", (over, scaled(total, factor)), "@one", mode="lines+markers", **filled),
    ]
    known = [
        (part.score.condition.value, figure.mean_plus_3sigma, figure.mean_plus_3sigma_ci95)
        for part in parts
        if part.score.condition.kind is ConditionKind.DISTANCE and (figure := part.score.position_m)
    ]
    bounded = [(over, value, bounds) for over, value, bounds in known if value is not None and bounds is not None]
    if bounded:
        above = scaled([bounds[1] - value for _, value, bounds in bounded], factor)
        below = scaled([value - bounds[0] for _, value, bounds in bounded], factor)
        bars = {"type": "data", "symmetric": False, "array": above, "arrayminus": below}
        places = [item[0] for item in bounded], scaled([item[1] for item in bounded], factor)
        data.append(marks("95 % interval of it", places, "@two", symbol="diamond", size=9, error_y=bars))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", over[0], over[-1]),
        "yaxis": axis(f"position error, {unit}", rangemode="tozero"),
    }
    caption = "Error re-based at each start, over sub-trajectories of growing length."
    return [Plot("growth", "Position error against path length", caption, data, layout, width="full")]


def _scale(panels: Sequence[Panel]) -> tuple[float, str]:
    return error_scale(largest(*(panel.values for panel in panels)))


def _panels(part: Part, panels: Sequence[Panel], factor: float, unit: str) -> tuple[list[Trace], dict[str, Any]]:
    """Return traces and layout of panels below each other, over the distance travelled."""
    data: list[Trace] = []
    layout: dict[str, Any] = {"grid": {"rows": len(panels), "columns": 1, "pattern": "coupled", "ygap": 0.14}}
    ends = [part.travelled_m[0], part.travelled_m[-1]]
    for k, panel in enumerate(panels):
        suffix = str(k + 1) if k else ""
        place: dict[str, Any] = {"yaxis": f"y{suffix}", "xaxis": "x", "showlegend": k == 0}
        mean, sigma = panel.statistic.mean, panel.statistic.sigma
        of_mean = {**place, "legendgroup": "m"}
        if mean is not None and sigma is not None:
            low, high = ((mean + sign * 3 * sigma) * factor for sign in (-1, 1))
            data.append(band("mean ± 3 sigma", ends, max(low, panel.floor), high, "@one-soft", **of_mean))
        if mean is not None:
            data.append(line("mean", (ends, scaled([mean] * 2, factor)), "@truth", dash="dash", **of_mean))
        errors = scaled(panel.values, factor)
        data.append(_marked(part, "sub-trajectory", errors, unit, symbol=SYMBOLS[0], **place, legendgroup="s"))
        layout[f"yaxis{suffix}"] = axis(f"{panel.title}, {unit}", zeroline=True)
    layout["xaxis"] = axis("distance travelled at the end of the sub-trajectory, m")
    return data, layout


def _vectors(part: Part, view: str) -> Plot:
    """Return the error vectors in DS, from above (`top`) or from the south (`side`)."""
    rows, figures = part.rows, part.score.components
    factor, unit = error_scale(largest(rows.x_m, rows.y_m, rows.z_m))
    direction, name, values, other = (
        ("above", "y (north)", rows.y_m, figures.y_m)
        if view == "top"
        else ("the south", "z (up)", rows.z_m, figures.z_m)
    )
    x, y = scaled(rows.x_m, factor), scaled(values, factor)
    stems = [[value for end in ends for value in (0.0, end, None)] for ends in (x, y)]
    hover = f"{TRACE_BACK}<br>%{{x:.4g}}, %{{y:.4g}} {unit}<extra></extra>"
    data = [
        line("", stems, "@one-soft", width=1, hoverinfo="skip", showlegend=False),
        marks("sub-trajectory", (x, y), "@one", customdata=_traces_to(rows), hovertemplate=hover),
    ]
    a, b = figures.x_m, other
    if a.mean is not None and a.sigma is not None and b.mean is not None and b.sigma is not None:
        around = _ellipse((a.mean, b.mean), (3 * a.sigma, 3 * b.sigma), steps=72)
        ellipse, mean = ([scaled(column, factor) for column in xy] for xy in (around, ([a.mean], [b.mean])))
        data.append(line("mean ± 3 sigma", ellipse, "@two", dash="dash", hoverinfo="skip"))
        data.append(marks("mean", mean, "@two", symbol="x", size=11, hoverinfo="skip"))
    layout = {
        "xaxis": axis(f"x (east) of DS, {unit}", zeroline=True, constrain="domain"),
        "yaxis": axis(f"{name} of DS, {unit}", zeroline=True, scaleanchor="x", constrain="domain"),
    }
    caption = f"Over {part.score.condition}. Equal axes; the ellipse has 3 sigma of each axis as half axes."
    return Plot(f"vectors-{view}", f"Error vectors from {direction}", caption, data, layout, height=440)
