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


def calls(path: Path, rows: range, lost: range = range(0), seconds: float = 0.01) -> Path:
    """Write calls of the poses of some rows, of which some are lost."""
    lines = [f"{row * PERIOD_NS},{seconds},{'lost' if row in lost else 'tracking'},1000" for row in rows]
    path.write_text("\n".join(["stamp_ns,processing_time_s,state,peak_rss_bytes", *lines]) + "\n")
    return path


def test_a_limit_on_lost_poses_needs_their_states(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """Without a call of every pose the lost ones are unknown; those of several files count together."""
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", "lost_max_share": 0.0}]})
    first = calls(tmp_path / "first.csv", range(50))
    second, good = (
        calls(tmp_path / name, range(50, COUNT), lost)
        for name, lost in (("2.csv", range(90, 100)), ("3.csv", range(0)))
    )
    for stats, code in (([], 3), ([first], 3), ([first, second], 1), ([first, second, good], 1), ([first, good], 0)):
        options = [option for path in stats for option in ("--stats", path)]
        assert sfr("score", *files, "--limits", rules, *options).code == code, stats


def test_times_of_several_files_are_those_of_one_run(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """A run in two files passes; the file of a second run does not take the place of the slow first one."""
    rules = limits(tmp_path, {"timing": {"localisation_max_s": 1.0}})
    parts = [calls(tmp_path / "1.csv", range(50)), calls(tmp_path / "2.csv", range(50, COUNT))]
    slow, fast = calls(tmp_path / "slow.csv", range(COUNT), seconds=9.5), calls(tmp_path / "fast.csv", range(COUNT))
    for stats, code in ((parts, 0), ([slow, fast], 1), ([fast, slow], 1), ([fast, parts[0]], 3)):
        options = [option for path in stats for option in ("--stats", path)]
        assert sfr("score", *files, "--limits", rules, *options).code == code, stats
