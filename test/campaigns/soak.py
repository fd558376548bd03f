"""Memory growth of the nodes in a long run at the highest rate."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from campaigns.node_harness import Harness
from campaigns.own_domain import in_own_domain

WARM_UP_SHARE = 1.0 / 3.0
"""Fraction of a run before memory is evaluated, because buffers and the allocator first have to fill."""
SLOPE_LIMIT_MB_H = 1.0
PAIRS_PER_MAP = 50


@dataclass(slots=True)
class MemoryTrend:
    """Resident memory over time."""

    seconds: list[float] = field(default_factory=list)
    mb: list[float] = field(default_factory=list)

    def slope(self) -> tuple[float, float]:
        """Return the slope after the warm-up and its standard error, MB/h, by least squares.

        Neighbouring values are correlated, so the fit uses the means of ten equal parts, which are assumed to be
        independent.
        """
        begin = int(len(self.mb) * WARM_UP_SHARE)
        hours, mb = np.array(self.seconds[begin:]) / 3600.0, np.array(self.mb[begin:])
        parts = [part for part in np.array_split(np.arange(len(mb)), 10) if len(part)]
        if len(parts) < 4:
            return 0.0, np.inf
        means = np.array([(hours[part].mean(), mb[part].mean()) for part in parts])
        (slope, _), covariance = np.polyfit(*means.T, 1, cov=True)
        return float(slope), float(np.sqrt(covariance[0, 0]))

    def failure(self) -> str:
        """Return the failure; empty unless the slope exceeds the limit by more than two standard errors."""
        slope, error = self.slope()
        grows = slope - 2 * error > SLOPE_LIMIT_MB_H
        return f"memory grows by {slope:.1f} MB/h, the limit is {SLOPE_LIMIT_MB_H:g}" if grows else ""


def soak(folder: Path, minutes: float = 60.0) -> list[str]:
    """Localise in lock step, map after every 50 pairs, and sample the memory of each node; return the failures."""
    begin, trends, pairs, failures = time.monotonic(), defaultdict[str, MemoryTrend](MemoryTrend), 0, []
    with Harness(folder) as harness:
        harness.wait_ready()
        while time.monotonic() - begin < 60.0 * minutes:
            harness.localise(PAIRS_PER_MAP)
            harness.map()
            harness.forget()
            pairs += PAIRS_PER_MAP
            for name in harness.nodes:
                trends[name].seconds.append(time.monotonic() - begin)
                trends[name].mb.append(harness.memory_mb(name))
    print(f"{pairs} pairs, {pairs // PAIRS_PER_MAP} maps")
    for name, trend in trends.items():
        slope, error = trend.slope()
        print(f"{name} {trend.mb[-1]:.0f} MB, {slope:+.1f} +- {2 * error:.1f} MB/h")
        failures += [f"{name}: {failure}"] if (failure := trend.failure()) else []
    return failures


def main(arguments: list[str]) -> int:
    """Run the nodes for `[MINUTES]`, 60 by default."""
    return in_own_domain(lambda folder: soak(folder, *map(float, arguments)))
