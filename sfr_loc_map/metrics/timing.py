"""Summary of the times of calls [4.2.1]."""

from __future__ import annotations

from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.statistics import summary

HOST_CLOCK = "host monotonic"
HISTOGRAM_BINS = 40
SERIES_ROWS = 2000


def timing_summary(seconds: FloatArray, clock: str = HOST_CLOCK) -> dict[str, Any]:
    """Return the figures of all calls, the first apart as well, since it may load or compile.

    Args:
        seconds: `(N,)` seconds of each call in order; NaN (not measured) is left out.
        clock: Clock they were measured with; a host time is never shown under another name.
    """
    known = seconds[np.isfinite(seconds)]
    figures: dict[str, Any] = summary(known)
    figures["p99"] = float(np.percentile(known, 99.0)) if len(known) else None
    figures["max"] = float(known.max()) if len(known) else None
    figures["first"] = float(known[0]) if len(known) else None
    figures["max_after_first"] = float(known[1:].max()) if len(known) > 1 else None
    return figures | {"clock": clock}


def timing_histogram(seconds: FloatArray) -> dict[str, Any]:
    """Return a histogram of the times with logarithmic bins: edges in seconds (one more than counts) and counts."""
    known = seconds[np.isfinite(seconds) & (seconds > 0)]
    if not len(known):
        return {"edges_s": [], "counts": []}
    low, high = float(known.min()), float(known.max())
    edges = np.geomspace(low, max(high, low * 1.01) * (1 + 1e-9), HISTOGRAM_BINS + 1)
    edges[0] = low
    return {"edges_s": edges.tolist(), "counts": np.histogram(known, edges)[0].tolist()}
