"""Time and memory of a method are measured from outside its process: what the process does to its clocks is no way out.

Each method meets its limits by its own words, and misses them by those of the process that asks it.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import HELPERS, ROOT
from helpers.cli_result import Sfr
from helpers.made_suites import SFR
from sfr_loc_map.methods.method_process import is_misstated

Build = Callable[..., Path]


@pytest.mark.clause("4.2.1", "4.2.2")
@pytest.mark.parametrize(
    ("word", "limit", "name", "finding"),
    [
        ("clock", "timing: {localisation_p50_s: 0.2}", "processing_time_s", "misstated"),
        ("lazy", "timing: {localisation_p50_s: 0.2}", "processing_time_s", "misstated"),
        ("lease", "timing: {localisation_p50_s: 0.2}", "processing_time_s", None),
        ("marks", "memory: {localisation_peak_bytes: 200000000}", "above_idle_bytes", None),
        ("files", "memory: {localisation_peak_bytes: 200000000}", "above_idle_bytes", None),
    ],
)
def test_what_a_method_states_of_itself_is_not_believed(
    word: str, limit: str, name: str, finding: str | None, drive: Path, tmp_path: Path, sfr: Sfr
) -> None:
    config, limits = tmp_path / "config.txt", tmp_path / "limits.yaml"
    estimate, stats = tmp_path / "estimate.csv", tmp_path / "stats.csv"
    (tmp_path / "candidate.py").write_text((HELPERS / "misbehaving_class.py").read_text())
    config.write_text(word)
    limits.write_text(limit + "\n")
    method = ("--method", f"{tmp_path / 'candidate.py'}:Misbehaving", "--config", config)
    ran = sfr("localise", drive, "-o", estimate, "--stats", stats, "--start", "truth", *method)
    assert ran.code == (0 if finding is None else 1)
    with stats.open() as stream:
        rows = list(csv.DictReader(stream))
    least = {"clock": 0.4, "lazy": 0.35, "lease": 0.35, "marks": 211e6, "files": 211e6}[word]
    assert all(float(row[name]) >= 0.99 * least for row in rows)
    assert all(float(row["stated_s"]) < 0.4 * float(row["processing_time_s"]) for row in rows if finding)
    if word == "marks":
        assert {float(row["opened"]) for row in rows} == {0.0}  # it cannot set the mark of its memory back
    scored = sfr(
        *("score", estimate, drive, "--stats", stats, "--condition", "frames=3", "--limits", limits, "--json", "-")
    )
    score = json.loads(scored.out)
    assert (scored.code, score["verdict"]) == (1, "fail")
    assert score["method"]["config_sha256"] == hashlib.sha256(word.encode()).hexdigest()
    assert [item["kind"] for item in score.get("findings", [])] == ([] if finding is None else [finding])


@pytest.mark.parametrize("command", ["localise", "map"])
def test_a_slowed_clock_of_the_command_measures_nothing(
    command: str, drive: Path, build: Build, tmp_path: Path
) -> None:
    """A library that slows the clock of the command and of all that it starts gives no times."""
    library = build(HELPERS / "slow_clock.c", name="libslow_clock.so")
    stats = tmp_path / "stats.csv"
    own = {"localise": ("e.csv", "--start", "truth", "--method", "opencv"), "map": ("c.ply", "--method", "sgbm")}
    output, *options = own[command]
    words = [command, drive, "-o", tmp_path / output, "--stats", stats, *options]
    slowed = os.environ | {"LD_PRELOAD": str(library), "PYTHONPATH": str(ROOT), "SFR_HINTS": "0"}
    ran = subprocess.run([*SFR, *map(str, words)], capture_output=True, text=True, check=False, env=slowed)
    assert ran.returncode == 2, ran.stderr
    assert ran.stderr.splitlines()[-1].startswith("sfr: times cannot be measured"), ran.stderr
    assert not stats.exists()


def test_a_transfer_of_the_result_is_no_misstatement() -> None:
    assert not is_misstated(measured_s=0.9, stated_s=0.1, calls=20)  # one delayed call
    assert not is_misstated(measured_s=26.0, stated_s=16.0, calls=20)  # less than half of the calls
    assert not is_misstated(measured_s=2.0, stated_s=0.008, calls=400)  # a fast method in a long drive
    assert is_misstated(measured_s=1.6, stated_s=0.16, calls=20)
    assert is_misstated(measured_s=0.10, stated_s=3.00, calls=20)
