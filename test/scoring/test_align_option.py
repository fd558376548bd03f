"""`sfr score --align`: APE and RPE beside the figures of the specification, which do not change."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sfr_loc_map
from helpers.cli_result import Sfr
from helpers.score_rows import row
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Return an estimate and its truth: a drive in a circle, the estimate 1 m aside and 2 % too large."""
    angle = np.linspace(0.0, 3.0, 60)
    positions = np.column_stack((4 * np.sin(angle), 4 - 4 * np.cos(angle), 0.1 * angle))
    quats = np.column_stack((np.zeros((60, 2)), np.sin(angle / 2), np.cos(angle / 2)))
    truth = Trajectory(10**18 + np.arange(60) * 10**8, positions, quats)
    estimate = replace(truth, positions=1.02 * positions + [0.0, 1.0, 0.0])
    save_trajectory(tmp_path / "estimate.kitti", estimate)
    save_trajectory(tmp_path / "truth.euroc.csv", truth)
    return tmp_path / "estimate.kitti", tmp_path / "truth.euroc.csv"


def test_the_figures_stand_beside_those_of_the_specification(files: tuple[Path, Path], sfr: Sfr) -> None:
    plain = json.loads(sfr("score", *files, "--json", "-").out)
    done = sfr("score", *files, "--align", "sim3", "--lenient", "--json", "-")
    assert done.code == 0, done.err
    assert [line.split(": ")[1].split(",")[0] for line in done.err.splitlines()[:2]] == [
        "KITTI poses of the left camera",
        "EuRoC csv",
    ]
    content = json.loads(done.out)
    ours = [item for item in content["figures"] if item["figure"] not in ("ape", "rpe")]
    assert ours == plain["figures"]
    assert "alignment" not in plain
    ape, how = row(content, "ape", part="translation"), content["alignment"]
    assert (how["align"], how["rpe_delta"], ape["unit"], ape["n"]) == ("sim3", "frames=1", "m", 60)
    assert ape["rmse"] == pytest.approx(0.0, abs=1e-9)
    assert how["scale"] == pytest.approx(1 / 1.02)
    unaligned = json.loads(sfr("score", *files, "--align", "none", "--json", "-").out)
    assert row(unaligned, "ape", part="translation")["p50"] >= 1.0
    assert row(unaligned, "rpe", part="rotation")["unit"] == "deg"
    scored = sfr_loc_map.score(*files, align="none")
    assert row(json.loads(scored.to_json()), "ape") == row(unaligned, "ape")
