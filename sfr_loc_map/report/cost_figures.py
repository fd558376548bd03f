"""Figures of time and memory of the calls."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from sfr_loc_map.report.cells import MIB, dig
from sfr_loc_map.report.plots import Plot, Trace, axis, column, line, log_axis, marks, scaled, seconds_since
from sfr_loc_map.report.score_tables import clock_text

STATES = (
    ("initialising", "@two", "diamond"),
    ("tracking", "@one", "circle"),
    ("lost", "@bad", "x"),
    ("mapped", "@one", "circle"),
    ("fused", "@three", "square"),
)
"""What a call said: its colour and mark."""
MIN_HISTOGRAM = 10
"""Fewer calls are told by their timeline alone."""


def cost_figures(score: Mapping[str, Any]) -> list[Plot]:
    """Return histogram and timeline of each kind of call, as far as the score has their data."""
    figures: list[Plot] = []
    for kind, calls in (dig(score, "details.calls") or {}).items():
        clock = "host time" if str(dig(score, f"timing.{kind}_s.clock") or "").startswith("host") else "time"
        edges, counts = (dig(calls, f"histogram.{name}") or [] for name in ("edges_s", "counts"))
        histogram = sum(counts) >= MIN_HISTOGRAM
        if histogram:
            figures.append(_histogram(score, kind, clock, edges, counts))
        if len(dig(calls, "series.stamp_ns") or []) > 1:
            figures.append(_timeline(kind, clock, calls["series"], "half" if histogram else "full"))
    return figures


def _histogram(score: Mapping[str, Any], kind: str, clock: str, edges: list[float], counts: list[int]) -> Plot:
    widths = scaled([high - low for low, high in pairwise(edges)], 1.0)
    bounds = [f"{low:.4g} to {high:.4g} s" for low, high in pairwise(edges)]
    left = scaled(edges[:-1], 1.0)
    bars = {
        "type": "bar",
        "name": "calls",
        "x": left,
        "y": counts,
        "width": widths,
        "offset": 0,
        "marker": {"color": "@one"},
        "customdata": bounds,
        "hovertemplate": "%{customdata}: %{y} calls<extra></extra>",
        "showlegend": False,
    }
    data: list[Trace] = [bars]
    top = max(counts)
    for name, dash, color in (("p50", "dash", "@truth"), ("p95", "dot", "@two"), ("p99", "dashdot", "@five")):
        value = dig(score, f"timing.{kind}_s.{name}")
        if value is not None:
            data.append(line(name, ([value, value], [0, top]), color, dash=dash, width=2.5))
    layout = {
        "xaxis": log_axis(f"{clock} per call, s", edges[0], edges[-1]),
        "yaxis": axis("number of calls"),
        "bargap": 0,
    }
    return Plot(f"{kind}-histogram", f"Time per call: {kind}", clock_text(score), data, layout)


def _timeline(kind: str, clock: str, series: Mapping[str, Any], width: str) -> Plot:
    at = seconds_since(series["stamp_ns"])
    times, peaks = column(series, "processing_time_s"), column(series, "peak_rss_bytes")
    states = series.get("state") or []
    data: list[Trace] = []
    known = {name for name, _, _ in STATES}
    for name, color, symbol in (*STATES, ("other", "@four", "square")):
        mine = [k for k, state in enumerate(states) if state == name or (name == "other" and state not in known)]
        if mine:
            stamps = [str(series["stamp_ns"][k]) for k in mine]
            hover = f"call at stamp %{{customdata}} ns: %{{y:.4g}} s<extra>{name}</extra>"
            some = [at[k] for k in mine], [times[k] for k in mine]
            data.append(marks(name, some, color, symbol=symbol, size=5, customdata=stamps, hovertemplate=hover))
    layout: dict[str, Any] = {
        "xaxis": axis("time since the first pair, s"),
        "yaxis": axis(f"{clock} per call, s", rangemode="tozero"),
    }
    if any(peak is not None for peak in peaks):
        data.append(line("peak memory", (at, scaled(peaks, 1 / MIB)), "@three", yaxis="y2"))
        layout["grid"] = {"rows": 2, "columns": 1, "pattern": "coupled", "ygap": 0.14}
        layout["yaxis2"] = axis("peak memory, MiB")
    block = series.get("slowest_of", 1)
    caption = "Each call in turn; memory: resident." if block == 1 else f"The slowest of every {block} calls."
    return Plot(f"{kind}-timeline", f"Time and memory by call: {kind}", caption, data, layout, height=440, width=width)
