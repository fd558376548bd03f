"""Plots of a map: its errors over the images, over the range, and in space."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from sfr_loc_map.metrics.figures.catalogue import statistic_title
from sfr_loc_map.metrics.figures.details import ErrorImage, PointRows, Triangulation
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.limit_lines import limit_lines
from sfr_loc_map.report.plots import Plot, Trace, Values, axis, colour_bar, line, log_axis, marks, scaled, segments
from sfr_loc_map.report.plotted_data import errors_by_range, limits_on, map_of

LOG_TICKS_MM = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)  #: Ticks of the colour bar of point errors, mm.
SCATTER_ROWS = 3000  #: Maximum number of marks of map points.
LAW_STEPS = 40  #: Number of segments of each line that shows the law of triangulation.


def map_plots(score: Score) -> list[Plot]:
    """Return the plots of the map for which the score has data."""
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
    caption = f"Mean of blocks of {block} x {block} pixels; blank if no point of a block has a truth."
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
    data += limit_lines(limits_on(score, "point_error"), [low, high], 1e3)
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
    """Return the errors by the law of triangulation over the range for several disparity errors, and for the median."""
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
