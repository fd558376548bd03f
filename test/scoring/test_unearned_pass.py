"""Files from which an earlier version made a pass that the run had not earned, judged by the commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import yaml

from helpers.cli_result import Sfr
from helpers.made_scene import NAV_RIG, nav_pair, write_folder
from helpers.straight_drive import COUNT, PERIOD_NS, POSITION, limits, straight
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.metrics.judging.judge import judged
from sfr_loc_map.metrics.score_json import from_json, to_json


def test_wrong_poses_with_other_stamps_are_missing(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """No figure contains the error of a pose whose stamp agrees with no truth."""
    rules, drive = limits(tmp_path, POSITION), straight(scale=0.999)
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


def test_a_report_of_scores_passes_only_what_limits_judged(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """A score without limits beside one that passes, and a score that contradicts its truth."""
    good, bare, turned = (tmp_path / f"{name}.json" for name in ("good", "bare", "turned"))
    options = ["--test-report", tmp_path / "t.html", "--junit", tmp_path / "t.xml", "--overwrite"]
    assert sfr("score", *files, "--limits", limits(tmp_path, POSITION), "--json", good).code == 0
    assert sfr("score", *files, "--json", bare).code == 0
    assert sfr("report", good, bare, *options).code == 3
    assert (tmp_path / "t.xml").read_text().count("<error") == 1
    assert sfr("report", good, *options).code == 0
    score = from_json(bare.read_text())
    turned.write_text(to_json(judged(msgspec.structs.replace(score, contradiction="conjugated"), None)))
    assert sfr("report", turned, *options).code == 3
    assert sfr("report", turned, "-o", tmp_path / "page.html").code == 3


def test_a_suite_judges_every_limit_and_counts_drives_by_their_truth(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    """Nine estimates of one truth, or of its copies, are one drive; a limit on maps has not enough data without one."""
    names = [f"d{number}.csv" for number in range(9)]
    truth = straight()
    for number, name in enumerate(names):
        save_trajectory(tmp_path / name, straight(scale=0.999 + 1e-9 * number))
        copy = Trajectory(truth.stamps_ns, truth.positions + 1e-5 * number, truth.quats_xyzw)
        save_trajectory(tmp_path / f"t{name}", copy)
    pairs = [{"estimate": name, "truth": "truth.csv"} for name in names]
    copies = [{"estimate": name, "truth": f"t{name}"} for name in names]
    bound = {"limit": 0.05, "prob": 0.8, "confidence": 0.8, "interpretation": "ensemble"}
    of_bound = {"minimum_independent": 1, "trajectory": [{"condition": "distance=5", "position_bound_m": bound}]}
    for number, (sources, rules, code) in enumerate(
        (
            (pairs, POSITION, 0),
            (pairs, POSITION | {"map": {"coverage_min": 0.99}}, 3),
            (pairs, {"map": {"coverage_min": 0.99}}, 3),
            (pairs, of_bound, 3),
            (copies, of_bound, 3),
        )
    ):
        suite = tmp_path / f"suite{number}.yaml"
        suite.write_text(yaml.safe_dump({"sources": sources, "limits": rules}))
        done = sfr("suite", "run", suite, "--out", tmp_path / f"out{number}", "--workers", "1")
        assert done.code == code, (number, done.out, done.err)


def test_a_sequential_bound_on_unknown_errors_has_not_enough_data(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    """The truth has positions alone, so that the errors of the attitude are unknown."""
    drive = straight()
    save_trajectory(files[1], Trajectory(drive.stamps_ns, drive.positions, np.zeros((COUNT, 4))))
    bound = {"limit": 0.1, "prob": 0.5, "confidence": 0.5, "power": 0.5, "good": 0, "interpretation": "ensemble"}
    for name, code in (("position_bound_m", 0), ("attitude_bound_deg", 3)):
        content = {"minimum_independent": 1, "trajectory": [{"condition": "distance=5", name: bound}]}
        rules, score = limits(tmp_path, content), tmp_path / f"{name}.json"
        assert sfr("score", *files, "--limits", rules, "--json", score).code == code, name
        assert sfr("report", score, "-o", tmp_path / f"{name}.html").code == code, "what is written is read"


def test_points_of_a_map_that_are_repeated_are_no_more_points(tmp_path: Path, sfr: Sfr) -> None:
    """A tenth of the points is 0.5 m too far away; the others, each twenty times, hide them from the 95 % quantile."""
    folder, path = write_folder(tmp_path / "nav", 0, 1), tmp_path / "cloud.ply"
    xyz = nav_pair(0).truth.reshape(-1, 3).copy()
    is_wrong = np.arange(len(xyz)) % 10 == 0
    xyz[is_wrong] += np.float32([0.5, 0.0, 0.0])
    v, u = np.indices((NAV_RIG.height, NAV_RIG.width), np.uint16).reshape(2, -1)
    ones = np.ones(len(xyz), np.float32)
    cloud = PointCloud(xyz, 0.1 * ones, ones, u, v, np.zeros(len(xyz), np.uint8), fused=False)
    rules = limits(tmp_path, {"map": {"point_error_p95_m": 0.1}})
    rows = np.flatnonzero(~is_wrong)
    records = cloud.to_structured()
    for chosen, code in ((np.arange(len(xyz)), 1), (rows, 0), (np.append(np.arange(len(xyz)), np.tile(rows, 20)), 3)):
        save_cloud(path, replace(PointCloud.from_structured(records[chosen]), fused=False))
        assert sfr("score", path, folder, "--limits", rules).code == code, code


def test_a_suite_refuses_the_result_of_another_job(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """The result of a good estimate is copied over that of a bad one."""
    save_trajectory(tmp_path / "bad.csv", straight(scale=1.5))
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    pairs = [{"estimate": name, "truth": "truth.csv"} for name in ("estimate.csv", "bad.csv")]
    suite.write_text(yaml.safe_dump({"sources": pairs, "limits": POSITION}))
    assert sfr("suite", "run", suite, "--out", out, "--workers", "1").code == 1
    first, second = (out / "results").glob("*.json")
    good, bad = (first, second) if from_json(first.read_text()).verdict == "pass" else (second, first)
    bad.write_text(good.read_text())
    assert sfr("suite", "report", out, "--overwrite").code == 2
