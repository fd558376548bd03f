"""Misbehaving methods, by the commands: they do not pass, and those that search for the ground truth do not open it.

`campaigns.misbehaviour.CASES` is the table; `make misbehaviour` runs the cases that are not run daily, too. The
answers of a library, each with its message, are in `test_faulty_candidates.py`.
"""

from __future__ import annotations

import csv
import hashlib
import json
import tempfile
from pathlib import Path

import pytest
import yaml

from campaigns.misbehaviour import CASES, Case, differences, run_case
from helpers import HELPERS
from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from sfr_loc_map.methods.isolation import SETTINGS

DAILY = [case for case in CASES if case.daily]


@pytest.mark.clause("4.2.1", "4.2.2")
@pytest.mark.parametrize("case", DAILY, ids=[case.config.replace(" ", "-") for case in DAILY])
def test_what_misbehaves_is_named_and_does_not_pass(
    case: Case, tmp_path: Path, sfr: Sfr, faulty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in SETTINGS:  # which would be part of the hash of the configuration
        monkeypatch.delenv(name, raising=False)
    outcome = run_case(case, tmp_path, sfr, faulty)
    assert not differences(case, outcome), outcome.said
    if case.kind == "class":
        method, config = outcome.score["method"], (tmp_path / "config.txt").read_bytes()
        assert method["isolation"].startswith("files, TCP, sockets, IPC")
        assert method["config_sha256"] == hashlib.sha256(config).hexdigest()


def test_shared_memory_of_other_methods_is_shut_off(drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    """Methods of a suite that run at the same time have their images and results there."""
    code, config, stats = (tmp_path / name for name in ("candidate.py", "config.txt", "stats.csv"))
    code.write_text((HELPERS / "misbehaving_class.py").read_text())
    with tempfile.TemporaryDirectory(prefix="sfr_method_", dir="/dev/shm") as other:
        result = Path(other) / "result"
        result.write_text("theirs")
        config.write_text(f"others\n{result}")
        method = ("--method", f"{code}:Misbehaving", "--config", config)
        ran = sfr("localise", drive, "-o", tmp_path / "e.csv", "--stats", stats, "--start", "truth", *method)
        assert ran.code == 0, ran.err
        assert result.read_text() == "theirs"
    with stats.open(newline="") as stream:
        assert {float(row["opened"]) for row in csv.DictReader(stream)} == {0.0}


def test_a_crashing_class_fails_a_suite(tmp_path: Path, sfr: Sfr, scheduler: str) -> None:
    """Its limits are met; ours beside it passes."""
    source = write_folder(tmp_path / "source", 12, 0)
    method = f"{HELPERS / 'aborting_class.py'}:Aborting"
    suite = {
        "sources": [str(source)],
        "configurations": {"ours": {}, "crashing": {"localisation": {"method": method}}},
        "conditions": ["frames=3"],
        "spacing": 1,
        "limits": {
            "trajectory": [{"condition": "frames=3", "position_mean_plus_3sigma_m": 1e3, "lost_max_share": 1.0}]
        },
    }
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(suite))
    words = ("--out", tmp_path / "out", "--scheduler", scheduler, "--json", "-")
    ran = sfr("suite", "run", tmp_path / "suite.yaml", *words)
    summary = json.loads(ran.out)
    found = {
        group["configuration"]: [item["name"] for item in group["verdicts"] if item["verdict"] == "fail"]
        for group in summary["groups"]
    }
    assert (ran.code, summary["verdict"], found) == (1, "fail", {"ours": [], "crashing": ["crashed_calls"]})
