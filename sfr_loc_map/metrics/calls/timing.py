"""Figures of the times of calls [4.2.1]."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.records.score_details import CallHistogram
from sfr_loc_map.metrics.score import CallScore, StageTime
from sfr_loc_map.metrics.statistics.running_statistics import integers, sample_statistic

HOST_CLOCK = "host monotonic"
HISTOGRAM_BINS = 40


def call_score(seconds: FloatArray, clock: str, stages: Mapping[str, StageTime] | None = None) -> CallScore:
    """Return the figures of all calls, the first apart as well, since it may load or compile.

    Args:
        seconds: `(N,)` seconds of each call in order; NaN (not measured) is left out.
        clock: Clock they were measured with; a host time is never shown under another name.
        stages: Times of the stages of the calls.
    """
    known = seconds[np.isfinite(seconds)]
    plain = sample_statistic(known)
    return CallScore(
        count=plain.count,
        mean=plain.mean,
        sigma=plain.sigma,
        mean_plus_3sigma=plain.mean_plus_3sigma,
        p50=plain.p50,
        p95=plain.p95,
        p99=float(np.percentile(known, 99.0)) if len(known) else None,
        max=float(known.max()) if len(known) else None,
        first=float(known[0]) if len(known) else None,
        max_after_first=float(known[1:].max()) if len(known) > 1 else None,
        clock=clock,
        stages=stages or {},
    )


def stage_time(seconds: FloatArray) -> StageTime | None:
    """Return the figures of one stage over the calls that had it; None if none had."""
    known = seconds[np.isfinite(seconds)]
    if not len(known):
        return None
    plain = sample_statistic(known)
    return StageTime(
        count=plain.count,
        mean=plain.mean,
        sigma=plain.sigma,
        mean_plus_3sigma=plain.mean_plus_3sigma,
        p50=plain.p50,
        p95=plain.p95,
        max=float(known.max()),
    )


def call_histogram(seconds: FloatArray) -> CallHistogram:
    """Return a histogram of the times with logarithmic bins."""
    known = seconds[np.isfinite(seconds) & (seconds > 0)]
    if not len(known):
        return CallHistogram(edges_s=(), counts=())
    low, high = float(known.min()), float(known.max())
    edges = np.geomspace(low, max(high, low * 1.01) * (1 + 1e-9), HISTOGRAM_BINS + 1)
    edges[0] = low
    return CallHistogram(edges_s=tuple(edges.tolist()), counts=integers(np.histogram(known, edges)[0]))
