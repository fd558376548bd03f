"""Compile every kernel as after an installation, and print a table of them: seconds of each, and specialisations.

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
    from sfr_loc_map.pipeline.kernels import COMPILE, PARTS

    seconds: dict[tuple[str, str], float] = defaultdict(float)
    count: dict[tuple[str, str], int] = defaultdict(int)
    for part in parts or PARTS:
        open_kernels: list[list[float]] = []  # begin, seconds of those within

        class Times(event.Listener):
            def on_start(self, event: event.Event) -> None:
                if event.data["dispatcher"] not in KERNELS:
                    return
                open_kernels.append([time.perf_counter(), 0.0])  # noqa: B023

            def on_end(self, event: event.Event) -> None:
                if event.data["dispatcher"] not in KERNELS:
                    return
                begin, within = open_kernels.pop()  # noqa: B023
                took = time.perf_counter() - begin
                if open_kernels:  # noqa: B023
                    open_kernels[-1][1] += took  # noqa: B023
                key = part, event.data["dispatcher"].py_func.__qualname__  # noqa: B023
                seconds[key] += took - within
                count[key] += 1

        with event.install_listener(COMPILE, Times()):
            PARTS[part]()
    print("| part | kernel | specialisations | seconds |\n|---|---|---|---|")
    for key in sorted(seconds, key=seconds.__getitem__, reverse=True):
        print(f"| {key[0]} | `{key[1]}` | {count[key]} | {seconds[key]:.2f} |")
    print(f"| all | {len(seconds)} | {sum(count.values())} | {sum(seconds.values()):.1f} |")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # read when numba is imported
        main(sys.argv[1:])
