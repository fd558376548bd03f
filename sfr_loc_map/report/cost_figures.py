"""Figures of time and memory of the calls."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import CallFigures, CallScore, CallSeries, Score
from sfr_loc_map.report.plots import Plot, Trace, axis, line, log_axis, marks, scaled
from sfr_loc_map.report.score_tables import HOST, clock_text
from sfr_loc_map.report.tables import MIB

STATES = {
    "initialising": ("@two", "diamond"),
    "tracking": ("@one", "circle"),
    "degraded": ("@three", "triangle-up"),
    "lost": ("@bad", "x"),
    "mapped": ("@one", "circle"),
    "fused": ("@three", "square"),
    "other": ("@four", "square"),
}
"""What a call said: its colour and mark."""
MIN_HISTOGRAM = 10
"""Fewer calls are told by their timeline alone."""


def cost_figures(score: Score) -> list[Plot]:
    """Return histogram and timeline of each kind of call, as far as the score has their data."""
    details = None if score.details is None else score.details.calls
    figures: list[Plot] = []
    for kind in CallKind:
        calls = None if details is None else details.of(kind)
        if calls is None:
            continue
        times = None if score.timing is None else score.timing.of(kind)
        clock = "host time" if times is not None and times.clock.startswith(HOST) else "time"
        histogram = sum(calls.histogram.counts) >= MIN_HISTOGRAM
        if histogram:
            figures.append(_histogram(kind, clock, calls, times, clock_text(score.timing, score.target)))
        if len(calls.series.stamp_ns) > 1:
            figures.append(_timeline(kind, clock, calls.series, "half" if histogram else "full"))
    return figures


def _histogram(kind: CallKind, clock: str, calls: CallFigures, times: CallScore | None, caption: str) -> Plot:
    edges, counts = calls.histogram.edges_s, calls.histogram.counts
    bars = {
        "type": "bar",
        "name": "calls",
        "x": scaled(edges[:-1], 1.0),
        "y": counts,
        "width": scaled([high - low for low, high in pairwise(edges)], 1.0),
        "offset": 0,
        "marker": {"color": "@one"},
        "customdata": [f"{low:.4g} to {high:.4g} s" for low, high in pairwise(edges)],
        "hovertemplate": "%{customdata}: %{y} calls<extra></extra>",
        "showlegend": False,
    }
    data: list[Trace] = [bars]
    for name, dash, color in (("p50", "dash", "@truth"), ("p95", "dot", "@two"), ("p99", "dashdot", "@five")):
        value = getattr(times, name, None)
        if value is not None:
            data.append(line(name, ([value, value], [0, max(counts)]), color, dash=dash, width=2.5))
    layout = {
        "xaxis": log_axis(f"{clock} per call, s", edges[0], edges[-1]),
        "yaxis": axis("number of calls"),
        "bargap": 0,
    }
    return Plot(f"{kind}-histogram", f"Time per call: {kind}", caption, data, layout)


def _timeline(kind: CallKind, clock: str, series: CallSeries, width: str) -> Plot:
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
    layout: dict[str, Any] = {
        "xaxis": axis("time since the first pair, s"),
        "yaxis": axis(f"{clock} per call, s", rangemode="tozero"),
    }
    if any(peak is not None for peak in series.peak_rss_bytes):
        peaks = scaled(series.peak_rss_bytes, 1 / MIB.size)
        data.append(line("peak memory", (seconds, peaks), "@three", yaxis="y2"))
        layout["grid"] = {"rows": 2, "columns": 1, "pattern": "coupled", "ygap": 0.14}
        layout["yaxis2"] = axis("peak memory, MiB")
    block = series.slowest_of
    caption = "Each call in turn; memory: resident." if block == 1 else f"The slowest of every {block} calls."
    return Plot(f"{kind}-timeline", f"Time and memory by call: {kind}", caption, data, layout, height=440, width=width)
