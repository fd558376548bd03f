"""A pass of a benchmark: one method processes all pairs of a source."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isnan
from typing import Generic

import numpy as np

from sfr_loc_map.bench.figure_rows import MEMORY, TIME, FigureRow
from sfr_loc_map.bench.trials import Item, Opened, Result, Trial
from sfr_loc_map.errors import MethodError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import Method
from sfr_loc_map.tables.model import MIB, MILLISECOND, Column


@dataclass(frozen=True, slots=True, eq=False)
class PassResult(Generic[Result]):
    """Calls and results of one method in one pass."""

    version: str
    idle_bytes: int | None  #: Resident memory after warm-up; None if unknown.
    calls: Sequence[MethodCall]
    results: Sequence[Result]

    def costs(self) -> Iterator[FigureRow]:
        """Yield times and memory of the calls. A call that did not return has no time."""
        times_s = [None if isnan(call.usage.processing_time_s) else call.usage.processing_time_s for call in self.calls]
        known_s = [time_s for time_s in times_s if time_s is not None]
        p50, p95 = np.percentile(known_s, (50.0, 95.0)).tolist() if known_s else (None, None)
        yield FigureRow((TIME, "p50"), p50, Column("p50", MILLISECOND))
        yield FigureRow((TIME, "p95"), p95, Column("p95", MILLISECOND))
        yield FigureRow((TIME, "max"), max(known_s, default=None), Column("max", MILLISECOND))
        yield FigureRow((TIME, "first"), times_s[0] if times_s else None)
        peaks = [call.usage.peak_rss_bytes for call in self.calls if call.usage.peak_rss_bytes is not None]
        yield FigureRow((MEMORY, "peak"), max(peaks, default=None), Column("peak", MIB))
        yield FigureRow((MEMORY, "idle"), self.idle_bytes)
        yield FigureRow(("calls",), len(times_s))
        yield FigureRow(("calls_without_time",), len(times_s) - len(known_s))


def run_pass(
    method: Method, trial: Trial[Item, Opened, Result], progress: Callable[[], None] = lambda: None
) -> PassResult[Result]:
    """Process all pairs with a method; raise MethodError if the process does not start or has ended.

    The method receives the pairs at the rate of their stamps if the trial is paced, otherwise as fast as it answers.
    """
    calls: list[MethodCall] = []
    results: list[Result] = []
    with checked_clock(), trial.open(method) as opened:
        is_paced = trial.is_paced(method)
        begin_s, first_ns = time.monotonic(), None
        for stamp_ns, item in trial.items():
            first_ns = stamp_ns if first_ns is None else first_ns
            if is_paced:
                since_start_s = (stamp_ns - first_ns) / NS_PER_S / trial.rate_scale
                time.sleep(max(0.0, begin_s + since_start_s - time.monotonic()))
            result, call = trial.call(opened, item)
            if not opened.is_running:
                raise MethodError(f"method {method.name}: {call.finding}")
            calls.append(call)
            results.append(result)
            progress()
        return PassResult(opened.record.version or "", opened.idle_bytes, calls, results)
