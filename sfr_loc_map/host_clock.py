"""Whether the clock of this process, by which calls are measured, runs as that of the kernel."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfr_loc_map.errors import MetricsError

UPTIME = Path("/proc/uptime")  #: Seconds since the start of the host, as the kernel writes them, in steps of 10 ms.
MOST_S, MOST_SHARE = 0.1, 0.01
"""Largest difference between both clocks over a run: a few steps of the kernel's file, and a share of the run."""


@contextmanager
def checked_clock() -> Iterator[None]:
    """Compare the clock of this process with the kernel's over the `with` block; raise MetricsError if they differ.

    A library that is loaded before all others (LD_PRELOAD) can slow the clock of a process and of all its children, so
    that every time is too short. The kernel's file is not read by that clock. Without the file nothing is compared.
    """
    begin_s = time.monotonic()
    kernel_begin_s = kernel_s()
    yield
    passed_s = time.monotonic() - begin_s
    kernel_end_s = kernel_s()
    if kernel_begin_s is None or kernel_end_s is None:
        return
    kernel_passed_s = kernel_end_s - kernel_begin_s
    if abs(passed_s - kernel_passed_s) > MOST_S + MOST_SHARE * kernel_passed_s:
        raise MetricsError(
            f"times cannot be measured: {passed_s:.2f} s passed by the clock of this process and {kernel_passed_s:.2f} "
            "s by the kernel's; unset LD_PRELOAD, keep the host awake, and run again"
        )


def kernel_s() -> float | None:
    """Return the seconds since the start of the host by the kernel, None where it does not report them."""
    with suppress(OSError, ValueError):
        return float(UPTIME.read_text(encoding="ascii").split()[0])
    return None
