"""Figures of the map: its error over the images, over range and in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sfr_loc_map.metrics.score import (
    Column,
    ErrorImage,
    PointErrorScore,
    PointRows,
    RangeScore,
    Score,
    Triangulation,
)
from sfr_loc_map.report.plots import Plot, Trace, axis, line, log_axis, marks, scaled

LOG_TICKS_MM = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000)
SCATTER_ROWS = 3000
LAW_STEPS = 40
DEFAULT_NEAREST_M = 0.5


def map_figures(score: Score) -> list[Plot]:
    """Return the figures of the map, as far as the score has their data."""
    details = None if score.details is None else score.details.map
    errors = None if score.map is None else score.map.errors
    images = details.error_images if details is not None else ()
    cloud = details.cloud if details is not None else None
    figures = [_image(item, "third" if len(images) % 3 == 0 else "half") for item in images]
    if errors is not None and errors.by_range:
        figures.append(_over_range(errors, cloud, None if details is None else details.triangulation))
    if cloud is not None and cloud.x_m:
        figures.append(_in_space(cloud))
    return figures


def _logarithm(error_mm: float | None) -> float | None:
    return round(math.log10(max(error_mm, 0.1)), 3) if error_mm is not None and error_mm >= 0 else None


def _log_bar(values: list[float | None]) -> dict[str, Any]:
    """Return colours and colour bar of logarithms of errors in millimetres."""
    known = sorted(value for value in values if value is not None) or [0.0]
    low, high = known[len(known) // 50], known[-1 - len(known) // 50]
    ticks = {"tickvals": [round(math.log10(t), 3) for t in LOG_TICKS_MM], "ticktext": [f"{t:g}" for t in LOG_TICKS_MM]}
    bar = {"title": {"text": "point error, mm", "side": "right"}, "thickness": 12, **ticks}
    return {"colorscale": "@sequential", "colorbar": bar, "low": low, "high": max(high, low + 0.1)}


def _image(item: ErrorImage, width: str) -> Plot:
    block, rows = item.block_px, item.error
    z = [[_logarithm(value / 10) for value in row] for row in rows]
    colors = _log_bar([value for row in z for value in row])
    values = [[None if value < 0 else value / 10 for value in row] for row in rows]
    heat = {
        "type": "heatmap",
        "z": z,
        "x0": (block - 1) / 2,
        "dx": block,
        "y0": (block - 1) / 2,
        "dy": block,
        "zmin": colors["low"],
        "zmax": colors["high"],
        "colorscale": colors["colorscale"],
        "colorbar": colors["colorbar"],
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
    low, high = min((value for value in ranges if value), default=DEFAULT_NEAREST_M), bins[-1].to_m
    data += _bin_lines(bins, low)
    if law is not None:
        data += _law(law, errors.disparity_error_px.p50_abs, low, high)
    layout = {
        "xaxis": log_axis("range from the left camera, m", low, high)
        | {"range": [math.log10(0.75 * low), math.log10(1.1 * high)]},
        "yaxis": log_axis("point error, mm", 0.1, 1e5, steps=(1,)) | {"range": _log_range(bins)},
    }
    caption = (
        "The law of triangulation: an error d of the disparity moves a point by Z² d / (f b) along its ray (f focal "
    )
    caption += "length, b baseline; the range stands for the depth Z). Its lines are what the named disparity errors "
    caption += "amount to, the bold one for the median that was measured."
    return Plot("over-range", "Point error over range", caption, data, layout, height=480, width="full")


def _bin_lines(bins: Sequence[RangeScore], low: float) -> list[Trace]:
    """Return lines of the statistics of each range, from no nearer than `low`."""
    x: list[float | None] = []
    columns: tuple[list[float | None], ...] = ([], [], [])
    for item in bins:
        x += [max(item.from_m, low), item.to_m, None]
        error = item.point_error_m
        for y, value in zip(columns, (error.p50, error.p95, error.mean_plus_3sigma), strict=True):
            y += [*scaled([value] * 2, 1e3), None]
    styles = (("p50", "@one", "solid"), ("p95", "@two", "solid"), ("mean + 3 sigma", "@five", "dash"))
    return [
        line(name, (x, y), color, dash=dash, width=3) for y, (name, color, dash) in zip(columns, styles, strict=True)
    ]


def _log_range(bins: Sequence[RangeScore]) -> list[float]:
    """Return a range of the axis of errors in millimetres that holds all bins, as logarithms."""
    errors = [item.point_error_m for item in bins]
    known = [value * 1e3 for error in errors for value in (error.p50, error.mean_plus_3sigma) if value] or [1.0]
    return [math.log10(max(min(known) / 10, 0.1)), math.log10(max(known) * 3)]


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
    logs = [_logarithm(None if error is None else error * 1e3) for error in cloud.error_m]
    colors = _log_bar(logs)
    style = {
        "color": logs,
        "size": 2,
        "cmin": colors["low"],
        "cmax": colors["high"],
        "colorscale": colors["colorscale"],
        "colorbar": colors["colorbar"],
    }
    points = {
        "type": "scatter3d",
        "mode": "markers",
        "x": cloud.x_m,
        "y": cloud.y_m,
        "z": cloud.z_m,
        "marker": style,
        "customdata": scaled(cloud.error_m, 1e3),
        "hovertemplate": "%{x:.2f}, %{y:.2f}, %{z:.2f} m: %{customdata:.4g} mm<extra></extra>",
    }
    scene: dict[str, Any] = {"aspectmode": "data", "camera": {"eye": {"x": -1.6, "y": -1.3, "z": 1.1}}}
    for name, column in (("x", cloud.x_m), ("y", cloud.y_m), ("z", cloud.z_m)):
        scene[f"{name}axis"] = {"title": {"text": f"{name} of LM, m"}, "range": _middle(column)}
    caption = f"{len(logs)} points of the cloud, those within the middle 95 % of each axis. Equal axes. LM: "
    caption += "the local map frame, fixed to the ground, z up."
    return Plot("cloud", "Cloud coloured by error", caption, [points], {"scene": scene}, height=560, width="full")


def _middle(values: Column) -> list[float]:
    """Return the bounds of the middle 95 % of the values; far points would leave little of the rest."""
    ordered = sorted(value for value in values if value is not None)
    spare = len(ordered) // 40
    return [ordered[spare], ordered[-1 - spare]]
