"""Compile all kernels as after an installation, and print the processor time, s, and the specialisations of each.

    .venv/bin/python tools/kernel_times.py [PART...]

The compiled code is written to a temporary folder. The time of a kernel excludes other kernels that it calls, but
includes numba's own functions.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import defaultdict


def main(parts: list[str]) -> None:
    """Print a row for each kernel of `parts` (all by default), the slowest first."""
    from numba.core import event

    from sfr_loc_map.jit import KERNELS
    from sfr_loc_map.kernels import COMPILE, PARTS

    seconds: dict[tuple[str, str], float] = defaultdict(float)
    count: dict[tuple[str, str], int] = defaultdict(int)

    class Times(event.Listener):
        """Adds up the time of each kernel of `part`; a kernel may compile further kernels, whose time is their own."""

        def __init__(self) -> None:
            self.part = ""
            self.begun: list[list[float]] = []  # of the kernels being compiled: start, and seconds of nested kernels

        def on_start(self, event: event.Event) -> None:
            if event.data["dispatcher"] in KERNELS:
                self.begun.append([time.process_time(), 0.0])

        def on_end(self, event: event.Event) -> None:
            kernel = event.data["dispatcher"]
            if kernel in KERNELS:
                begin, within = self.begun.pop()
                took = time.process_time() - begin
                if self.begun:
                    self.begun[-1][1] += took
                key = self.part, kernel.py_func.__qualname__
                seconds[key] += took - within
                count[key] += 1

    times = Times()
    with event.install_listener(COMPILE, times):
        for part in parts or PARTS:
            times.part = part
            PARTS[part]()
    print("| part | kernel | specialisations | seconds |\n|---|---|---|---|")
    for key in sorted(seconds, key=seconds.__getitem__, reverse=True):
        print(f"| {key[0]} | `{key[1]}` | {count[key]} | {seconds[key]:.2f} |")
    print(f"| all | {len(seconds)} | {sum(count.values())} | {sum(seconds.values()):.1f} |")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # numba reads this at import
        main(sys.argv[1:])
