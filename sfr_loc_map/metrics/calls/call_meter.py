"""Time and memory of a call of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2], measured one call at a time.

Before a call, the kernel's high-water mark of the resident memory of the process is reset to the present resident
memory (`5` written to `/proc/self/clear_refs`). After the call the mark is read (`VmHWM` in `/proc/self/status`). The
mark is the kernel's peak over all threads, accurate to a few hundred KiB. Memory "above the idle process" is the peak
minus the resident memory at the construction of the meter, or at the last `mark_idle`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from sfr_loc_map.memory_mark import peak_of, reset_peak
from sfr_loc_map.metrics import formulas

HOST_CLOCK = "host monotonic"
METHOD = "kernel high-water mark of resident memory (VmHWM), reset before each call"
METHOD_UNAVAILABLE = "not measured: this system has no resettable high-water mark (/proc/self/clear_refs)"


@dataclass(slots=True)
class CallUsage:
    """Resources of one call: wall-clock time, peak resident memory, and this peak above the idle process.

    A value is None if unknown.
    """

    processing_time_s: float | None = None
    peak_rss_bytes: int | None = None
    above_idle_bytes: int | None = None


class CallMeter:
    """Measures calls one at a time. `clock` names the clock, `method` the method of measuring memory."""

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns, clock: str = HOST_CLOCK) -> None:
        """Set the reference of the memory above the idle process to the present resident memory."""
        self.clock = clock
        self._clock_ns = clock_ns
        self._available = reset_peak("self") is not None and peak_of("self") is not None
        self.method = METHOD if self._available else METHOD_UNAVAILABLE
        self.mark_idle()

    def mark_idle(self) -> None:
        """Set the reference of the memory above the idle process again, after start and warm-up.

        The reference is unknown if the mark cannot be reset; the memory above the idle process is then None.
        """
        self._idle_bytes = reset_peak("self") if self._available else None

    @contextmanager
    def measure(self) -> Iterator[CallUsage]:
        """Measure the `with` block. The usage is filled in at its end, even if the block raises.

        The memory is None if the mark cannot be reset before the call or read after the call.
        """
        usage = CallUsage()
        is_reset = self._available and reset_peak("self") is not None
        called_ns = self._clock_ns()
        try:
            yield usage
        finally:
            usage.processing_time_s = formulas.call_time_s(called_ns, self._clock_ns())
            usage.peak_rss_bytes = peak_of("self") if is_reset else None
            if usage.peak_rss_bytes is not None and self._idle_bytes is not None:
                usage.above_idle_bytes = formulas.memory_above_idle(usage.peak_rss_bytes, self._idle_bytes)
