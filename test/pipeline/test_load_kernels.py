import itertools
from collections.abc import Callable
from typing import cast

import numpy as np
import pytest
from numba import njit

from sfr_loc_map.pipeline.compile_kernels import PARTS, announce_compilation
from sfr_loc_map.pipeline.load_kernels import load_kernels


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


def test_what_is_not_compiled_is_compiled_beside_and_here_where_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = njit(lambda x: x + 7)
    compiled: list[int] = []

    def tiny() -> None:
        compiled.append(len(kernel.signatures))
        kernel(np.float64(1.0))

    monkeypatch.setitem(cast(dict[str, Callable[[], None]], PARTS), "tiny", tiny)  # the other process has no such part
    lines: list[str] = []
    load_kernels("tiny", lines.append)
    assert compiled == [0, 0]  # refused, then compiled here
    assert "ended with exit code" in lines[0]
    assert lines[-1].startswith("1 kernels compiled in ")
    lines.clear()
    load_kernels("tiny", lines.append)
    assert (compiled, lines) == ([0, 0, 1], [])
