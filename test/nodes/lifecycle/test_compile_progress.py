import itertools

import numpy as np
from numba import njit

from sfr_loc_map.nodes.lifecycle.compile_progress import announce_compilation


def test_what_is_compiled_is_announced_with_progress_and_what_is_there_is_not() -> None:
    kernels = [njit(lambda x, k=k: x + k) for k in range(3)]
    ticks = itertools.count(100.0, 2.0)

    def run() -> list[str]:
        lines: list[str] = []
        with announce_compilation(lines.append, lambda: next(ticks)):
            for kernel in kernels:
                kernel(np.float64(1.0))
        return lines

    first, *progress, last = run()
    assert first == "compiles its kernels, once after an installation: this takes about a minute"
    assert len(progress) == 1  # the clock of this test has gone on by more than 5 s, and not by 10
    assert "kernels compiled, " in progress[0]
    assert last.startswith("3 kernels compiled in ")
    assert run() == []
