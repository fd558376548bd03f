"""Figures of the errors of sub-trajectories: against distance, by direction, in DS, heading and attitude."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sfr_loc_map.metrics.score import Column, Score, Statistic
from sfr_loc_map.report.growth_figure import growth_figure
from sfr_loc_map.report.plots import Plot, Trace, axis, band, error_scale, largest, line, marks, scaled
from sfr_loc_map.report.sub_trajectories import TRACE_BACK, Part, error_sizes, parts_of, traces_to

COLORS = ("@one", "@two", "@three", "@four", "@five")
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross")
ELLIPSE_STEPS = 72


@dataclass(frozen=True, slots=True)
class Panel:
    """One of several panels below each other.

    Attributes:
        title: What it shows.
        values: Errors of the sub-trajectories.
        statistic: Mean and sigma over all of them.
        floor: Lower end of the band of 3 sigma.
    """

    title: str
    values: Column
    statistic: Statistic
    floor: float = -math.inf


def error_figures(score: Score) -> list[Plot]:
    """Return the figures of the sub-trajectories, as far as the score has their data."""
    parts = parts_of(score)
    if not parts:
        return []
    first = parts[0]
    return [
        _position(parts),
        *growth_figure(score, [part.score for part in parts]),
        _axes(first),
        _path_directions(first),
        _vectors(first, "top"),
        _vectors(first, "side"),
        _angles(first),
    ]


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


def _marked(
    part: Part,
    name: str,
    errors: list[float | None],
    unit: str,
    *,
    color: str = COLORS[0],
    **more: Any,  # noqa: ANN401 - whatever plotly takes
) -> Trace:
    """Return a mark for each sub-trajectory of a part, over the distance travelled."""
    hover = f"{TRACE_BACK}<br>error %{{y:.4g}} {unit}<extra></extra>"
    trace_back = {"customdata": traces_to(part.rows), "hovertemplate": hover}
    return marks(name, (part.travelled_m, errors), color, **trace_back, **more)


def _mean_and_band(panel: Panel, ends: list[float], factor: float, place: dict[str, Any]) -> list[Trace]:
    """Return the line of a signed mean and the band of 3 sigma about it, nothing where they are not defined."""
    mean, sigma = panel.statistic.mean, panel.statistic.sigma
    if mean is None:
        return []
    traces = [line("mean", (ends, scaled([mean] * 2, factor)), "@truth", dash="dash", **place)]
    if sigma is not None:
        low, high = ((mean + sign * 3 * sigma) * factor for sign in (-1, 1))
        traces.insert(0, band("mean ± 3 sigma", ends, max(low, panel.floor), high, "@one-soft", **place))
    return traces


def _panels(part: Part, panels: tuple[Panel, ...], factor: float, unit: str) -> tuple[list[Trace], dict[str, Any]]:
    """Return traces and layout of panels below each other, over the distance travelled."""
    data: list[Trace] = []
    layout: dict[str, Any] = {"grid": {"rows": len(panels), "columns": 1, "pattern": "coupled", "ygap": 0.14}}
    ends = [part.travelled_m[0], part.travelled_m[-1]]
    for k, panel in enumerate(panels):
        suffix = str(k + 1) if k else ""
        place: dict[str, Any] = {"yaxis": f"y{suffix}", "xaxis": "x", "showlegend": k == 0}
        data += _mean_and_band(panel, ends, factor, {**place, "legendgroup": "m"})
        errors = scaled(panel.values, factor)
        data.append(_marked(part, "sub-trajectory", errors, unit, symbol=SYMBOLS[0], **place, legendgroup="s"))
        layout[f"yaxis{suffix}"] = axis(f"{panel.title}, {unit}", zeroline=True)
    layout["xaxis"] = axis("distance travelled at the end of the sub-trajectory, m")
    return data, layout


def _components(part: Part, name: str, title: str, panels: tuple[Panel, ...]) -> Plot:
    factor, unit = error_scale(largest(*(panel.values for panel in panels)))
    data, layout = _panels(part, panels, factor, unit)
    caption = f"Over {part.score.condition}; mean and 3 sigma of each direction."
    return Plot(name, title, caption, data, layout, height=560)


def _axes(part: Part) -> Plot:
    rows, figures = part.rows, part.score.components
    panels = (
        Panel("x (east)", rows.x_m, figures.x_m),
        Panel("y (north)", rows.y_m, figures.y_m),
        Panel("z (up)", rows.z_m, figures.z_m),
    )
    return _components(part, "axes", "Position error by the axes of DS", panels)


def _path_directions(part: Part) -> Plot:
    rows, figures = part.rows, part.score.components
    panels = (
        Panel("along", rows.along_m, figures.along_m),
        Panel("across", rows.cross_m, figures.cross_m),
        Panel("vertical", rows.vertical_m, figures.vertical_m),
    )
    return _components(part, "directions", "Position error along and across the path", panels)


def _vectors(part: Part, view: str) -> Plot:
    """Return the error vectors in DS, from above (`top`) or from the south (`side`)."""
    rows, figures = part.rows, part.score.components
    factor, unit = error_scale(largest(rows.x_m, rows.y_m, rows.z_m))
    direction, name, values, statistic = (
        ("above", "y (north)", rows.y_m, figures.y_m)
        if view == "top"
        else ("the south", "z (up)", rows.z_m, figures.z_m)
    )
    x, y = scaled(rows.x_m, factor), scaled(values, factor)
    stems = [[value for end in ends for value in (0.0, end, None)] for ends in (x, y)]
    hover = f"{TRACE_BACK}<br>%{{x:.4g}}, %{{y:.4g}} {unit}<extra></extra>"
    data = [
        line("", stems, "@one-soft", width=1, hoverinfo="skip", showlegend=False),
        marks("sub-trajectory", (x, y), "@one", customdata=traces_to(rows), hovertemplate=hover),
        *_ellipse(figures.x_m, statistic, factor),
    ]
    layout = {
        "xaxis": axis(f"x (east) of DS, {unit}", zeroline=True, constrain="domain"),
        "yaxis": axis(f"{name} of DS, {unit}", zeroline=True, scaleanchor="x", constrain="domain"),
    }
    caption = f"Over {part.score.condition}. Equal axes; the ellipse has 3 sigma of each axis as half axes."
    return Plot(f"vectors-{view}", f"Error vectors from {direction}", caption, data, layout, height=440)


def _ellipse(a: Statistic, b: Statistic, factor: float) -> list[Trace]:
    if a.mean is None or a.sigma is None or b.mean is None or b.sigma is None:
        return []
    turns = [2 * math.pi * k / ELLIPSE_STEPS for k in range(ELLIPSE_STEPS + 1)]
    x = scaled([a.mean + 3 * a.sigma * math.cos(turn) for turn in turns], factor)
    y = scaled([b.mean + 3 * b.sigma * math.sin(turn) for turn in turns], factor)
    mean = scaled([a.mean], factor), scaled([b.mean], factor)
    return [
        line("mean ± 3 sigma", (x, y), "@two", dash="dash", hoverinfo="skip"),
        marks("mean", mean, "@two", symbol="x", size=11, hoverinfo="skip"),
    ]


def _angles(part: Part) -> Plot:
    panels = (
        Panel("heading", part.rows.heading_deg, part.score.heading_deg),
        Panel("attitude", part.rows.attitude_deg, part.score.attitude_deg, floor=0.0),
    )
    data, layout = _panels(part, panels, 1.0, "deg")
    caption = f"Over {part.score.condition}. Heading has a sign; attitude is the angle of the shortest rotation."
    return Plot("angles", "Heading and attitude error", caption, data, layout, height=480, width="full")
