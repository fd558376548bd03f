"""What is given besides the poses: a target's calls, a shorter truth, a factor of the positions, ranges, no limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_scene import nav_pair, write_folder
from helpers.straight_drive import COUNT, PERIOD_NS, POSITION, limits, straight
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.runs.calls import CallRecord, save_stats

ON_TARGET = {"target": {"localisation_p95_s": 1.0}}


def calls_of(path: Path, method: str, finding: str = "") -> Path:
    """Write a call of each pose, by a method, of which the fifth has a finding."""
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind,finding"
    lines = [f"{row * PERIOD_NS},0.1,tracking,{method},1,python,{finding * (row == 5)}" for row in range(COUNT)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def test_what_a_method_did_wrong_on_the_target_counts(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    rules = limits(tmp_path, ON_TARGET)
    good, bad = (
        calls_of(tmp_path / f"{number}.csv", "mine", finding)
        for number, finding in enumerate(("", "leaking: its memory grows"))
    )
    for timing, code in ((good, 0), (bad, 1)):
        done = sfr("score", *files, "--limits", rules, "--target", "board", "--target-timing", timing)
        assert done.code == code, done.err
    assert "the method failed: leaking" in done.err


def test_times_on_a_target_are_of_the_method_that_gave_the_poses(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    rules, stats = limits(tmp_path, ON_TARGET), calls_of(tmp_path / "calls.csv", "mine")
    for name, code in (("mine", 0), ("other", 2)):
        timing = calls_of(tmp_path / f"{name}.csv", name)
        options = ("--stats", stats, "--target", "board", "--target-timing", timing)
        done = sfr("score", *files, "--limits", rules, *options)
        assert done.code == code, done.err
    assert "give the calls of one method" in done.err


@pytest.mark.parametrize("kept", [slice(None, -30), slice(30, None)])
def test_a_truth_that_is_shorter_than_the_estimate_is_incomplete(tmp_path: Path, sfr: Sfr, kept: slice) -> None:
    """The estimate is wrong by metres where the truth was cut."""
    estimate, truth = straight(scale=0.999), straight()
    is_cut = np.ones(COUNT, np.bool_)
    is_cut[kept] = False
    wrong = estimate.positions + np.array([0.0, 3.0, 0.0]) * is_cut[:, None]
    save_trajectory(tmp_path / "e.csv", Trajectory(estimate.stamps_ns, wrong, estimate.quats_xyzw))
    columns = (truth.stamps_ns[kept], truth.positions[kept], truth.quats_xyzw[kept])
    save_trajectory(tmp_path / "t.csv", Trajectory(*columns))
    rules = limits(tmp_path, {**POSITION, "minimum_independent": 4})
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules)
    assert done.code == 3
    assert "incomplete: 9.699 % of the images or true poses have no ground truth" in done.out
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules, "--partial").code == 0


def test_one_period_beyond_the_truth_is_covered(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    truth = straight(COUNT - 1)
    save_trajectory(tmp_path / "t.csv", truth)
    assert sfr("score", files[0], tmp_path / "t.csv", "--limits", limits(tmp_path, POSITION)).code == 0


def test_a_factor_that_is_no_unit_of_length_judges_nothing(tmp_path: Path, sfr: Sfr) -> None:
    rules = limits(tmp_path, POSITION)
    save_trajectory(tmp_path / "t.csv", straight())
    for factor, code in ((1.0 / 1.1, 3), (1.00001, 3), (0.001, 0), (0.3048, 0), (1200 / 3937, 0)):
        save_trajectory(tmp_path / "e.csv", straight(scale=0.999 / factor))
        options = ("--convention", f"metres_per_unit={factor!r}", "--limits", rules)
        done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", *options)
        assert done.code == code, (factor, done.err)
        assert ("is no unit of length" in done.err) == (code == 3)


def test_other_ranges_of_coverage_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    folder, cloud = write_folder(tmp_path / "data", 0, 1), tmp_path / "c.ply"
    truth = nav_pair(0).truth
    assert truth is not None
    v, u = (part.ravel().astype(np.uint16) for part in np.indices(truth.shape[:2]))
    same = np.full(len(u), 0.05, np.float32)
    points = truth.reshape(-1, 3) + 0.001
    save_cloud(cloud, PointCloud(points, same, same, u, v, np.zeros(len(u), np.uint8), fused=False))
    rules = limits(tmp_path, {"map": {"coverage_min": 0.1}})
    for options, is_deviation in (((), False), (("--range", "0.5", "9"), True)):
        score, page = tmp_path / "s.json", tmp_path / "r.html"
        done = sfr("score", cloud, folder, "--limits", rules, "--json", score, "--overwrite", *options)
        assert done.code == 0, done.err
        sfr("report", score, "--test-report", page, "--overwrite")
        assert ("Coverage counts true points from 0.5 m to 9 m" in page.read_text()) == is_deviation


def test_settings_that_change_the_truth_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    """The truth is a second late; the setting that corrects it is listed and stands in the control document."""
    late, truth, score = straight(), straight(scale=1.001), tmp_path / "s.json"
    late = Trajectory(late.stamps_ns + NS_PER_S, late.positions, late.quats_xyzw)
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    for path, poses in zip(paths, (late, truth), strict=True):
        save_trajectory(path, poses)
    setting = "truth.clock_offset_s=1.0"
    done = sfr("score", *paths, "--limits", limits(tmp_path, POSITION), "--json", score, "--set", setting)
    assert done.code == 0, done.err
    page, table = tmp_path / "r.html", tmp_path / "c.csv"
    sfr("report", score, "--test-report", page, "--control", table)
    assert all(f"The ground truth was read with {setting}" in path.read_text() for path in (page, table))


def test_nothing_that_is_signed_is_green_without_limits(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    bare, xml, table = tmp_path / "s.json", tmp_path / "j.xml", tmp_path / "c.csv"
    assert sfr("score", *files, "--json", bare).code == 0
    assert sfr("score", *files, "--junit", xml).code == 3
    assert '<error message="the score was judged by no limits"' in xml.read_text()
    for options in (("--junit", xml), ("--control", table), ("--test-report", tmp_path / "t.html")):
        done = sfr("report", bare, *options, "--overwrite")
        assert (done.code, "the score was judged by no limits" in done.err) == (3, True), options
    assert xml.read_text().count("<error") == 1


def test_calls_belong_to_the_estimate_that_they_gave(tmp_path: Path, sfr: Sfr) -> None:
    """The file may be written in millimetres or hold a part of the poses; poses of another run are refused."""
    drive, stats = straight(scale=0.999), tmp_path / "calls.csv"
    records = [CallRecord(stamp_ns, 0.1, "tracking") for stamp_ns in drive.stamps_ns.tolist()]
    save_stats(stats, records, None, drive)
    save_trajectory(tmp_path / "t.csv", straight())
    away = drive.positions + np.array([0.0, 0.01, 0.0]) * (np.arange(COUNT) == 7)[:, None]
    cases = {
        "as written": (drive, 0),
        "in mm": (replace(drive, positions=np.round(drive.positions, 3)), 0),
        "one pose differs": (replace(drive, positions=away), 2),
    }
    rules = limits(tmp_path, {**POSITION, "completeness": {"poses_of_truth_max_share": 1.0}})
    for name, (trajectory, code) in cases.items():
        save_trajectory(tmp_path / "e.csv", trajectory)
        done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules, "--stats", stats)
        assert done.code == code, (name, done.err)
    assert "are of another estimate: at 1 of 300 stamps" in done.err
    header, *lines = stats.read_text().splitlines()
    places = [header.split(",").index(f"position_{axis}_m") for axis in "xyz"]
    emptied = [",".join("" if n in places else cell for n, cell in enumerate(line.split(","))) for line in lines]
    stats.write_text("\n".join([header, *emptied]) + "\n")
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--stats", stats)
    assert done.code == 2
    assert "state no position at 300 of 300 stamps" in done.err


def test_unknown_calls_are_a_deviation(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    rules, score, page = limits(tmp_path, POSITION), tmp_path / "s.json", tmp_path / "r.html"
    stats = calls_of(tmp_path / "calls.csv", "mine")
    for options, is_deviation in (((), True), (("--stats", stats), False)):
        assert sfr("score", *files, "--limits", rules, "--json", score, "--overwrite", *options).code == 0
        assert sfr("report", score, "--test-report", page, "--overwrite").code == 0
        assert ("The calls of the run are unknown" in page.read_text()) == is_deviation
