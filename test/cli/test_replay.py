"""`sfr replay`: three processes over DDS give the results of the same calls offline."""

# ruff: noqa: E402 - ROS may be absent
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

from helpers.cli_result import Sfr
from helpers.made_scene import fill, loc_pair, write_folder
from helpers.score_rows import number, rows_about
from sfr_loc_map.io.bag.writer import BagWriter

COMMAND = ("-m", "sfr_loc_map")


def process(*arguments: str | Path, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *COMMAND, *map(str, arguments)]
    variables = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"} | (environment or {})
    return subprocess.run(command, capture_output=True, text=True, timeout=280, env=variables, check=False)


@pytest.mark.clause("1.3")
@pytest.mark.slow
def test_a_folder_with_both_tasks_gives_to_the_last_bit_what_offline_runs_give(sfr: Sfr, tmp_path: Path) -> None:
    source, out = write_folder(tmp_path / "source", 12, 3), tmp_path / "out"
    limits, config = tmp_path / "limits.yaml", tmp_path / "config.yaml"
    limits.write_text("timing:\n  localisation_p50_s: 1.0e-9\n", encoding="utf-8")
    config.write_text("/**/localisation_node:\n  ros__parameters:\n    localisation.max_features: 300\n")
    given = ("--start", "truth", "--config", config)
    run = process("replay", source, "--out", out, "--condition", "frames=3", "--limits", limits, *given)
    assert run.returncode == 1, run.stderr
    assert "limits missed" in run.stderr
    assert str(out / "report.html") in run.stdout.replace("\n", "")
    assert (out / "report.html").stat().st_size > 1000
    assert sfr("localise", source, "-o", tmp_path / "t.csv", *given).code == 0
    assert (out / "estimate.csv").read_bytes() == (tmp_path / "t.csv").read_bytes()
    assert sfr("map", source, "-o", tmp_path / "c.ply").code == 0
    assert (out / "cloud.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()
    score = json.loads((out / "report.json").read_text())
    assert score["association"]["matched"] == score["association"]["estimate_poses"] == 12
    assert score["association"]["lost"] == 0
    assert number(score, "position", "mean") < 0.02
    assert number(score, "pairs") == 3
    assert number(score, "localisation", "n") == 12
    assert number(score, "peak", part="mapping") > 0
    offline, calls = tmp_path / "t.json", ("--stats", out / "stats.csv")
    options = (*calls, "--condition", "frames=3", "--json", offline)
    assert sfr("score", out / "estimate.csv", source, *options).code == 0
    about = ("trajectory", "consistency", "completeness", "timing", "memory")
    drive = rows_about(score, *about)
    found = rows_about(json.loads(offline.read_text()), *about)
    assert [item for item in found if item in drive] == found
    assert score["association"]["images"] == 12
    assert sfr("score", out / "cloud.ply", source, "--json", tmp_path / "c.json").code == 0
    of_cloud = json.loads((tmp_path / "c.json").read_text())
    assert rows_about(of_cloud, "map") == rows_about(score, "map")
    assert score["cloud"]["kind"] == "fused"


@pytest.mark.slow
def test_an_image_that_a_node_refuses_ends_the_replay_at_once(tmp_path: Path) -> None:
    path = tmp_path / "broken.mcap"
    with BagWriter(path, jpeg_quality=90) as writer:
        fill(writer, 2, 0)
        pair = loc_pair(2)
        writer.write_loc_pair(type(pair)(pair.stamp_ns, pair.left[:100], pair.right[:100]))
    run = process("replay", path, "--out", tmp_path / "out")
    assert run.returncode == 2
    assert "160 x 100" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
