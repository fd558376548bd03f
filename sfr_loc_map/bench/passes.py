"""A pass of a benchmark: one method processes all pairs of a source."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from sfr_loc_map.bench.figure_rows import MEMORY, TIME, FigureRow
from sfr_loc_map.bench.trials import Item, Opened, Result, Trial
from sfr_loc_map.errors import MethodError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.methods.method_process import MethodCall
from sfr_loc_map.methods.registry import Method


@dataclass(frozen=True, slots=True, eq=False)
class PassResult(Generic[Result]):
    """Calls and results of one method in one pass."""

    version: str
    idle_bytes: int | None  #: Resident memory after warm-up; None if unknown.
    calls: Sequence[MethodCall]
    results: Sequence[Result]

    def costs(self) -> Iterator[FigureRow]:
        """Yield times and memory of the calls."""
        seconds = [call.usage.processing_time_s for call in self.calls]
        p50, p95 = np.percentile(seconds, (50.0, 95.0)).tolist() if seconds else (None, None)
        yield FigureRow((TIME, "p50"), p50)
        yield FigureRow((TIME, "p95"), p95)
        yield FigureRow((TIME, "max"), max(seconds, default=None))
        yield FigureRow((TIME, "first"), seconds[0] if seconds else None)
        peaks = [call.usage.peak_rss_bytes for call in self.calls if call.usage.peak_rss_bytes is not None]
        yield FigureRow((MEMORY, "peak"), max(peaks, default=None))
        yield FigureRow((MEMORY, "idle"), self.idle_bytes)
        yield FigureRow(("calls",), len(seconds))


def run_pass(
    method: Method, trial: Trial[Item, Opened, Result], progress: Callable[[], None] = lambda: None
) -> PassResult[Result]:
    """Process all pairs with a method; MethodError if the process does not start or has ended.

    A method that works in the background between calls receives the pairs at the rate of their stamps.
    """
    calls: list[MethodCall] = []
    results: list[Result] = []
    with checked_clock(), trial.open(method) as opened:
        rate_scale = trial.rate_scale if method.background else 1.0
        begin_s, first_ns = time.monotonic(), None
        for index, (stamp_ns, item) in enumerate(trial.items()):
            first_ns = stamp_ns if first_ns is None else first_ns
            since_start_s = (stamp_ns - first_ns) / NS_PER_S / rate_scale
            if method.background:
                time.sleep(max(0.0, begin_s + since_start_s - time.monotonic()))
            result, call = trial.call(opened, item, index, since_start_s)
            if not opened.is_alive:
                raise MethodError(f"method {method.name}: {call.finding}")
            calls.append(call)
            results.append(result)
            progress()
        return PassResult(opened.record.version or "", opened.idle_bytes, calls, results)
