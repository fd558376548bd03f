"""Figures of the errors of sub-trajectories: against distance, by direction, in DS, heading and attitude."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sfr_loc_map.report.cells import condition_text, dig
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
from sfr_loc_map.report.sub_trajectories import TRACE_BACK, Part, error_sizes, parts_of, traces_to

COLORS = ("@one", "@two", "@three", "@four", "@five")
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross")
UNSIGNED = ("attitude_deg",)


def error_figures(score: Mapping[str, Any]) -> list[Plot]:
    """Return the figures of the sub-trajectories, as far as the score has their data."""
    parts = parts_of(score)
    if not parts:
        return []
    return [_position(parts), *_growth(score, parts), *_components(parts), *_vectors(parts), _angles(parts)]


def _position(parts: list[Part]) -> Plot:
    factor, unit = error_scale(largest(*(error_sizes(rows) for _, rows in parts)))
    data: list[Trace] = []
    for k, (part, rows) in enumerate(parts):
        way, over = column(rows, "way_m"), condition_text(part["condition"])
        figure = part["position_m"]
        group = {"legendgroup": over, "visible": True if k == 0 else "legendonly"}
        color = COLORS[k % len(COLORS)]
        data.append(_marked(f"error over {over}", way, scaled(error_sizes(rows), factor), k, rows, unit, group))
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
        customdata=traces_to(rows),
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


def _components(parts: list[Part]) -> list[Plot]:
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


def _vectors(parts: list[Part]) -> list[Plot]:
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
            marks("sub-trajectory", (x, y), "@one", customdata=traces_to(rows), hovertemplate=hover),
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


def _angles(parts: list[Part]) -> Plot:
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


def _growth(score: Mapping[str, Any], parts: list[Part]) -> list[Plot]:
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
