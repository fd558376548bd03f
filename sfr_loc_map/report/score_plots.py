"""The plots of a score: the drive and the errors of its sub-trajectories, calls, the map.

`score_plots` returns the sections of a page. `_drive_plots`, `_timeline` and `_map_plots` return the plots of each
section.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sfr_loc_map.metrics.config import CallKind, label_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.table.catalogue import TOTAL, Subject, statistic_title
from sfr_loc_map.metrics.table.details import ErrorImage, PathRows, PointRows, SubTrajectoryRows, Triangulation
from sfr_loc_map.metrics.table.row_part import DIRECTIONS, distance_of
from sfr_loc_map.metrics.table.rows import Figure
from sfr_loc_map.report.notes import HOST
from sfr_loc_map.report.plots import (
    COLORS,
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
    segments,
    span,
)
from sfr_loc_map.report.plotted_data import (
    PlottedCondition,
    PlottedLimit,
    drawn_statistics,
    error_sizes,
    errors_by_range,
    limits_on,
    map_of,
    path_errors,
    path_of,
    plotted_conditions,
)
from sfr_loc_map.report.tables import MIB

AT_THE_END = "distance travelled at the end, m"
MEAN_OF_VECTORS = "norm of the mean"  #: Title of the mean of error vectors.
DASHES = {"mean": "dash", TOTAL: "solid"}  #: Dashes of the statistics of errors; others are dotted.
TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)
"""Hover text of a mark; `customdata` is a row of `_traces_to`."""
STATES = {
    "initialising": ("@two", "diamond"),
    "tracking": ("@one", "circle"),
    "degraded": ("@three", "triangle-up"),
    "lost": ("@bad", "x"),
    "mapped": ("@one", "circle"),
    "fused": ("@three", "square"),
    "other": ("@four", "square"),
}
"""Colour and mark of each state that a call reports."""
LOG_TICKS_MM = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)  #: Ticks of the colour bar of point errors, mm.
SCATTER_ROWS = 3000  #: Maximum number of marks of map points.
LAW_STEPS = 40  #: Number of pieces of a line of the law of triangulation.
LOGARITHMIC_ABOVE = 3.0  #: A limit above this multiple of the largest value makes an axis of sizes logarithmic.
HIDDEN_ABOVE = 10.0
"""A limit above this multiple of the largest value is only in the legend of a linear axis with negative values."""


def score_plots(score: Score) -> list[tuple[str, list[Plot]]]:
    """Return the plots by heading for which the score has data."""
    groups = (
        ("Localisation", _drive_plots(score)),
        ("Time and memory", [plot for kind in CallKind for plot in _timeline(score, kind)]),
        ("Map", _map_plots(score)),
    )
    return [(title, plots) for title, plots in groups if plots]


def _drive_plots(score: Score) -> list[Plot]:
    path, conditions = path_of(score), plotted_conditions(score)
    plots = [_top_view(path, conditions), *_along(path)] if path and path.stamp_ns else []
    if not conditions:
        return plots
    return [
        *plots,
        _position(score, conditions),
        *(replace(plot, width="full") for plot in growth([("mean + 3 sigma", score)])),
        _directions(score, conditions[0]),
        _angles(score, conditions[0]),
    ]


def _limit_lines(
    limits: Sequence[PlottedLimit],
    ends: Values,
    factor: float = 1.0,
    of: str = "",
    hidden_above: float = math.inf,
    **more: Any,  # noqa: ANN401
) -> list[Trace]:
    """Return a line for each limit in the unit of the plot; `of` names the limited errors in the legend.

    A limit beyond `hidden_above` is only in the legend.
    """
    traces = []
    for limit in limits:
        far = {"visible": "legendonly"} if abs(limit.value * factor) > hidden_above else {}
        title = f"{limit.title}, {of}" if of else limit.title
        level = scaled([limit.value] * 2, factor)
        traces.append(line(title, (ends, level), "@bad", dash="longdash", **(more | far)))
    return traces


def _error_axis(title: str, values: Values, limits: Sequence[float]) -> dict[str, Any]:
    """Return an axis from 0 for values and their limits; logarithmic if a limit is far above all values."""
    if max(limits, default=0.0) > LOGARITHMIC_ABOVE * largest(values):
        return log_axis(title, *span([*values, *limits]))
    return axis(title, rangemode="tozero")


def _traces_to(rows: SubTrajectoryRows) -> list[list[str | int]]:
    """Return condition, frames and stamps of each sub-trajectory, the `customdata` of its marks.

    On a click, `page.js` shows the segment of a mark with these five values: it moves the trace `chosen sub-trajectory`
    of the plot `top-view` along the trace `truth`, which has one frame in `Page.every`.
    """
    frames = zip(rows.start_frame, rows.end_frame, rows.start_stamp_ns, rows.end_stamp_ns, strict=True)
    return [[label_of(rows.condition), first, last, str(start), str(end)] for first, last, start, end in frames]


# ---- the drive


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
    """Return a mark for each sub-trajectory, which names its frames and stamps."""
    hover = f"{TRACE_BACK}<br>error %{{y:.4g}} {unit}<extra></extra>"
    trace_back = {"customdata": _traces_to(plotted.rows), "hovertemplate": hover}
    return marks(name, (plotted.at_end_m, errors), color, **trace_back, **more)


def _position(score: Score, conditions: list[PlottedCondition]) -> Plot:
    factor, unit = error_scale(largest(*(error_sizes(plotted.rows) for plotted in conditions)))
    data = [trace for k, plotted in enumerate(conditions) for trace in _of_condition(score, plotted, k, factor, unit)]
    sizes = [size for plotted in conditions for size in scaled(error_sizes(plotted.rows), factor)]
    limits = [
        limit.value * factor for plotted in conditions for limit in limits_on(score, "position", plotted.rows.condition)
    ]
    layout = {"xaxis": axis(AT_THE_END), "yaxis": _error_axis(f"size of the position error, {unit}", sizes, limits)}
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
    data += _limit_lines(limits, ends, factor, over, **(group if k else {}))
    if row is not None and row.interval is not None:
        low, high = (bound * factor for bound in row.interval)
        data.append(band(f"95 % interval, {over}", ends, low, high, f"{color}-soft", **group))
    return data


def _count_of(row: Figure | None) -> int:
    return 0 if row is None else row.n or 0


def growth(named: Sequence[tuple[str, Score]]) -> list[Plot]:
    """Return the plot of the errors of scores over the length of the sub-trajectories; empty without data."""
    series = []
    for k, (name, score) in enumerate(named):
        steps = score.rows("position", subject=Subject.TRAJECTORY, condition=None)
        totals = ((distance_of(row.part), row.mean_plus_3sigma) for row in steps)
        series.append((line_style(k), name, [item for item in totals if item[1] is not None]))
    points = [point for *_, over in series for point in over]
    if not points:
        return []
    distances, errors = zip(*points, strict=True)
    factor, unit = error_scale(largest(errors))
    data = []
    for style, name, over in series:
        if over:
            xy = [distance for distance, _ in over], scaled([error for _, error in over], factor)
            data.append(line(name, xy, mode="lines+markers", **style))
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", min(distances), max(distances)),
        "yaxis": log_axis(f"position error, mean + 3 sigma, {unit}", *span(scaled(errors, factor))),
    }
    return [Plot("growth", "Position error against path length", "Re-based at each start.", data, layout)]


class _Panel(NamedTuple):
    """One of several plots with a common horizontal axis."""

    title: str
    errors: Values
    row: Figure | None
    limits: Sequence[PlottedLimit] = ()
    is_signed: bool = False  #: Whether errors have a sign, so the limits are drawn with both signs.


def _directions(score: Score, plotted: PlottedCondition) -> Plot:
    rows, condition = plotted.rows, plotted.rows.condition
    errors = {"x": rows.x_m, "y": rows.y_m, "z": rows.z_m, "along": rows.along_m, "cross": rows.cross_m}
    panels = [
        _Panel(title, errors[name], score.figure("position", condition=condition, part=name))
        for name, title in DIRECTIONS.items()
    ]
    scale = error_scale(largest(*errors.values()))
    over = f"Over {plotted.over}, n = {_count_of(score.figure('position', condition=condition))}"
    caption = f"{over}, by the axes of DS, along and across the path; mean and 3 sigma of each direction."
    data, layout = _stacked(plotted, panels, scale)
    return Plot("directions", "Position error by direction", caption, data, layout, height=860, width="full")


def _angles(score: Score, plotted: PlottedCondition) -> Plot:
    rows, condition = plotted.rows, plotted.rows.condition
    heading, attitude = (score.figure(name, condition=condition) for name in ("heading", "attitude"))
    panels = [
        _Panel("heading", rows.heading_deg, heading, limits_on(score, "heading", condition), is_signed=True),
        _Panel("attitude", rows.attitude_deg, attitude, limits_on(score, "attitude", condition)),
    ]
    over = f"Over {plotted.over}, n = {_count_of(score.figure('position', condition=condition))}"
    caption = f"{over}. Heading has a sign; attitude is the angle of the shortest rotation."
    data, layout = _stacked(plotted, panels, (1.0, "deg"))
    return Plot("angles", "Heading and attitude error", caption, data, layout, height=480, width="full")


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
            data.append(band("mean ± 3 sigma", ends, low, high, "@one-soft", **of_mean))
        if mean is not None:
            data.append(line("mean", (ends, scaled([mean] * 2, factor)), "@truth", dash="dash", **of_mean))
        errors = scaled(panel.errors, factor)
        data.append(_marked(plotted, "sub-trajectory", errors, unit, symbol=SYMBOLS[0], **axes, legendgroup="s"))
        hidden_above = HIDDEN_ABOVE * largest(errors)
        for sign in (1.0, -1.0) if panel.is_signed else (1.0,):
            shown = axes | {"showlegend": sign > 0.0, "legendgroup": f"limits of {panel.title}"}
            limits = [limit._replace(value=sign * limit.value) for limit in panel.limits]
            data += _limit_lines(limits, ends, of=panel.title, hidden_above=hidden_above, **shown)
        layout[f"yaxis{suffix}"] = axis(f"{panel.title},<br>{unit}", zeroline=True)
    layout["xaxis"] = axis(AT_THE_END)
    return data, layout


# ---- time and memory of calls


def _timeline(score: Score, kind: CallKind) -> list[Plot]:
    plots = None if score.details is None else score.details.calls.get(kind)
    if plots is None or len(plots.series.stamp_ns) < 2:
        return []
    series = plots.series
    known_clock = "" if score.calls is None else score.calls.clocks.get(kind, "")
    clock = "host time" if known_clock.startswith(HOST) else "time"
    seconds = [round((stamp - series.stamp_ns[0]) * 1e-9, 6) for stamp in series.stamp_ns]
    shown = [state if state in STATES else "other" for state in series.state]
    data: list[Trace] = []
    for name, (color, symbol) in STATES.items():
        rows = [k for k, state in enumerate(shown) if state == name]
        if rows:
            places = [seconds[k] for k in rows], [series.processing_time_s[k] for k in rows]
            stamps = [str(series.stamp_ns[k]) for k in rows]
            hover = f"call at stamp %{{customdata}} ns: %{{y:.4g}} s<extra>{name}</extra>"
            data.append(marks(name, places, color, symbol=symbol, size=5, customdata=stamps, hovertemplate=hover))
    ends = [min(seconds), max(seconds)]
    limits = limits_on(score, kind)
    data += _limit_lines(limits, ends)
    layout: dict[str, Any] = {
        "xaxis": axis("time since the first pair, s"),
        "yaxis": _error_axis(f"{clock} per call, s", series.processing_time_s, [limit.value for limit in limits]),
    }
    if any(peak is not None for peak in series.peak_rss_bytes):
        peaks = scaled(series.peak_rss_bytes, 1 / MIB.size)
        data.append(line("peak memory", (seconds, peaks), "@three", yaxis="y2"))
        for limit in limits_on(score, "peak", part=kind):
            level = scaled([limit.value] * 2, 1 / MIB.size)
            data.append(line("limit of the peak", (ends, level), "@bad", dash="longdash", yaxis="y2"))
        layout["grid"] = {"rows": 2, "columns": 1, "pattern": "coupled", "ygap": 0.14}
        layout["yaxis2"] = axis("peak memory, MiB")
    block = series.slowest_of
    caption = "One mark per call; resident memory." if block == 1 else f"The slowest of every {block} calls."
    title = f"Time and memory by call: {kind.words}"
    return [Plot(f"{kind}-timeline", title, caption, data, layout, height=440, width="full")]


# ---- the map


def _map_plots(score: Score) -> list[Plot]:
    details = map_of(score)
    images = () if details is None else details.error_images
    plots = [_image(item, "third" if len(images) % 3 == 0 else "half") for item in images]
    if errors_by_range(score):
        plots.append(_over_range(score))
    if details is not None and details.cloud.x_m:
        plots.append(_in_space(details.cloud))
    return plots


class _LogScale(NamedTuple):
    """Colours of point errors on a logarithmic scale."""

    logs: list[float | None]  #: Decimal logarithm of each error in mm; None if unknown.
    low: float
    high: float
    bar: dict[str, Any]


def _log_scale(errors_mm: Values) -> _LogScale:
    """Return the colours of point errors; the scale spans the middle 96 % of the errors."""
    logs = [None if mm is None or mm < 0 else round(math.log10(max(mm, 0.1)), 3) for mm in errors_mm]
    known = sorted(value for value in logs if value is not None) or [0.0]
    low, high = known[len(known) // 50], known[-1 - len(known) // 50]
    ticks = {"tickvals": [round(math.log10(t), 3) for t in LOG_TICKS_MM], "ticktext": [f"{t:g}" for t in LOG_TICKS_MM]}
    return _LogScale(logs, low, max(high, low + 0.1), colour_bar("point error, mm", **ticks))


def _image(item: ErrorImage, width: str) -> Plot:
    block, columns = item.block_px, len(item.error_0p1mm[0]) if item.error_0p1mm else 0
    values = [[None if value < 0 else value / 10 for value in row] for row in item.error_0p1mm]
    scale = _log_scale([value for row in values for value in row])
    shown = [scale.logs[k : k + columns] for k in range(0, len(scale.logs), max(columns, 1))]
    first = (block - 1) / 2
    image: Trace = {
        "type": "heatmap",
        "z": shown,
        "x0": first,
        "dx": block,
        "y0": first,
        "dy": block,
        "zmin": scale.low,
        "zmax": scale.high,
        "colorscale": "@sequential",
        "colorbar": scale.bar,
        "customdata": values,
        "hoverongaps": False,
        "hovertemplate": "u %{x:.0f}, v %{y:.0f} px: %{customdata:.4g} mm<extra></extra>",
    }
    layout = {
        "xaxis": axis("u of the left image, px", constrain="domain", showgrid=False),
        "yaxis": axis("v, px", autorange="reversed", scaleanchor="x", constrain="domain", showgrid=False),
    }
    title = f"Point error over the image of pair {item.pair}"
    caption = f"Mean of blocks of {block} x {block} pixels; blank without a point that has a truth."
    return Plot(f"image-{item.pair}", title, caption, [image], layout, height=340, width=width)


def _over_range(score: Score) -> Plot:
    details, bins = map_of(score), errors_by_range(score)
    data: list[Trace] = []
    ranges: Values = () if details is None else details.cloud.range_m
    if details is not None and ranges:
        step = -(-len(ranges) // SCATTER_ROWS)
        some = ranges[::step], scaled(details.cloud.error_m[::step], 1e3)
        data.append(marks("points (some)", some, "@faint", size=3, hoverinfo="skip"))
    low, high = min((value for value in ranges if value), default=0.5), bins[-1].farthest_m
    for name, color, dash in (
        ("p50", "@one", "solid"),
        ("p95", "@two", "solid"),
        ("mean_plus_3sigma", "@five", "dash"),
    ):
        levels = [
            ([max(nearest, low), farthest], scaled([row.statistic(name)] * 2, 1e3)) for nearest, farthest, row in bins
        ]
        data.append(line(statistic_title(name), segments(levels), color, dash=dash, width=3))
    data += _limit_lines(limits_on(score, "point_error"), [low, high], 1e3)
    if details is not None:
        data += _law_lines(details.triangulation, score.number("disparity_error", "p50", part=None), low, high)
    totals = [value for bounded in bins for value in (bounded.row.p50, bounded.row.mean_plus_3sigma)]
    known = [value * 1e3 for value in totals if value] or [1.0]
    layout = {
        "xaxis": log_axis("range from the left camera, m", low, high)
        | {"range": [math.log10(0.25 * low), math.log10(1.1 * high)]},
        "yaxis": log_axis("point error, mm", 0.1, 1e5, steps=(1,))
        | {"range": [math.log10(max(min(known) / 10, 0.1)), math.log10(max(known) * 3)]},
    }
    caption = (
        "Law of triangulation: a disparity error d moves a point by Z² d / (f b) along its ray (f focal length, b "
        "baseline; the range approximates the depth Z). The lines show this error for the labelled disparity "
        "errors; the bold line is for the measured median."
    )
    return Plot("over-range", "Point error over range", caption, data, layout, height=480, width="full")


def _law_lines(law: Triangulation, median_px: float | None, low: float, high: float) -> list[Trace]:
    """Return the errors by the law of triangulation over the range for several disparity errors and their median."""
    ratio = (high / low) ** (1 / LAW_STEPS)
    ranges_m = [low * ratio**k for k in range(LAW_STEPS + 1)]
    data = []
    for disparity_px, width in ((0.1, 1.0), (0.25, 1.0), (1.0, 1.0), (median_px, 2.5)):
        if disparity_px is None:
            continue
        errors_m = [range_m * range_m * disparity_px / (law.focal_px * law.baseline_m) for range_m in ranges_m]
        labels = {
            "mode": "lines+text",
            "text": [f"{disparity_px:.2g} px "] + [""] * LAW_STEPS,
            "textposition": "middle left",
            "textfont": {"size": 10},
            "showlegend": disparity_px == 1.0,
            "legendgroup": "law",
        }
        xy = ranges_m, scaled(errors_m, 1e3)
        data.append(line("law of triangulation", xy, "@truth", dash="dot", width=width) | labels)
    return data


def _in_space(cloud: PointRows) -> Plot:
    scale = _log_scale([None if error is None else error * 1e3 for error in cloud.error_m])
    points: Trace = {
        "type": "scatter3d",
        "mode": "markers",
        "x": cloud.x_m,
        "y": cloud.y_m,
        "z": cloud.z_m,
        "marker": {
            "color": scale.logs,
            "size": 2,
            "cmin": scale.low,
            "cmax": scale.high,
            "colorscale": "@sequential",
            "colorbar": scale.bar,
        },
        "customdata": scaled(cloud.error_m, 1e3),
        "hovertemplate": "%{x:.2f}, %{y:.2f}, %{z:.2f} m: %{customdata:.4g} mm<extra></extra>",
    }
    scene: dict[str, Any] = {"aspectmode": "data", "camera": {"eye": {"x": -1.6, "y": -1.3, "z": 1.1}}}
    for name, column in (("x", cloud.x_m), ("y", cloud.y_m), ("z", cloud.z_m)):
        # the middle 95 % of the values, because far points would compress the others
        ordered = sorted(value for value in column if value is not None)
        spare = len(ordered) // 40
        scene[f"{name}axis"] = {"title": {"text": f"{name} of LM, m"}, "range": [ordered[spare], ordered[-1 - spare]]}
    caption = f"{len(scale.logs)} points of the cloud; the view spans the middle 95 % of each axis. Equal axes. LM: "
    caption += "the local map frame, fixed to the ground, z up."
    return Plot("cloud", "Cloud coloured by error", caption, [points], {"scene": scene}, height=560, width="full")
