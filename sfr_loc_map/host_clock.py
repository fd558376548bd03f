"""Comparison of the clock of this process, which measures calls, with the clock of the kernel."""

from __future__ import annotations

import ctypes
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfr_loc_map.errors import MetricsError

UPTIME = Path("/proc/uptime")  #: Seconds since the start of the host, written by the kernel in steps of 10 ms.
SYSTEM_CALLS = {"x86_64": 228, "aarch64": 113}  #: Number of the system call clock_gettime on each processor.
MONOTONIC = 1  #: Number of the monotonic clock in that system call.
_LIBRARY = ctypes.CDLL(None) if sys.platform.startswith("linux") else None
MOST_S, MOST_SHARE = 0.1, 0.01
"""Maximum difference between the two clocks over a run: ten steps of /proc/uptime (10 ms each) plus 1 % of the run."""


@contextmanager
def checked_clock() -> Iterator[None]:
    """Compare the clock of this process with the kernel's over the `with` block; raise MetricsError if they differ.

    A preloaded library (LD_PRELOAD) can slow the clock of a process and of all its children, which makes every measured
    time too short. The kernel's file does not depend on that clock. Without the file, nothing is compared.
    """
    begin_s = time.monotonic()
    kernel_begin_s = kernel_s()
    yield
    passed_s = time.monotonic() - begin_s
    kernel_end_s = kernel_s()
    if kernel_begin_s is not None and kernel_end_s is not None:
        check_passed(passed_s, kernel_end_s - kernel_begin_s)


def check_passed(passed_s: float, kernel_passed_s: float) -> None:
    """Raise MetricsError if the elapsed time of this process's clock differs from that of the kernel's clock."""
    if abs(passed_s - kernel_passed_s) > MOST_S + MOST_SHARE * kernel_passed_s:
        raise MetricsError(
            f"times cannot be measured: {passed_s:.2f} s passed by the clock of this process and {kernel_passed_s:.2f} "
            "s by the kernel's; unset LD_PRELOAD, keep the host awake, and run again"
        )


class CallClock:
    """Measures the durations of calls with the clock of this process, and compares their sum with the kernel's clock.

    A comparison over the complete run would miss a library that slows the clock in calls and corrects it between them.
    """

    def __init__(self) -> None:
        self._passed_s = self._kernel_passed_s = 0.0

    def begin(self) -> None:
        """Begin a call."""
        self._kernel_begin_s = system_call_s()
        self._begin_s = time.monotonic()

    def end(self) -> float:
        """Return the seconds since the call began; raise MetricsError if the clocks differ over all calls."""
        seconds = time.monotonic() - self._begin_s
        kernel_end_s = system_call_s()
        if self._kernel_begin_s is not None and kernel_end_s is not None:
            self._passed_s += seconds
            self._kernel_passed_s += kernel_end_s - self._kernel_begin_s
            check_passed(self._passed_s, self._kernel_passed_s)
        return seconds


class _Time(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_int64), ("tv_nsec", ctypes.c_int64))


def system_call_s() -> float | None:
    """Return the seconds of the monotonic clock by a system call; None if the call's number is unknown.

    A preloaded library usually replaces only the library function of the clock. A library that also replaces `syscall`
    must be written for that purpose.
    """
    number = SYSTEM_CALLS.get(platform.machine()) if sys.platform.startswith("linux") else None
    now = _Time()
    if number is None or _LIBRARY is None or _LIBRARY.syscall(number, MONOTONIC, ctypes.byref(now)) != 0:
        return None
    return float(now.tv_sec) + 1e-9 * float(now.tv_nsec)


def kernel_s() -> float | None:
    """Return the kernel's seconds since the start of the host; None if the kernel does not report them."""
    with suppress(OSError, ValueError):
        return float(UPTIME.read_text(encoding="ascii").split()[0])
    return None
