"""Compile every kernel as after an installation, and print a table: processor time of each, s, and specialisations.

    PYTHONPATH=. python tools/kernel_times.py [PART...]

The compiled code goes to a temporary folder. A kernel that is compiled for another one is not counted in its seconds,
what numba compiles of its own for it is.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import defaultdict


def main(parts: list[str]) -> None:
    """Print a row per kernel of some parts, the slowest first."""
    from numba.core import event

    from sfr_loc_map.jit import KERNELS
    from sfr_loc_map.kernels import COMPILE, PARTS

    seconds: dict[tuple[str, str], float] = defaultdict(float)
    count: dict[tuple[str, str], int] = defaultdict(int)

    class Times(event.Listener):
        part = ""

        def __init__(self) -> None:
            self.begun: list[list[float]] = []  # of the kernels in work: begin, seconds of those within

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
        for times.part in parts or PARTS:
            PARTS[times.part]()
    print("| part | kernel | specialisations | seconds |\n|---|---|---|---|")
    for key in sorted(seconds, key=seconds.__getitem__, reverse=True):
        print(f"| {key[0]} | `{key[1]}` | {count[key]} | {seconds[key]:.2f} |")
    print(f"| all | {len(seconds)} | {sum(count.values())} | {sum(seconds.values()):.1f} |")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # read when numba is imported
        main(sys.argv[1:])
