"""Plot of the time and memory of each call."""

from __future__ import annotations

from typing import Any

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.limit_lines import error_axis, limit_lines
from sfr_loc_map.report.notes import HOST
from sfr_loc_map.report.plots import STATES, Plot, Trace, axis, line, marks, scaled
from sfr_loc_map.report.plotted_data import limits_on
from sfr_loc_map.tables.model import MIB


def timeline(score: Score, kind: CallKind) -> list[Plot]:
    """Return the plot of the calls of a kind over time; empty for fewer than two calls."""
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
    data += limit_lines(limits, ends)
    layout: dict[str, Any] = {
        "xaxis": axis("time since the first pair, s"),
        "yaxis": error_axis(f"{clock} per call, s", series.processing_time_s, [limit.value for limit in limits]),
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
    row = score.figure(kind, part=None)
    count = "" if row is None else f", n = {row.n}"
    caption = (
        f"One mark per call{count}; resident memory." if block == 1 else f"The slowest of every {block} calls{count}."
    )
    title = f"Time and memory by call: {kind.words}"
    return [Plot(f"{kind}-timeline", title, caption, data, layout, height=440, width="full")]
