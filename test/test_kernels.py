"""Kernels are loaded before the first timed call; signals are deferred until then."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from numba.core import event

from helpers import ROOT
from sfr_loc_map import kernels
from sfr_loc_map.child_process import child_environment
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.kernels import load_kernels

Part = Callable[[Callable[[], object]], None]


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch) -> Part:
    """Let `tiny` be the one part; the process that compiles does not know it."""
    return lambda load: monkeypatch.setattr(kernels, "PARTS", {"tiny": load})


def run_python(*words: str, **environment: str) -> str:
    command = [sys.executable, *words]
    run = subprocess.run(command, env=child_environment() | environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_an_exception_after_kernels_are_loaded_not_within(part: Part, number: signal.Signals) -> None:
    """In the callback from C that loads a kernel an exception would be discarded, and the kernel not be loaded."""
    done: list[str] = []
    part(lambda: (os.kill(os.getpid(), number), done.append("loaded")))

    def interrupt(received: int, _: object) -> None:
        done.append(signal.Signals(received).name)
        raise KeyboardInterrupt

    before = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            load_kernels("tiny", done.append)
        assert done == ["loaded", number.name]
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)


NOTHING_LEFT = """
import sys
from pathlib import Path
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.kernels import PARTS
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.score_run import score_files

def signatures():
    modules = [module for name, module in sys.modules.items() if name.startswith("sfr_loc_map")]
    found = [value for module in modules for value in vars(module).values() if hasattr(value, "nopython_signatures")]
    return {kernel.py_func.__qualname__: len(kernel.signatures) for kernel in found}

for part in ("mapping",):
    PARTS[part]()
before = signatures()
source, truth, late = map(Path, sys.argv[1:])
run_mapper(open_source(source).nav, MappingConfig())
for estimate in (truth, late):
    score_files(ScoreInputs.of(estimate, truth), ScoreConfig())
after = signatures()
assert after == before, {name: count for name, count in after.items() if count != before.get(name)}
"""


@pytest.mark.slow
def test_maps_and_scores_of_the_sample_find_all_kernels_loaded(tmp_path: Path) -> None:
    sample = ROOT / "sample" / "sample.mcap"
    loc = open_source(sample).loc
    paths = tmp_path / "truth.csv", tmp_path / "late.csv"
    for path, late_ns in zip(paths, (0, 5_000_000), strict=True):  # the second lies between the true stamps
        save_trajectory(path, replace(loc.ground_truth, stamps_ns=loc.ground_truth.stamps_ns + late_ns))
    run_python("-c", NOTHING_LEFT, str(sample), *map(str, paths))


def test_the_number_of_a_kernel_never_exceeds_how_many_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Functions of libraries are compiled meanwhile, too."""
    monkeypatch.setattr(kernels, "PERIOD_S", 0.0)
    lines: list[str] = []
    compiled = [*kernels.KERNELS, *(object() for _ in range(5))]
    with kernels.announce_compilation(lines.append):
        for kernel in compiled:
            event.start_event(kernels.COMPILE, data={"dispatcher": kernel})
    counted = [tuple(map(int, found)) for line in lines for found in re.findall(r"kernel (\d+) of at most (\d+)", line)]
    assert len(counted) == len(compiled) - 1
    assert all(number <= most for number, most in counted)
    assert lines[-1].startswith(f"{len(kernels.KERNELS)} kernels compiled in")
