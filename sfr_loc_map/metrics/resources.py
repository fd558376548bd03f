"""Wall-clock time and peak memory of one call of the processing API [4.2.1, 4.2.2].

Memory: before the call the kernel's high-water mark of the process' resident memory is set back to what is resident
now (`5` written to `/proc/self/clear_refs`), after it the mark is read (`VmHWM` in `/proc/self/status`). So the peak is
the kernel's own, and nothing between two samples can be missed. It is of the whole process, all threads together. It
resolves pages (4 KiB) up to the kernel's per-thread counters, some hundred KiB. Memory "above the idle process" is the
peak less what was resident when the meter was made or told so (`mark_idle`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

METHOD = "kernel high-water mark of resident memory (VmHWM), set back before each call"
METHOD_UNAVAILABLE = "not measured: this system has no resettable high-water mark (/proc/self/clear_refs)"
_STATUS = "/proc/self/status"
_CLEAR = "/proc/self/clear_refs"


@dataclass(slots=True)
class CallUsage:
    """What one call took.

    Attributes:
        processing_time_s: Wall-clock seconds from the call to its return.
        peak_rss_bytes: Peak resident memory of the process during the call; None where it cannot be measured.
        above_idle_bytes: The same above the idle process.
    """

    processing_time_s: float = 0.0
    peak_rss_bytes: int | None = None
    above_idle_bytes: int | None = None


class CallMeter:
    """Measures calls, one at a time.

    Attributes:
        clock: Name of the clock, as it stands beside the figures.
        method: How memory is measured.
    """

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns, clock: str = "host monotonic") -> None:
        """Take the present resident memory as that of the idle process.

        Args:
            clock_ns: Clock that goes forward, nanoseconds.
            clock: Its name.
        """
        self.clock = clock
        self._clock_ns = clock_ns
        self._available = _can_reset()
        self.method = METHOD if self._available else METHOD_UNAVAILABLE
        self._idle = 0
        self.mark_idle()

    def mark_idle(self) -> None:
        """Take the present resident memory as that of the idle process (after start and warm-up)."""
        self._idle = _status_bytes(b"VmRSS:") if self._available else 0

    @contextmanager
    def measure(self) -> Iterator[CallUsage]:
        """Measure what is done in the `with` block; the usage is filled in at its end, an error passes through."""
        usage = CallUsage()
        if self._available:
            _reset_peak()
        begin = self._clock_ns()
        try:
            yield usage
        finally:
            usage.processing_time_s = (self._clock_ns() - begin) * 1e-9
            if self._available:
                usage.peak_rss_bytes = _status_bytes(b"VmHWM:")
                usage.above_idle_bytes = max(usage.peak_rss_bytes - self._idle, 0)


def _can_reset() -> bool:
    try:
        _reset_peak()
        return _status_bytes(b"VmHWM:") > 0
    except OSError:
        return False


def _reset_peak() -> None:
    handle = os.open(_CLEAR, os.O_WRONLY)
    try:
        os.write(handle, b"5")
    finally:
        os.close(handle)


def _status_bytes(key: bytes) -> int:
    with open(_STATUS, "rb", buffering=0) as stream:
        text = stream.read(8192)
    at = text.find(key)
    return 0 if at < 0 else int(text[at + len(key) : text.index(b"kB", at)]) * 1024
