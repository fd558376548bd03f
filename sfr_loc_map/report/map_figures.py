"""Figures of the map: its error over the images, over range and in space."""

from __future__ import annotations

import math
from typing import Any

from sfr_loc_map.metrics.score import ErrorImage, PointErrorScore, PointRows, Score, Triangulation
from sfr_loc_map.report.plots import Column, Plot, Trace, axis, line, log_axis, marks, scaled

LOG_TICKS_MM = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)
SCATTER_ROWS = 3000
LAW_STEPS = 40


def map_figures(score: Score) -> list[Plot]:
    """Return the figures of the map, as far as the score has their data."""
    details = None if score.details is None else score.details.map
    errors = None if score.map is None else score.map.errors
    figures = []
    if details is not None:
        width = "third" if len(details.error_images) % 3 == 0 else "half"
        figures += [_image(item, width) for item in details.error_images]
    if errors is not None and errors.by_range:
        cloud, law = (None, None) if details is None else (details.cloud, details.triangulation)
        figures.append(_over_range(errors, cloud, law))
    if details is not None and details.cloud.x_m:
        figures.append(_in_space(details.cloud))
    return figures


def _coloured(errors_mm: Column) -> tuple[list[float | None], float, float, dict[str, Any]]:
    """Return logarithms of errors in millimetres, the bounds of their middle, and colours with a bar for them."""
    logs = [None if mm is None or mm < 0 else round(math.log10(max(mm, 0.1)), 3) for mm in errors_mm]
    known = sorted(value for value in logs if value is not None) or [0.0]
    low, high = known[len(known) // 50], known[-1 - len(known) // 50]
    ticks = {"tickvals": [round(math.log10(t), 3) for t in LOG_TICKS_MM], "ticktext": [f"{t:g}" for t in LOG_TICKS_MM]}
    bar = {"title": {"text": "point error, mm", "side": "right"}, "thickness": 12, **ticks}
    return logs, low, max(high, low + 0.1), {"colorscale": "@sequential", "colorbar": bar}


def _image(item: ErrorImage, width: str) -> Plot:
    block, columns = item.block_px, len(item.error[0]) if item.error else 0
    values = [[None if value < 0 else value / 10 for value in row] for row in item.error]
    logs, low, high, colours = _coloured([value for row in values for value in row])
    heat = {
        "type": "heatmap",
        "z": [logs[first : first + columns] for first in range(0, len(logs), columns)] if columns else values,
        "x0": (block - 1) / 2,
        "dx": block,
        "y0": (block - 1) / 2,
        "dy": block,
        "zmin": low,
        "zmax": high,
        **colours,
        "customdata": values,
        "hoverongaps": False,
        "hovertemplate": "u %{x:.0f}, v %{y:.0f} px: %{customdata:.4g} mm<extra></extra>",
    }
    layout = {
        "xaxis": axis("u of the left image, px", constrain="domain", showgrid=False),
        "yaxis": axis("v, px", autorange="reversed", scaleanchor="x", constrain="domain", showgrid=False),
    }
    title = f"Point error over the image of pair {item.pair}"
    caption = f"Mean of blocks of {block} x {block} pixels; blank where there is no point with a truth."
    return Plot(f"image-{item.pair}", title, caption, [heat], layout, height=340, width=width)


def _over_range(errors: PointErrorScore, cloud: PointRows | None, law: Triangulation | None) -> Plot:
    bins = errors.by_range
    data: list[Trace] = []
    ranges: Column = () if cloud is None else cloud.range_m
    if cloud is not None and ranges:
        step = -(-len(ranges) // SCATTER_ROWS)
        some = ranges[::step], scaled(cloud.error_m[::step], 1e3)
        data.append(marks("points (some)", some, "@faint", size=3, hoverinfo="skip"))
    low, high = min((value for value in ranges if value), default=0.5), bins[-1].to_m
    for name, statistic, color, dash in (
        ("p50", "p50", "@one", "solid"),
        ("p95", "p95", "@two", "solid"),
        ("mean + 3 sigma", "mean_plus_3sigma", "@five", "dash"),
    ):
        x: list[float | None] = []
        y: list[float | None] = []
        for item in bins:
            x += [max(item.from_m, low), item.to_m, None]
            y += [*scaled([getattr(item.point_error_m, statistic)] * 2, 1e3), None]
        data.append(line(name, (x, y), color, dash=dash, width=3))
    if law is not None:
        data += _law(law, errors.disparity_error_px.p50_abs, low, high)
    totals = [value for item in bins for value in (item.point_error_m.p50, item.point_error_m.mean_plus_3sigma)]
    known = [value * 1e3 for value in totals if value] or [1.0]
    layout = {
        "xaxis": log_axis("range from the left camera, m", low, high)
        | {"range": [math.log10(0.75 * low), math.log10(1.1 * high)]},
        "yaxis": log_axis("point error, mm", 0.1, 1e5, steps=(1,))
        | {"range": [math.log10(max(min(known) / 10, 0.1)), math.log10(max(known) * 3)]},
    }
    caption = (
        "The law of triangulation: an error d of the disparity moves a point by Z² d / (f b) along its ray (f focal "
        "length, b baseline; the range stands for the depth Z). Its lines are what the named disparity errors "
        "amount to, the bold one for the median that was measured."
    )
    return Plot("over-range", "Point error over range", caption, data, layout, height=480, width="full")


def _law(law: Triangulation, measured: float | None, low: float, high: float) -> list[Trace]:
    """Return the error by range of some disparity errors, and of the measured median."""
    scale = law.focal_px * law.baseline_m
    ratio = (high / low) ** (1 / LAW_STEPS)
    ranges = [low * ratio**k for k in range(LAW_STEPS + 1)]
    steps = [(d, f"{d:g} px", 1.0) for d in (0.1, 0.25, 1.0)]
    if measured is not None:
        steps.append((measured, f"{measured:.2g} px", 2.5))
    traces = []
    for d, text, width in steps:
        errors = scaled([r * r * d / scale for r in ranges], 1e3)
        words = [text + " "] + [""] * LAW_STEPS
        more = {"mode": "lines+text", "text": words, "textposition": "middle left", "legendgroup": "law"}
        trace = line("law of triangulation", (ranges, errors), "@truth", dash="dot", width=width)
        traces.append(trace | more | {"showlegend": width > 1.0 or (measured is None and d == 1.0)})
    return traces


def _in_space(cloud: PointRows) -> Plot:
    logs, low, high, colours = _coloured([None if error is None else error * 1e3 for error in cloud.error_m])
    points = {
        "type": "scatter3d",
        "mode": "markers",
        "x": cloud.x_m,
        "y": cloud.y_m,
        "z": cloud.z_m,
        "marker": {"color": logs, "size": 2, "cmin": low, "cmax": high, **colours},
        "customdata": scaled(cloud.error_m, 1e3),
        "hovertemplate": "%{x:.2f}, %{y:.2f}, %{z:.2f} m: %{customdata:.4g} mm<extra></extra>",
    }
    scene: dict[str, Any] = {"aspectmode": "data", "camera": {"eye": {"x": -1.6, "y": -1.3, "z": 1.1}}}
    for name, column in (("x", cloud.x_m), ("y", cloud.y_m), ("z", cloud.z_m)):
        # the middle 95 % of the values; far points would leave little of the rest
        ordered = sorted(value for value in column if value is not None)
        spare = len(ordered) // 40
        scene[f"{name}axis"] = {"title": {"text": f"{name} of LM, m"}, "range": [ordered[spare], ordered[-1 - spare]]}
    caption = f"{len(logs)} points of the cloud, those within the middle 95 % of each axis. Equal axes. LM: "
    caption += "the local map frame, fixed to the ground, z up."
    return Plot("cloud", "Cloud coloured by error", caption, [points], {"scene": scene}, height=560, width="full")
