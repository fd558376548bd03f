"""A library that slows the clock of a command and of its processes is detected: no times are measured."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from helpers import HELPERS
from helpers.compile_c import compile_c
from helpers.made_scene import write_folder
from helpers.made_suites import SFR

SLOW_CLOCK = """
import time
import numpy as np
real = time.perf_counter
time.perf_counter = lambda: 0.15 * real()

class Slow:
    def __init__(self, rig, config):
        pass

    def process(self, pair):
        time.sleep(0.3)
        return np.eye(4)
"""


@pytest.mark.parametrize(
    ("command", "output", "options"),
    [("localise", "e.csv", ("--start", "truth", "--method", "opencv")), ("map", "c.ply", ("--method", "sgbm"))],
    ids=["localise", "map"],
)
def test_a_slowed_clock_measures_nothing(command: str, output: str, options: tuple[str, ...], tmp_path: Path) -> None:
    library = compile_c(HELPERS / "slow_clock.c", output=tmp_path / "libslow_clock.so")
    source, stats = write_folder(tmp_path / "source", 8, 2), tmp_path / "stats.csv"
    words = ["-o", tmp_path / output, "--stats", stats]
    slowed = os.environ | {"LD_PRELOAD": str(library), "SFR_HINTS": "0"}
    command_line = [*SFR, command, *map(str, [source, *options, *words])]
    ran = subprocess.run(command_line, capture_output=True, text=True, check=False, env=slowed, timeout=100)
    assert ran.returncode == 2, ran.stderr
    assert "sfr: times cannot be measured" in ran.stderr.splitlines()[-1], ran.stderr
    assert not stats.exists()


def test_a_clock_that_is_slowed_in_the_calls_alone_measures_nothing(tmp_path: Path) -> None:
    """The clock of the command is right between the calls, so that the time of the complete run is right."""
    library = compile_c(HELPERS / "repaid_clock.c", output=tmp_path / "librepaid_clock.so")
    source, stats = write_folder(tmp_path / "source", 8, 0), tmp_path / "stats.csv"
    (tmp_path / "candidate.py").write_text(SLOW_CLOCK)
    method = ("--method", f"{tmp_path / 'candidate.py'}:Slow")
    words = ["localise", source, "-o", tmp_path / "e.csv", "--stats", stats, "--start", "truth", *method]
    slowed = os.environ | {"LD_PRELOAD": str(library), "SFR_HINTS": "0"}
    ran = subprocess.run([*SFR, *map(str, words)], capture_output=True, text=True, check=False, env=slowed)
    assert ran.returncode == 2, ran.stderr
    assert ran.stderr.splitlines()[-1].startswith("sfr: times cannot be measured"), ran.stderr
    assert not stats.exists()
