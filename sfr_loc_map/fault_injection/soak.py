"""Soak: a long run at the highest rate, and the growth of memory."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import Harness

WARM_UP_SHARE = 1.0 / 3.0
"""Share of the soak before memory is judged: buffers fill, the allocator reaches its size."""
PAIRS_PER_MAP = 50
NOMINAL_HZ = 10.0
JUDGED_FROM_S = 540.0
"""A shorter run cannot separate slow growth from the warm-up: only a large growth fails it."""
LARGE_MB = 40.0


@dataclass(slots=True)
class MemoryTrend:
    """Resident memory over time."""

    seconds: list[float] = field(default_factory=list)
    mb: list[float] = field(default_factory=list)

    def slope(self) -> tuple[float, float]:
        """Return the slope after the warm-up and its standard error, MB/h, by least squares.

        Neighbouring values are correlated; the error is that of the means of ten equal parts, taken as independent.
        """
        begin = int(len(self.mb) * WARM_UP_SHARE)
        hours, mb = np.array(self.seconds[begin:]) / 3600.0, np.array(self.mb[begin:])
        parts = [part for part in np.array_split(np.arange(len(mb)), 10) if len(part)]
        x = np.array([hours[part].mean() for part in parts])
        y = np.array([mb[part].mean() for part in parts])
        if len(parts) < 4:
            return 0.0, np.inf
        centred = x - x.mean()
        slope = float(centred @ y / (centred @ centred))
        residual = y - y.mean() - slope * centred
        error = float(np.sqrt(residual @ residual / (len(x) - 2) / (centred @ centred)))
        return slope, error

    def failure(self, limit_mb_h: float) -> str:
        """Return why the memory fails, empty if it does not.

        Args:
            limit_mb_h: Largest slope, MB/h; exceeded if the slope lies above it by two standard errors.
        """
        grown = self.mb[-1] - self.mb[int(len(self.mb) * WARM_UP_SHARE)]
        slope, error = self.slope()
        if self.seconds[-1] < JUDGED_FROM_S:
            return f"memory has grown by {grown:.0f} MB after the warm-up" if grown > LARGE_MB else ""
        return (
            f"memory grows by {slope:.1f} MB/h, the limit is {limit_mb_h:g}" if slope - 2 * error > limit_mb_h else ""
        )


def soak(harness: Harness, outcome: Outcome) -> None:
    """Localise in lock step, map after every `PAIRS_PER_MAP` pairs, and sample the memory of each node."""
    trends = {name: MemoryTrend() for name in harness.nodes}
    begin = last_sample = time.monotonic()
    pairs = maps = 0
    seconds = 60.0 * harness.settings.soak_minutes
    while time.monotonic() - begin < seconds:
        harness.localise(PAIRS_PER_MAP)
        harness.map()
        pairs, maps = pairs + PAIRS_PER_MAP, maps + 1
        harness.received.forget()
        harness.rover.forget()
        if time.monotonic() - last_sample >= 0.5:
            last_sample = time.monotonic()
            for name, trend in trends.items():
                trend.seconds.append(last_sample - begin)
                trend.mb.append(harness.memory_mb(name))
    drive_min = pairs / NOMINAL_HZ / 60.0
    outcome.observed.append(f"{seconds / 60:g} min: {pairs} pairs (a drive of {drive_min:.1f} min), {maps} maps")
    for name, trend in trends.items():
        slope, error = trend.slope()
        outcome.observed.append(f"{name} {trend.mb[-1]:.0f} MB, {slope:+.1f} +- {2 * error:.1f} MB/h")
        outcome.figures[name] = {"slope_mb_h": slope, "error_mb_h": error, "mb": trend.mb, "seconds": trend.seconds}
        failure = trend.failure(harness.settings.slope_limit)
        outcome.expect(not failure, f"{name}: {failure}")


FAULTS = (
    Fault(
        "soak",
        "pairs as fast as they are answered, a map after every 50 of them",
        "memory does not grow after the warm-up (judged by its slope from 9 min on)",
        soak,
    ),
)
