"""Files from which an earlier version made a pass that the run had not earned, judged by the commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from helpers.cli_result import Sfr
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.trajectory_file import save_trajectory

PERIOD_NS = 100_000_000
COUNT = 300
POSITION = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.05}]}


def straight(scale: float = 1.0) -> Trajectory:
    positions = np.column_stack((0.1 * scale * np.arange(COUNT), np.zeros((COUNT, 2))))
    return Trajectory(np.arange(COUNT) * PERIOD_NS, positions, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate that is 0.1 % short, and its truth."""
    paths = tmp_path / "estimate.csv", tmp_path / "truth.csv"
    for path, scale in zip(paths, (0.999, 1.0), strict=True):
        save_trajectory(path, straight(scale))
    return paths


def limits(folder: Path, content: object) -> Path:
    path = folder / "limits.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_wrong_poses_with_other_stamps_are_missing(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """No figure contains the error of a pose whose stamp agrees with no truth."""
    rules, drive = limits(tmp_path, POSITION), straight(0.999)
    assert sfr("score", *files, "--limits", rules).code == 0
    is_moved = (np.arange(COUNT) >= 100) & (np.arange(COUNT) < 140)
    away = drive.positions + 2.0 * is_moved[:, None]
    for shift_ns, code in ((0, 1), (3 * PERIOD_NS // 10, 3)):
        moved = replace(drive, positions=away, stamps_ns=drive.stamps_ns + shift_ns * is_moved)
        save_trajectory(files[0], moved)
        assert sfr("score", *files, "--limits", rules).code == code
