"""Plots of a drive: its path, the errors of its sub-trajectories, and their growth with the length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import TOTAL, statistic_title
from sfr_loc_map.metrics.figures.details import PathRows, SubTrajectoryRows
from sfr_loc_map.metrics.figures.row_part import DIRECTIONS, distance_of
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.limit_lines import error_axis, limit_lines
from sfr_loc_map.report.plots import (
    COLORS,
    STATES,
    SYMBOLS,
    TRAVELLED,
    Plot,
    Trace,
    Values,
    axis,
    band,
    colour_bar,
    error_scale,
    from_above,
    largest,
    line,
    line_style,
    log_axis,
    marks,
    scaled,
    span,
)
from sfr_loc_map.report.plotted_data import (
    PlottedCondition,
    PlottedLimit,
    drawn_statistics,
    error_sizes,
    limits_on,
    path_errors,
    path_of,
    plotted_conditions,
)

AT_THE_END = "distance travelled at the end, m"
MEAN_OF_VECTORS = "norm of the mean"  #: Title of the mean of error vectors.
DASHES = {"mean": "dash", TOTAL: "solid"}  #: Dashes of the statistics of errors; others are dotted.
TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)
"""Hover text of a mark; `customdata` is a row of `_traces_to`."""
HIDDEN_ABOVE = 10.0
"""Multiple of the largest value above which a limit is only in the legend, on linear axes with negative values."""


def drive_plots(score: Score) -> list[Plot]:
    """Return the plots of the path and of the sub-trajectories for which the score has data."""
    path, conditions = path_of(score), plotted_conditions(score)
    plots = [_top_view(path, conditions), *_along(path)] if path and path.stamp_ns else []
    if not conditions:
        return plots
    return [
        *plots,
        _position(score, conditions),
        *(replace(plot, width="full") for plot in growth([("mean + 3 sigma", score)])),
        _directions(score, conditions[0]),
        *_angles(score, conditions[0]),
    ]


def _traces_to(rows: SubTrajectoryRows) -> list[list[str | int]]:
    """Return condition, frames and stamps of each sub-trajectory, the `customdata` of its marks.

    On a click on a mark, `page.js` uses these five values to show the sub-trajectory in the view from above. The script
    moves the trace `chosen sub-trajectory` of the plot `top-view` along the trace `truth`, which contains every n-th
    frame (`Page.every`).
    """
    frames = zip(rows.start_frame, rows.end_frame, rows.start_stamp_ns, rows.end_stamp_ns, strict=True)
    return [[label_of(rows.condition), first, last, str(start), str(end)] for first, last, start, end in frames]


# ---- the path


def _top_view(path: PathRows, conditions: list[PlottedCondition]) -> Plot:
    numbered = [[k * path.every, str(stamp)] for k, stamp in enumerate(path.stamp_ns)]
    hover = "frame %{customdata[0]}<br>stamp %{customdata[1]} ns<br>x %{x:.3f} m, y %{y:.3f} m"
    more = {"customdata": numbered, "hovertemplate": hover}
    truth, estimate = (path.truth_x_m, path.truth_y_m), (path.estimate_x_m, path.estimate_y_m)
    data = [line("truth", truth, "@truth", width=3, **more), line("estimate", estimate, "@one", dash="dash", **more)]
    for name, flags in (("degraded", path.degraded), ("lost", path.lost)):
        frames, (colour, symbol) = [k for k, value in enumerate(flags) if value], STATES[name]
        if frames:
            places = [[column[k] for k in frames] for column in estimate]
            data.append(marks(name, places, colour, symbol=symbol, size=8))
    if conditions:
        rows = conditions[0].rows
        factor, unit = error_scale(largest(error_sizes(rows)))
        ends = [min(frame // path.every, len(path.stamp_ns) - 1) for frame in rows.end_frame]
        places, sizes = [[column[k] for k in ends] for column in truth], scaled(error_sizes(rows), factor)
        bar = colour_bar(f"error over {label_of(rows.condition)}, {unit}")
        style = {
            "colorscale": "@sequential",
            "showscale": True,
            "colorbar": bar,
            "line": {"color": "@ink", "width": 0.5},
        }
        said = f"{TRACE_BACK}<br>position error %{{marker.color:.4g}} {unit}<extra></extra>"
        back = {"customdata": _traces_to(rows), "hovertemplate": said}
        data.append(marks("ends of sub-trajectories", places, sizes, size=9, marker=style, **back))
    data.append(line("chosen sub-trajectory", ([], []), "@chosen", width=7, opacity=0.5, hoverinfo="skip"))
    data.append(marks("start", (truth[0][:1], truth[1][:1]), "@truth", symbol="star", size=13, hoverinfo="skip"))
    caption = (
        "Equal axes. Marks: ends of the sub-trajectories, coloured by their position error. A click on the mark of "
        "a sub-trajectory, here or in a plot below, shows its segment of the path."
    )
    return Plot("top-view", "Trajectory from above", caption, data, from_above(), height=560, width="full")


def _along(path: PathRows) -> list[Plot]:
    heights = [
        line("truth", (path.travelled_m, path.truth_z_m), "@truth", width=3),
        line("estimate", (path.travelled_m, path.estimate_z_m), "@one", dash="dash"),
    ]
    upright = {"xaxis": axis(TRAVELLED), "yaxis": axis("z of DS (up), m")}
    *errors, size = path_errors(path)
    factor, unit = error_scale(largest(size))
    styles = (("x (east)", "@one", "dash"), ("y (north)", "@two", "dot"), ("z (up)", "@three", "dashdot"))
    data = [line("size", (path.travelled_m, scaled(size, factor)), "@truth", width=2.5)]
    data += [
        line(name, (path.travelled_m, scaled(values, factor)), color, dash=dash, width=1.5)
        for values, (name, color, dash) in zip(errors, styles, strict=True)
    ]
    if path.sigma_x_m:  # the norm of the sigmas if they are known and the frame is not lost
        rows = zip(path.sigma_x_m, path.sigma_y_m, path.sigma_z_m, path.lost, strict=True)
        sigma = [
            None if lost or x is None or y is None or z is None else 3 * math.hypot(x, y, z) for x, y, z, lost in rows
        ]
        data.append(line("3 sigma of the covariance", (path.travelled_m, scaled(sigma, factor)), "@five", width=1.5))
    layout = {"xaxis": axis(TRAVELLED), "yaxis": axis(f"estimate - truth in DS, {unit}", zeroline=True)}
    caption = "Error accumulated since the first frame, without re-basing; not a figure of the specification."
    return [
        Plot("height", "Height", "The axes have different scales.", heights, upright),
        Plot("accumulated", "Accumulated position error", caption, data, layout),
    ]


# ---- sub-trajectories


def _marked(
    plotted: PlottedCondition,
    name: str,
    errors: Values,
    unit: str,
    *,
    color: str = COLORS[0],
    **more: Any,  # noqa: ANN401
) -> Trace:
    """Return a mark for each sub-trajectory; a hover text names the frames and stamps."""
    hover = f"{TRACE_BACK}<br>error %{{y:.4g}} {unit}<extra></extra>"
    trace_back = {"customdata": _traces_to(plotted.rows), "hovertemplate": hover}
    return marks(name, (plotted.at_end_m, errors), color, **trace_back, **more)


def _position(score: Score, conditions: list[PlottedCondition]) -> Plot:
    factor, unit = error_scale(largest(*(error_sizes(plotted.rows) for plotted in conditions)))
    data = [trace for k, plotted in enumerate(conditions) for trace in _of_condition(score, plotted, k, factor, unit)]
    sizes = [size for plotted in conditions for size in scaled(error_sizes(plotted.rows), factor)]
    of_first = limits_on(score, "position", conditions[0].rows.condition)  # others are hidden at the start
    limits = [limit.value * factor for limit in of_first]
    layout = {"xaxis": axis(AT_THE_END), "yaxis": error_axis(f"size of the position error, {unit}", sizes, limits)}
    caption = "Each mark is one sub-trajectory: hover for its frames and stamps. A click on a name of the legend "
    caption += "shows or hides a condition."
    return Plot("position", "Position error against distance travelled", caption, data, layout, width="full")


def _of_condition(score: Score, plotted: PlottedCondition, k: int, factor: float, unit: str) -> list[Trace]:
    """Return marks, statistics, limits and interval of the k-th condition; only the first is shown at the start."""
    over, condition = plotted.over, plotted.rows.condition
    row = score.figure("position", condition=condition)
    group: dict[str, Any] = {"legendgroup": over, "visible": True if k == 0 else "legendonly"}
    color, symbol = COLORS[k % len(COLORS)], SYMBOLS[k % len(SYMBOLS)]
    errors = scaled(error_sizes(plotted.rows), factor)
    ends = plotted.extent_m
    name = f"error over {over}, n = {_count_of(row)}"
    data = [_marked(plotted, name, errors, unit, color=color, symbol=symbol, **group)]
    for statistic, value in drawn_statistics(score, row).items():
        title = MEAN_OF_VECTORS if statistic == "mean" else statistic_title(statistic)
        level = scaled([value] * 2, factor)
        data.append(line(f"{title}, {over}", (ends, level), color, dash=DASHES.get(statistic, "dot"), **group))
    limits = limits_on(score, "position", condition)
    data += limit_lines(limits, ends, factor, over, **(group if k else {}))
    if row is not None and row.interval is not None:
        low, high = (bound * factor for bound in row.interval)
        data.append(band(f"95 % interval, {over}", ends, low, high, f"{color}-soft", **group))
    return data


def _count_of(row: Figure | None) -> int:
    return 0 if row is None else row.n or 0


def growth(named: Sequence[tuple[str, Score]]) -> list[Plot]:
    """Return the plot of errors over the length of the sub-trajectories, for several scores; empty without data."""
    series = []
    for k, (name, score) in enumerate(named):
        rows = score.rows("position", subject=Subject.TRAJECTORY, condition=None)
        known = [(distance_of(row.part), row.mean_plus_3sigma, row.n) for row in rows]
        series.append((line_style(k), name, [point for point in known if None not in point]))
    points = [point for *_, over in series for point in over]
    if not points:
        return []
    distances, errors, _ = zip(*points, strict=True)
    factor, unit = error_scale(largest(errors))
    data = []
    for style, name, over in series:
        if over:
            lengths_m, totals, counts = zip(*over, strict=True)
            hover = f"over %{{x}} m: %{{y:.4g}} {unit}, n = %{{customdata}}<extra>{name}</extra>"
            more: dict[str, Any] = {"customdata": counts, "hovertemplate": hover}
            data.append(line(name, (lengths_m, scaled(totals, factor)), mode="lines+markers", **more, **style))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", min(distances), max(distances)),
        "yaxis": log_axis(f"position error, mean + 3 sigma, {unit}", *span(scaled(errors, factor))),
    }
    caption = "Re-based at each start, without an interval. Hover for the number of sub-trajectories."
    return [Plot("growth", "Position error against path length", caption, data, layout)]


class _Panel(NamedTuple):
    """One of several plots with a common horizontal axis."""

    title: str
    errors: Values
    row: Figure | None
    limits: Sequence[PlottedLimit] = ()
    is_signed: bool = False  #: Whether errors have a sign, so that limits have both signs and the band is symmetric.


def _directions(score: Score, plotted: PlottedCondition) -> Plot:
    rows, condition = plotted.rows, plotted.rows.condition
    errors = {"x": rows.x_m, "y": rows.y_m, "z": rows.z_m, "along": rows.along_m, "cross": rows.cross_m}
    panels = [
        _Panel(title, errors[name], score.figure("position", condition=condition, part=name), is_signed=True)
        for name, title in DIRECTIONS.items()
    ]
    scale = error_scale(largest(*errors.values()))
    over = f"Over {plotted.over}, n = {_count_of(score.figure('position', condition=condition))}"
    caption = f"{over}, by the axes of DS, along and across the path; mean and 3 sigma of each direction."
    data, layout = _stacked(plotted, panels, scale)
    return Plot("directions", "Position error by direction", caption, data, layout, height=860, width="full")


def _angles(score: Score, plotted: PlottedCondition) -> list[Plot]:
    """Return the plot of the angles that have errors; a ground truth without attitude has none."""
    rows, condition = plotted.rows, plotted.rows.condition
    heading, attitude = (score.figure(name, condition=condition) for name in ("heading", "attitude"))
    panels = [
        _Panel("heading", rows.heading_deg, heading, limits_on(score, "heading", condition), is_signed=True),
        _Panel("attitude", rows.attitude_deg, attitude, limits_on(score, "attitude", condition)),
    ]
    drawn = [panel for panel in panels if any(error is not None for error in panel.errors)]
    if not drawn:
        return []
    title = " and ".join(panel.title for panel in drawn).capitalize()
    over = f"Over {plotted.over}, n = {_count_of(drawn[0].row)}"
    caption = f"{over}. Heading has a sign; attitude is the angle of the shortest rotation."
    data, layout = _stacked(plotted, drawn, (1.0, "deg"))
    return [Plot("angles", f"{title} error", caption, data, layout, height=240 * len(drawn), width="full")]


def _stacked(
    plotted: PlottedCondition, panels: Sequence[_Panel], scale: tuple[float, str]
) -> tuple[list[Trace], dict[str, Any]]:
    """Return traces and layout of panels one below the other: errors, mean, mean ± 3 sigma, and limits."""
    factor, unit = scale
    data: list[Trace] = []
    layout: dict[str, Any] = {"grid": {"rows": len(panels), "columns": 1, "pattern": "coupled", "ygap": 0.14}}
    ends = plotted.extent_m
    for k, panel in enumerate(panels):
        suffix = str(k + 1) if k else ""
        axes: dict[str, Any] = {"yaxis": f"y{suffix}", "xaxis": "x", "showlegend": k == 0}
        mean = None if panel.row is None else panel.row.mean
        sigma = None if panel.row is None else panel.row.sigma
        of_mean = {**axes, "legendgroup": "m"}
        if mean is not None and sigma is not None:
            low, high = ((mean + sign * 3 * sigma) * factor for sign in (-1, 1))
            low = low if panel.is_signed else max(low, 0.0)
            data.append(band("mean ± 3 sigma", ends, low, high, "@one-soft", **of_mean))
        if mean is not None:
            data.append(line("mean", (ends, scaled([mean] * 2, factor)), "@truth", dash="dash", **of_mean))
        errors = scaled(panel.errors, factor)
        data.append(_marked(plotted, "sub-trajectory", errors, unit, symbol=SYMBOLS[0], **axes, legendgroup="s"))
        hidden_above = HIDDEN_ABOVE * largest(errors)
        for sign in (1.0, -1.0) if panel.is_signed else (1.0,):
            shown = axes | {"showlegend": sign > 0.0, "legendgroup": f"limits of {panel.title}"}
            limits = [limit._replace(value=sign * limit.value) for limit in panel.limits]
            data += limit_lines(limits, ends, of=panel.title, hidden_above=hidden_above, **shown)
        layout[f"yaxis{suffix}"] = axis(f"{panel.title},<br>{unit}", zeroline=True)
    layout["xaxis"] = axis(AT_THE_END)
    return data, layout
