"""Figures of the trajectory: its course, its error, and each sub-trajectory as a mark that leads to its frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from sfr_loc_map.report.plots import (
    Plot,
    Trace,
    axis,
    band,
    column,
    error_scale,
    largest,
    line,
    log_axis,
    marks,
    scaled,
)
from sfr_loc_map.report.tables import condition_text, conditions_of, dig

COLORS = ("@one", "@two", "@three", "@four", "@five")
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross")
ELLIPSES = 15
UNSIGNED = ("attitude_deg",)
TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)


def trajectory_figures(score: Mapping[str, Any]) -> list[Plot]:
    """Return the figures of the trajectory, as far as the score has their data."""
    figures: list[Plot] = []
    path = dig(score, "details.trajectory.path")
    parts = _parts(score)
    if path and path.get("stamp_ns"):
        figures += [_top_view(path, parts), _height(path), _accumulated(path)]
    if parts:
        figures.append(_position(parts))
        figures += _growth(score, parts)
        figures += [*_components(parts), *_vectors(parts), _angles(parts)]
    return figures


def _parts(score: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Return figures and sub-trajectories of each condition that has any."""
    details = dig(score, "details.trajectory.sub_trajectories") or []
    scores = [part for _, part in conditions_of(score)]
    path = dig(score, "details.trajectory.path") or {}
    return [
        (part, {**rows, "way_m": _way_at(path, rows["end_frame"])})
        for part, rows in zip(scores, details, strict=False)
        if rows.get("start_frame")
    ]


def _way_at(path: Mapping[str, Any], frames: list[int]) -> list[float]:
    """Return the distance travelled at frames, in a straight line between the rows of a thinned path."""
    way = path["travelled_m"]
    rows = np.arange(len(way)) * path["every"]
    return [round(value, 4) for value in np.interp(frames, rows, way).tolist()]


def _traces_to(rows: Mapping[str, Any]) -> list[list[Any]]:
    """Return what leads back to the frames of each sub-trajectory; stamps as text, since they need all 64 bits."""
    over = condition_text(rows["condition"])
    names = ("start_frame", "end_frame", "start_stamp_ns", "end_stamp_ns")
    return [
        [over, first, last, str(start), str(end)]
        for first, last, start, end in zip(*(rows[name] for name in names), strict=True)
    ]


def _sizes(rows: Mapping[str, Any]) -> list[float]:
    return [math.hypot(*vector) for vector in zip(rows["x_m"], rows["y_m"], rows["z_m"], strict=True)]


def _top_view(path: Mapping[str, Any], parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Plot:
    frames = [[k * path["every"], str(stamp)] for k, stamp in enumerate(path["stamp_ns"])]
    hover = "frame %{customdata[0]}<br>stamp %{customdata[1]} ns<br>x %{x:.3f} m, y %{y:.3f} m"
    more = {"customdata": frames, "hovertemplate": hover}
    truth, estimate = ([path[f"{who}_{a}_m"] for a in "xy"] for who in ("truth", "estimate"))
    factor = _exaggeration(path)
    drawn = [[t + factor * (e - t) for t, e in zip(*pair, strict=True)] for pair in zip(truth, estimate, strict=True)]
    drawn = [scaled(values, 1.0) for values in drawn]
    data = [
        line("truth", truth, "@truth", width=3, **more),
        line("estimate", estimate, "@one", dash="dash", **more),
    ]
    if factor > 1:
        name = f"estimate, error drawn {factor:g} times"
        data.append(line(name, drawn, "@two", dash="dot", width=1.5, hoverinfo="skip"))
    if path.get("sigma_x_m"):
        data.append(_covariances(path, drawn, factor))
    data += _lost(path)
    if parts:
        data.append(_ends(path, parts[0][1]))
    data.append(line("chosen sub-trajectory", ([], []), "@chosen", width=7, opacity=0.5, hoverinfo="skip"))
    data.append(marks("start", (truth[0][:1], truth[1][:1]), "@truth", symbol="star", size=13, hoverinfo="skip"))
    layout = {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }
    caption = (
        "Equal axes. Marks: ends of the sub-trajectories, coloured by their position error. A click on the mark of "
    )
    caption += "a sub-trajectory, here or in a figure below, shows its stretch of the way."
    return Plot("top-view", "Trajectory from above", caption, data, layout, height=560, width="full")


def _covariances(path: Mapping[str, Any], centres: list[list[float | None]], factor: float) -> Trace:
    """Return ellipses with 3 sigma of x and y as half axes about some estimates, as large as the errors are drawn."""
    x: list[float | None] = []
    y: list[float | None] = []
    turns = [2 * math.pi * k / 24 for k in range(25)]
    usable = [k for k in range(len(centres[0])) if path["sigma_x_m"][k] is not None and not path["lost"][k]]
    for k in usable[:: max(1, -(-len(usable) // ELLIPSES))]:
        sizes = [3 * factor * path[f"sigma_{a}_m"][k] for a in "xy"]
        x += [*(centres[0][k] + sizes[0] * math.cos(turn) for turn in turns), None]
        y += [*(centres[1][k] + sizes[1] * math.sin(turn) for turn in turns), None]
    name = "3 sigma of its covariance" + (f", drawn {factor:g} times" if factor > 1 else "")
    return line(name, (scaled(x, 1.0), scaled(y, 1.0)), "@three", width=1, hoverinfo="skip")


def _exaggeration(path: Mapping[str, Any]) -> float:
    """Return 1, 2 or 5 times a power of ten by which the largest error is a twentieth of the drive's extent."""
    pairs = [(path[f"truth_{a}_m"], path[f"estimate_{a}_m"]) for a in "xy"]
    error = max(abs(e - t) for truth, estimate in pairs for t, e in zip(truth, estimate, strict=True))
    extent = max(max(truth) - min(truth) for truth, _ in pairs)
    if error <= 0 or extent <= 0:
        return 1.0
    wanted = 0.05 * extent / error
    if wanted < 2:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted)


def _lost(path: Mapping[str, Any]) -> list[Trace]:
    lost = [k for k, value in enumerate(path.get("lost") or []) if value]
    if not lost:
        return []
    places = [[path[f"estimate_{a}_m"][k] for k in lost] for a in "xy"]
    return [marks("lost", places, "@bad", symbol="x", size=8)]


def _ends(path: Mapping[str, Any], rows: Mapping[str, Any]) -> Trace:
    factor, unit = error_scale(largest(_sizes(rows)))
    last = len(path["stamp_ns"]) - 1
    at = [min(frame // path["every"], last) for frame in rows["end_frame"]]
    places = [[path[f"truth_{a}_m"][k] for k in at] for a in "xy"]
    bar = {
        "title": {"text": f"error over {condition_text(rows['condition'])}, {unit}", "side": "right"},
        "thickness": 12,
    }
    style = {"colorscale": "@sequential", "showscale": True, "colorbar": bar, "line": {"color": "@ink", "width": 0.5}}
    return marks(
        "ends of sub-trajectories",
        places,
        scaled(_sizes(rows), factor),
        size=9,
        marker=style,
        customdata=_traces_to(rows),
        hovertemplate=f"{TRACE_BACK}<br>position error %{{marker.color:.4g}} {unit}<extra></extra>",
    )


def _height(path: Mapping[str, Any]) -> Plot:
    way = path["travelled_m"]
    data = [
        line("truth", (way, path["truth_z_m"]), "@truth", width=3),
        line("estimate", (way, path["estimate_z_m"]), "@one", dash="dash"),
    ]
    layout = {"xaxis": axis("distance travelled (truth), m"), "yaxis": axis("z of DS (up), m")}
    return Plot("height", "Height", "Axes not to one scale.", data, layout)


def _accumulated(path: Mapping[str, Any]) -> Plot:
    errors = [[e - t for t, e in zip(path[f"truth_{a}_m"], path[f"estimate_{a}_m"], strict=True)] for a in "xyz"]
    size = [math.hypot(*vector) for vector in zip(*errors, strict=True)]
    factor, unit = error_scale(largest(size))
    way = path["travelled_m"]
    styles = (("x (east)", "@one", "dash"), ("y (north)", "@two", "dot"), ("z (up)", "@three", "dashdot"))
    data = [line("size", (way, scaled(size, factor)), "@truth", width=2.5)]
    data += [
        line(name, (way, scaled(values, factor)), color, dash=dash, width=1.5)
        for values, (name, color, dash) in zip(errors, styles, strict=True)
    ]
    if path.get("sigma_x_m"):
        data.append(line("3 sigma of the covariance", (way, _three_sigma(path, factor)), "@five", width=1.5))
    layout = {
        "xaxis": axis("distance travelled (truth), m"),
        "yaxis": axis(f"estimate - truth in DS, {unit}", zeroline=True),
    }
    caption = "Error accumulated since the first frame, without re-basing; not a figure of the specification."
    return Plot("accumulated", "Accumulated position error", caption, data, layout)


def _three_sigma(path: Mapping[str, Any], factor: float) -> list[float | None]:
    """Return 3 times the norm of the sigmas of the axes, None where they are not known or the frame is lost."""
    rows = zip(*(path[f"sigma_{a}_m"] for a in "xyz"), path["lost"], strict=True)
    return scaled([None if lost or None in sigmas else 3 * math.hypot(*sigmas) for *sigmas, lost in rows], factor)


def _position(parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Plot:
    factor, unit = error_scale(largest(*(_sizes(rows) for _, rows in parts)))
    data: list[Trace] = []
    for k, (part, rows) in enumerate(parts):
        way, over = column(rows, "way_m"), condition_text(part["condition"])
        figure = part["position_m"]
        group = {"legendgroup": over, "visible": True if k == 0 else "legendonly"}
        color = COLORS[k % len(COLORS)]
        data.append(_marked(f"error over {over}", way, scaled(_sizes(rows), factor), k, rows, unit, group))
        ends = [way[0], way[-1]]
        for name, key, dash in (("norm of the mean", "mean", "dash"), ("mean + 3 sigma", "mean_plus_3sigma", "solid")):
            if figure.get(key) is not None:
                level = scaled([figure[key]] * 2, factor)
                data.append(line(f"{name}, {over}", (ends, level), color, dash=dash, **group))
        bounds = figure.get("mean_plus_3sigma_ci95")
        if bounds:
            low, high = (bound * factor for bound in bounds)
            data.append(band(f"95 % interval of it, {over}", ends, low, high, f"{color}-soft", **group))
    layout = {
        "xaxis": axis("distance travelled at the end of the sub-trajectory, m"),
        "yaxis": axis(f"size of the position error, {unit}", rangemode="tozero"),
    }
    caption = "Each mark is one sub-trajectory: point at it for its frames and stamps. A click on a name of the legend "
    caption += "shows or hides a condition."
    return Plot("position", "Position error against distance travelled", caption, data, layout, width="full")


def _marked(
    name: str,
    x: list[float | None],
    y: list[float | None],
    k: int,
    rows: Mapping[str, Any],
    unit: str,
    more: Mapping[str, Any],
) -> Trace:
    hover = f"{TRACE_BACK}<br>error %{{y:.4g}} {unit}<extra></extra>"
    return marks(
        name,
        (x, y),
        COLORS[k % len(COLORS)],
        symbol=SYMBOLS[k % len(SYMBOLS)],
        customdata=_traces_to(rows),
        hovertemplate=hover,
        **more,
    )


def _mean_and_band(
    rows: Mapping[str, Any], figure: Mapping[str, Any] | None, factor: float, more: Mapping[str, Any], floor: float
) -> list[Trace]:
    """Return the line of a signed mean and the band of 3 sigma about it, nothing where they are not defined."""
    if not figure or figure.get("mean") is None:
        return []
    way = column(rows, "way_m")
    traces = [line("mean", ([way[0], way[-1]], scaled([figure["mean"]] * 2, factor)), "@truth", dash="dash", **more)]
    if figure.get("sigma") is not None:
        low, high = ((figure["mean"] + sign * 3 * figure["sigma"]) * factor for sign in (-1, 1))
        low = max(low, floor)
        traces.insert(0, band("mean ± 3 sigma", [way[0], way[-1]], low, high, "@one-soft", **more))
    return traces


def _rows_of_panels(
    rows: Mapping[str, Any], panels: tuple[tuple[str, str, Mapping[str, Any] | None], ...], factor: float, unit: str
) -> tuple[list[Trace], dict[str, Any]]:
    """Return traces and layout of panels below each other, over the distance travelled."""
    data: list[Trace] = []
    layout: dict[str, Any] = {"grid": {"rows": len(panels), "columns": 1, "pattern": "coupled", "ygap": 0.14}}
    for k, (name, title, figure) in enumerate(panels):
        floor = 0.0 if name in UNSIGNED else -math.inf
        place = {"yaxis": f"y{k + 1 if k else ''}", "xaxis": "x"}
        data += _mean_and_band(rows, figure, factor, {**place, "legendgroup": "m", "showlegend": k == 0}, floor)
        more = {**place, "legendgroup": "s", "showlegend": k == 0}
        values = scaled(column(rows, name), factor)
        data.append(_marked("sub-trajectory", column(rows, "way_m"), values, 0, rows, unit, more))
        layout[f"yaxis{k + 1 if k else ''}"] = axis(f"{title}, {unit}", zeroline=True)
    layout["xaxis"] = axis("distance travelled at the end of the sub-trajectory, m")
    return data, layout


def _components(parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> list[Plot]:
    plots = []
    part, rows = parts[0]
    figures = part.get("components") or {}
    for name, title, axes in (
        ("axes", "Position error by the axes of DS", (("x_m", "x (east)"), ("y_m", "y (north)"), ("z_m", "z (up)"))),
        (
            "way",
            "Position error along and across the way",
            (("along_m", "along"), ("cross_m", "across"), ("vertical_m", "vertical")),
        ),
    ):
        if not all(rows.get(key) for key, _ in axes):
            continue
        factor, unit = error_scale(largest(*(rows[key] for key, _ in axes)))
        panels = tuple((key, words, figures.get(key)) for key, words in axes)
        data, layout = _rows_of_panels(rows, panels, factor, unit)
        caption = f"Over {condition_text(part['condition'])}; mean and 3 sigma of each direction."
        plots.append(Plot(name, title, caption, data, layout, height=560))
    return plots


def _vectors(parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> list[Plot]:
    """Return the error vectors in DS from above and from the south."""
    part, rows = parts[0]
    factor, unit = error_scale(largest(rows["x_m"], rows["y_m"], rows["z_m"]))
    figures = part.get("components") or {}
    plots = []
    for name, title, (a, a_name), (b, b_name) in (
        ("vectors-top", "Error vectors from above", ("x_m", "x (east)"), ("y_m", "y (north)")),
        ("vectors-side", "Error vectors from the south", ("x_m", "x (east)"), ("z_m", "z (up)")),
    ):
        x, y = scaled(rows[a], factor), scaled(rows[b], factor)
        stems = [[value for end in ends for value in (0.0, end, None)] for ends in (x, y)]
        hover = f"{TRACE_BACK}<br>%{{x:.4g}}, %{{y:.4g}} {unit}<extra></extra>"
        data = [
            line("", stems, "@one-soft", width=1, hoverinfo="skip", showlegend=False),
            marks("sub-trajectory", (x, y), "@one", customdata=_traces_to(rows), hovertemplate=hover),
            *_ellipse(figures.get(a), figures.get(b), factor),
        ]
        layout = {
            "xaxis": axis(f"{a_name} of DS, {unit}", zeroline=True, constrain="domain"),
            "yaxis": axis(f"{b_name} of DS, {unit}", zeroline=True, scaleanchor="x", constrain="domain"),
        }
        caption = (
            f"Over {condition_text(part['condition'])}. Equal axes; the ellipse has 3 sigma of each axis as half axes."
        )
        plots.append(Plot(name, title, caption, data, layout, height=440))
    return plots


def _ellipse(a: Mapping[str, Any] | None, b: Mapping[str, Any] | None, factor: float) -> list[Trace]:
    if not a or not b or any(item.get(key) is None for item in (a, b) for key in ("mean", "sigma")):
        return []
    turns = [2 * math.pi * k / 72 for k in range(73)]
    x = scaled([a["mean"] + 3 * a["sigma"] * math.cos(turn) for turn in turns], factor)
    y = scaled([b["mean"] + 3 * b["sigma"] * math.sin(turn) for turn in turns], factor)
    mean = scaled([a["mean"]], factor), scaled([b["mean"]], factor)
    return [
        line("mean ± 3 sigma", (x, y), "@two", dash="dash", hoverinfo="skip"),
        marks("mean", mean, "@two", symbol="x", size=11, hoverinfo="skip"),
    ]


def _angles(parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Plot:
    part, rows = parts[0]
    panels = (
        ("heading_deg", "heading", part.get("heading_deg")),
        ("attitude_deg", "attitude", part.get("attitude_deg")),
    )
    data, layout = _rows_of_panels(rows, panels, 1.0, "deg")
    caption = (
        f"Over {condition_text(part['condition'])}. Heading has a sign; attitude is the angle of the shortest rotation."
    )
    return Plot("angles", "Heading and attitude error", caption, data, layout, height=480, width="full")


def _growth(score: Mapping[str, Any], parts: list[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> list[Plot]:
    """Return the position error against the length of the sub-trajectories, with intervals where they are known."""
    steps = [item for item in dig(score, "trajectory.by_distance") or [] if item["position_m"]["sigma"] is not None]
    if len(steps) < 2:
        return []
    over = [item["distance_m"] for item in steps]
    mean, total = ([item["position_m"][key] for item in steps] for key in ("mean", "mean_plus_3sigma"))
    bounded = [
        (part["condition"]["distance_m"], part["position_m"]["mean_plus_3sigma"], bounds)
        for part, _ in parts
        if "distance_m" in part["condition"]
        and part["position_m"]["mean_plus_3sigma"] is not None
        and (bounds := part["position_m"]["mean_plus_3sigma_ci95"])
    ]
    factor, unit = error_scale(largest(total))
    filled = {"fill": "tonexty", "fillcolor": "@one-soft"}
    data = [
        line("norm of the mean", (over, scaled(mean, factor)), "@one", dash="dash", mode="lines+markers"),
        line("mean + 3 sigma", (over, scaled(total, factor)), "@one", mode="lines+markers", **filled),
    ]
    if bounded:
        above, below = ([sign * (ci[k] - y) for _, y, ci in bounded] for sign, k in ((1, 1), (-1, 0)))
        bars = {"type": "data", "symmetric": False, "array": scaled(above, factor), "arrayminus": scaled(below, factor)}
        places = [x for x, _, _ in bounded], scaled([y for _, y, _ in bounded], factor)
        data.append(marks("95 % interval of it", places, "@two", symbol="diamond", size=9, error_y=bars))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", over[0], over[-1]),
        "yaxis": axis(f"position error, {unit}", rangemode="tozero"),
    }
    caption = "Error re-based at each start, over sub-trajectories of growing length."
    return [Plot("growth", "Position error against the length driven", caption, data, layout, width="full")]
