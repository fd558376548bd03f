import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from types import FrameType
from typing import cast

import numpy as np
import pytest
from numba import njit

from sfr_loc_map.child_process import child_environment
from sfr_loc_map.pipeline.kernels import PARTS, announce_compilation, load_kernels


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


def test_kernels_are_loaded_without_what_only_the_compiler_needs() -> None:
    """A kernel that calls `.all()`, or numpy's linear algebra, refers to that; a start would import it, and SciPy.

    Nor is the library of the bags loaded where there is no bag.
    """
    unneeded = {"scipy.linalg", "numba.np.linalg", "numba.np.arraymath", "rosbags"}
    program = (
        "import sys\nfrom sfr_loc_map.io import registry\nfrom sfr_loc_map.pipeline import scoring\n"
        "from sfr_loc_map.pipeline import kernels\n"
        "for part in kernels.PARTS: kernels.load_kernels(part)\n"
        f"print(*{unneeded} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", program], env=child_environment(), capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "\n", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_an_exception_after_kernels_are_loaded_not_within(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """In the callback from C that loads a kernel an exception would be discarded, and the kernel not be loaded."""
    done: list[str] = []

    def part() -> None:
        os.kill(os.getpid(), number)
        done.append("loaded")

    def interrupt(received: int, frame: FrameType | None) -> None:
        done.append(signal.Signals(received).name)
        raise KeyboardInterrupt

    monkeypatch.setitem(cast(dict[str, Callable[[], None]], PARTS), "tiny", part)
    before = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            load_kernels("tiny", done.append)
        assert done == ["loaded", number.name]
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)


def test_nobody_waits_for_kernels_that_are_wanted_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that a signal has shut down: the compiling process may have had the signal too, and ends first."""
    kernel = njit(lambda x: x + 8)
    monkeypatch.setitem(cast(dict[str, Callable[[], None]], PARTS), "tiny", lambda: kernel(np.float64(1.0)))
    lines: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        load_kernels("tiny", lines.append, lambda: False)
    assert (lines, kernel.signatures) == ([], [])
