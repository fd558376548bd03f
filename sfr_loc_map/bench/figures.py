"""Figures of repeated runs: medians, ratios, growth with size."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from sfr_loc_map import __version__

SCHEMA = "sfr-bench/1"
CLOCK = "host monotonic"
MEMORY = (
    "kernel high-water mark of the process' resident memory (VmHWM), set back before each call; largest of all calls"
)

Figures = dict[str, Any]


def cost_figures(seconds: Sequence[float], peaks: Sequence[int | None], idle_bytes: int | None) -> Figures:
    """Return the costs of the calls of one run: times (the first one apart as well) and memory."""
    times = np.asarray(seconds, np.float64)
    known = [peak for peak in peaks if peak is not None]
    quantiles = np.percentile(times, (50.0, 95.0)).tolist() if len(times) else [None, None]
    return {
        "time_s": {
            "p50": quantiles[0],
            "p95": quantiles[1],
            "max": float(times.max()) if len(times) else None,
            "first": float(times[0]) if len(times) else None,
        },
        "memory_bytes": {"peak": max(known, default=None), "idle": idle_bytes},
        "calls": len(times),
    }


def median(runs: Sequence[Mapping[str, Any]]) -> Figures:
    """Return for each figure the median of the runs that have it; text is the first run's."""
    figures: Figures = {}
    for name in dict.fromkeys(name for run in runs for name in run):
        values = [run[name] for run in runs if run.get(name) is not None]
        if values and isinstance(values[0], Mapping):
            figures[name] = median(values)
        elif values and isinstance(values[0], (int, float)):
            figures[name] = float(np.median(values))
        else:
            figures[name] = values[0] if values else None
    return figures


def ratios(ours: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    """Return the size of ours over the other's for each number that both have; None where the other's is 0."""
    found: Figures = {}
    for name in ours:
        a, b = ours[name], other.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found[name] = ratios(a, b)
        elif isinstance(a, (int, float)) and isinstance(b, (int, float)):
            found[name] = abs(a / b) if b else None
    return found


def growth(work: Sequence[int], seconds: Sequence[float]) -> float | None:
    """Return the exponent with which time grows with the work (a line through the logarithms)."""
    if len(set(work)) < 2:
        return None
    return float(np.polyfit(np.log(work), np.log(seconds), 1)[0])


def growths(sizes: Sequence[Mapping[str, Any]]) -> Figures:
    """Return the exponent of the median time of each peer that ran at every size.

    The work is the number of pixels, times that of the disparities searched where a size says so.
    """
    names = [name for name in sizes[0]["entries"] if all(name in size["entries"] for size in sizes)]
    work = [size["width"] * size["height"] * size.get("disparities", 1) for size in sizes]
    return {name: growth(work, [size["entries"][name]["time_s"]["p50"] for size in sizes]) for name in names}


def compared(entries: Mapping[str, Mapping[str, Any]], ours: str, parts: Sequence[str]) -> Figures:
    """Return the ratios of ours to every other entry over some of their parts."""
    mine = {part: entries[ours].get(part, {}) for part in parts}
    return {name: ratios(mine, item) for name, item in entries.items() if name != ours}


def provenance() -> Figures:
    """Return version, host and time of a bench."""
    return {
        "version": __version__,
        "clock": CLOCK,
        "memory_method": MEMORY,
        "host": {
            "machine": platform.machine(),
            "system": platform.system(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "load_at_start": os.getloadavg()[0],
        },
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }
