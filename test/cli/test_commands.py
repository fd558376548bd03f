"""Behaviour that all commands share: exit codes, output streams, fast help."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.broken_sources import good_folder
from helpers.cli_result import Sfr
from helpers.score_rows import number
from sfr_loc_map.cli.main import PANELS
from sfr_loc_map.errors import ExitCode
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.layouts.image_files import ImageFileSequence
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory

NAMES = [name for names in PANELS.values() for name in names]
HEAVY = ("numba", "cv2", "scipy", "plotly", "rosbags", "rclpy", "llvmlite", "embreex")
HELP = """
import sys
from sfr_loc_map.cli.main import main
for command in sys.argv[1:]:
    sys.argv = ["sfr", *command.split(), "--help"]
    code = main()
    print(code, *(set(%r) & set(sys.modules)), file=sys.stderr)
"""


@pytest.fixture
def trajectories(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate whose errors are known, and its truth: 60 m straight on, the estimate 2 % too long."""
    count = 121
    stamps = np.arange(count, dtype=np.int64) * 1_000_000_000
    positions = np.zeros((count, 3))
    positions[:, 0] = 0.5 * np.arange(count)
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    truth, estimate = tmp_path / "truth.csv", tmp_path / "estimate.csv"
    save_trajectory(truth, Trajectory(stamps, positions, quats))
    save_trajectory(estimate, Trajectory(stamps, 1.02 * positions, quats))
    return estimate, truth


def limits_file(path: Path, position_m: float) -> Path:
    path.write_text(f"trajectory:\n  - condition: distance=5\n    position_mean_plus_3sigma_m: {position_m}\n")
    return path


def strict(text: str) -> Any:
    """Read JSON as the standard has it: no NaN, no Infinity."""

    def refuse(word: str) -> None:
        raise ValueError(word)

    return json.loads(text, parse_constant=refuse)


def test_help_of_every_command_loads_nothing_heavy() -> None:
    commands = ["", *NAMES]
    words = [sys.executable, "-c", HELP % (HEAVY,), *commands]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stderr.splitlines() == ["0"] * len(commands)
    for command in commands:
        assert f"Usage: sfr {command}".strip() in done.stdout


def test_bare_command_and_version(sfr: Sfr) -> None:
    bare = sfr()
    assert (bare.code, bare.err) == (0, "")
    for command in NAMES:
        assert command in bare.out
    version = sfr("--version")
    assert (version.code, version.err) == (0, "")
    assert version.out.startswith("sfr ")


@pytest.mark.parametrize(("limit_m", "code", "verdict"), [(0.2, 0, "pass"), (0.05, 1, "fail")])
def test_verdict_is_the_exit_code(
    sfr: Sfr, tmp_path: Path, trajectories: tuple[Path, Path], limit_m: float, code: int, verdict: str
) -> None:
    limits = limits_file(tmp_path / "limits.yaml", limit_m)
    result = sfr("score", *trajectories, "--limits", limits, "--json", "-")
    assert result.code == code
    assert [item["verdict"] for item in strict(result.out)["verdicts"]] == [verdict]
    lines = [line for line in result.err.splitlines() if not line.startswith("deviation: ")]
    assert len(lines) == code
    if code:
        assert lines[0].startswith("sfr: 1 of 1 limits missed: position error over 5 m, mean + 3 sigma: 1")
    tables = sfr("score", *trajectories, "--limits", limits, "--html", tmp_path / "r.html")
    assert tables.code == code
    assert verdict in tables.out
    assert (tmp_path / "r.html").stat().st_size > 0


def test_from_source_to_score_and_report(sfr: Sfr, tmp_path: Path) -> None:
    source = good_folder(tmp_path / "data")
    trajectory, stats, cloud = tmp_path / "t.tum", tmp_path / "s.csv", tmp_path / "c.npz"
    localised = sfr("localise", source, "-o", trajectory, "--stats", stats, "--start", "truth")
    assert (localised.code, localised.out) == (0, "")
    assert localised.err.strip() == f"3 poses, 0 lost: {trajectory}"
    assert len(read_trajectory_file(trajectory).trajectory) == 3
    mapped = sfr("map", source, "-o", cloud)
    assert (mapped.code, mapped.out) == (0, "")
    assert f"points of 2 pairs: {cloud}" in mapped.err
    fields = np.load(cloud)
    assert set(fields) == {"x", "y", "z", "sigma", "intensity", "u", "v", "pair", "fused", "pair_stamps_ns"}
    score = strict(sfr("score", trajectory, source, "--condition", "frames=1", "--spacing", "1", "--json", "-").out)
    assert number(score, "position", "n") == 2
    assert number(score, "position", "mean") < 0.01
    file = tmp_path / "map.json"
    assert sfr("score", cloud, source, "--json", file).code == 0
    assert number(strict(file.read_text()), "point_error", "p50") < 0.05
    page = sfr("report", file)
    assert page.code == 0
    assert (tmp_path / "report.html").stat().st_size > 0


def test_ctrl_c_keeps_the_pairs_that_were_localised(sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out, stats = good_folder(tmp_path / "data"), tmp_path / "t.csv", tmp_path / "s.csv"
    images = ImageFileSequence.pairs

    def interrupted(after: int) -> None:
        def pairs(sequence: ImageFileSequence) -> Iterator[StereoPair]:
            yield from islice(images(sequence), after)
            raise KeyboardInterrupt

        monkeypatch.setattr(ImageFileSequence, "pairs", pairs)

    interrupted(2)
    result = sfr("localise", source, "-o", out, "--stats", stats)
    assert (result.code, result.out) == (ExitCode.INTERRUPTED, "")
    assert result.err.splitlines() == [
        f"2 poses, 0 lost: {out}",
        "sfr: interrupted: 2 of 3 pairs were localised and written",
    ]
    assert len(read_trajectory_file(out).trajectory) == 2
    assert len(stats.read_text().splitlines()) == 3
    interrupted(0)
    nothing = sfr("localise", source, "-o", tmp_path / "none.csv")
    assert (nothing.code, nothing.err) == (ExitCode.INTERRUPTED, "sfr: interrupted: nothing was finished\n")
    assert not (tmp_path / "none.csv").exists()


def test_several_columns_of_a_table_are_joined(sfr: Sfr, tmp_path: Path) -> None:
    table, poses = tmp_path / "table.csv", tmp_path / "poses.csv"
    table.write_text("Time,East,North,Up\n" + "".join(f"{k},{2 * k},{3 * k},{4 * k}\n" for k in range(1, 4)))
    columns = ("--columns=t=Time[s]", "--columns=x=North,y=East", "--columns=z=Up")
    assert sfr("convert", table, poses, *columns).code == 0
    assert read_trajectory_file(poses).trajectory.positions.tolist() == [[3.0 * k, 2.0 * k, 4.0 * k] for k in (1, 2, 3)]
