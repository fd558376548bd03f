"""Times, memory and states of the calls of a run, by `sfr score`: they belong to the estimate and to its images."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import score_rows
from helpers.cli_result import Sfr
from helpers.judge import POSES, Judge
from helpers.made_scene import write_folder
from helpers.scored_drives import COUNT, PERIOD_NS, POSITION, SHORT, limits, straight, write_calls, write_calls_of
from sfr_loc_map.calls.call_files import save_stats
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


@pytest.mark.clause("4.2.2")
@pytest.mark.parametrize("peak", ["0", ""])
@pytest.mark.parametrize("part", ["memory", "target"])
def test_memory_of_zero_is_not_known(judge: Judge, peak: str, part: str) -> None:
    calls = judge.calls(judge.estimate.stamps_ns, peak=peak)
    options = ["--stats", calls] if part == "memory" else ["--target", "board", "--target-timing", calls]
    result, score = judge(*options, limits=f"{part}:\n  localisation_peak_bytes: 1000000\n")
    assert result.code == 3
    assert [item["verdict"] for item in score["verdicts"]] == ["not enough data"]
    result, score = judge(
        *options[:-1],
        judge.calls(judge.estimate.stamps_ns, peak="900000"),
        limits=f"{part}:\n  localisation_peak_bytes: 1000000\n",
    )
    assert (result.code, score["verdicts"][0]["value"]) == (0, 900_000)


@pytest.mark.clause("4.2.2")
@pytest.mark.parametrize("part", ["memory", "target"])
@pytest.mark.parametrize(
    ("values", "method", "code"), [("00", "", 3), ("05", "", 0), ("00", "sampled", 0), (("", "0"), "", 3)]
)
def test_a_column_of_zeros_is_unknown_memory_unless_a_method_is_stated(
    judge: Judge, part: str, values: Sequence[str], method: str, code: int
) -> None:
    header, *rows = judge.calls(judge.estimate.stamps_ns, peak="900000").read_text().splitlines()
    of_call = [values[0], *[values[1]] * (len(rows) - 1)]
    rows = [f"{row},{value},{method}" for row, value in zip(rows, of_call, strict=True)]
    calls = judge.folder / "filled.csv"
    calls.write_text("\n".join([f"{header},above_idle_bytes,memory_method", *rows]) + "\n")
    options = ["--stats", calls] if part == "memory" else ["--target", "board", "--target-timing", calls]
    result, _ = judge(*options, limits=f"{part}:\n  localisation_above_idle_bytes: 1000000\n")
    assert result.code == code


@pytest.mark.clause("4.2.2")
def test_a_score_of_files_states_the_methods_of_measuring_memory(judge: Judge) -> None:
    """Each file may state a method; calls without a method add nothing."""
    options: list[object] = []
    for name, method in (("a", "sampled by the kit"), ("b", ""), ("c", "by the linker"), ("d", "by the linker")):
        path = judge.calls(judge.estimate.stamps_ns[:40], f"{name}.csv", peak=1000)
        header, *rows = path.read_text().splitlines()
        path.write_text("\n".join([f"{header},memory_method", *(f"{row},{method}" for row in rows)]) + "\n")
        options += ["--stats", path]
        stated = judge(*options)[1]["calls"]["memory_method"]
        assert stated == ("sampled by the kit" if name < "c" else "sampled by the kit; by the linker")


def test_lost_and_degraded_frames_have_limits_of_their_own(judge: Judge) -> None:
    calls = judge.calls(judge.estimate.stamps_ns[:40], state="lost")
    more = judge.calls(judge.estimate.stamps_ns[40:], "more.csv")
    calls.write_text(calls.read_text() + "".join(more.read_text().splitlines(keepends=True)[1:]))
    for limit, code in ((0.2, 0), (0.05, 1)):
        result, score = judge("--stats", calls, limits=f"completeness:\n  lost_max_share: {limit}\n")
        assert result.code == code
        assert score["verdicts"][0]["value"] == pytest.approx(40 / POSES)


def test_a_limit_on_lost_poses_needs_their_states(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """Without a call of every pose the lost ones are unknown; those of several files count together."""
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", "lost_max_share": 0.0}]})
    first = write_calls(tmp_path / "first.csv", range(50))
    second, good = (
        write_calls(tmp_path / name, range(50, COUNT), lost)
        for name, lost in (("2.csv", range(90, 100)), ("3.csv", range(0)))
    )
    for stats, code in (([], 3), ([first], 3), ([first, second], 1), ([first, second, good], 1), ([first, good], 0)):
        options = [option for path in stats for option in ("--stats", path)]
        assert sfr("score", *files, "--limits", rules, *options).code == code, stats


def test_times_of_several_files_are_those_of_one_run(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """A run in two files passes; the file of a second run does not take the place of the slow first one."""
    rules = limits(tmp_path, {"timing": {"localisation_max_s": 1.0}})
    parts = [write_calls(tmp_path / "1.csv", range(50)), write_calls(tmp_path / "2.csv", range(50, COUNT))]
    slow, fast = (
        write_calls(tmp_path / "slow.csv", range(COUNT), seconds=9.5),
        write_calls(tmp_path / "fast.csv", range(COUNT)),
    )
    for stats, code in ((parts, 0), ([slow, fast], 1), ([fast, slow], 1), ([fast, parts[0]], 3)):
        options = [option for path in stats for option in ("--stats", path)]
        assert sfr("score", *files, "--limits", rules, *options).code == code, stats


@pytest.mark.clause("1.3", "4.3.1", "4.3.2")
def test_three_pairs_to_one_cloud_are_one_call_with_time_and_memory(sfr: Sfr, judge: Judge, source: Path) -> None:
    made, stats = judge.folder / "made.ply", judge.folder / "made.csv"
    assert sfr("map", source, "-o", made, "--stats", stats).code == 0
    sky = "map:\n  points_without_truth_max_share: 0.5\n"
    limits = judge.limits(f"{sky}timing:\n  mapping_call_s: 600\nmemory:\n  mapping_call_peak_bytes: 100000000000\n")
    result = sfr("score", made, source, "--stats", stats, "--limits", limits, "--json", "-")
    assert result.code == 0, result.err
    score = json.loads(result.out)
    whole = score_rows.row(score, "mapping_call")
    assert whole["n"] == 1
    parts = score_rows.number(score, "mapping", "mean") * 2 + score_rows.number(score, "fusion", "mean")
    assert whole["max"] >= 0.99 * parts
    assert [item["verdict"] for item in score["verdicts"]] == ["pass", "pass", "pass"]


@pytest.mark.clause("4.2.1")
@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (lambda stamps: stamps, 0),
        (lambda stamps: stamps[:2], 3),
        (lambda stamps: stamps + 10**12, 3),
        (lambda stamps: np.append(stamps, np.repeat(stamps[:1], 2000)), 3),
    ],
    ids=["each image", "two images", "another run", "one image 2,001 times"],
)
def test_calls_are_those_of_the_images(judge: Judge, images: Path, localised: Trajectory, rows: Any, code: int) -> None:
    """Times of 2 of all calls, of another run, of one call many times."""
    estimate, calls = judge.poses("estimate.csv", localised), judge.calls(rows(localised.stamps_ns))
    limits = judge.limits("timing: {localisation_p95_s: 1}\n")
    assert judge.sfr("score", estimate, images / "all", "--stats", calls, "--limits", limits).code == code


def test_calls_belong_to_the_estimate_that_they_gave(tmp_path: Path, sfr: Sfr) -> None:
    """The file may be written in millimetres or hold a part of the poses; poses of another run are refused."""
    drive, stats = straight(scale=SHORT), tmp_path / "calls.csv"
    records = [CallRecord(stamp_ns, 0.1, "tracking") for stamp_ns in drive.stamps_ns.tolist()]
    save_stats(stats, records, estimate=drive)
    save_trajectory(tmp_path / "t.csv", straight())
    away = drive.positions + np.array([0.0, 0.01, 0.0]) * (np.arange(COUNT) == 7)[:, None]
    cases = {
        "as written": (drive, 0),
        "in mm": (replace(drive, positions=np.round(drive.positions, 3)), 0),
        "stamps differ by 1 ns, and one pose": (replace(drive, stamps_ns=drive.stamps_ns + 1, positions=away), 2),
        "one pose differs": (replace(drive, positions=away), 2),
    }
    rules = limits(tmp_path, {**POSITION, "completeness": {"poses_of_truth_max_share": 1.0}})
    for name, (trajectory, code) in cases.items():
        save_trajectory(tmp_path / "e.csv", trajectory)
        done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules, "--stats", stats)
        assert done.code == code, (name, done.err)
    assert "belong to another estimate: at 1 of 300 stamps" in done.err
    timing = ("--target", "board", "--target-timing", stats)
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", *timing).code == 2
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", *timing, "--target-run", "Tuesday").code == 0
    header, *lines = stats.read_text().splitlines()
    places = [header.split(",").index(f"position_{axis}_m") for axis in "xyz"]
    emptied = [",".join("" if n in places else cell for n, cell in enumerate(line.split(","))) for line in lines]
    stats.write_text("\n".join([header, *emptied]) + "\n")
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--stats", stats)
    assert done.code == 2
    assert "have no position at 300 of 300 stamps" in done.err


@pytest.mark.parametrize(
    "content",
    [
        {"timing": {"localisation_max_s": 1.0}},
        {"memory": {"localisation_peak_bytes": 1e9}},
        {"trajectory": [{"condition": "distance=5", "lost_max_share": 0.0}]},
    ],
)
def test_without_calls_a_limit_on_them_is_incomplete(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, content: dict[str, object]
) -> None:
    score = tmp_path / "s.json"
    done = sfr("score", *files, "--limits", limits(tmp_path, content), "--json", score)
    assert (done.code, json.loads(score.read_text())["verdict"]) == (3, "incomplete")
    assert "give the calls of the run (option stats)" in done.out


@pytest.mark.parametrize(("allowed", "code"), [(0, 3), (0.5, 3), (0.9, 0), (1, 0)])
def test_a_limit_on_missing_calls_accepts_unmeasured_memory_up_to_its_fraction(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, allowed: float, code: int
) -> None:
    """The memory of four of five calls was not measured, the time of all was."""
    rows = [f"{row * PERIOD_NS},0.1,tracking,{'' if row % 5 else 1000}" for row in range(COUNT)]
    header = "stamp_ns,processing_time_s,state,peak_rss_bytes"
    (tmp_path / "c.csv").write_text("\n".join([header, *rows]) + "\n")
    content = {"memory": {"localisation_peak_bytes": 1e6}, "completeness": {"calls_missing_max_share": allowed}}
    assert sfr("score", *files, "--limits", limits(tmp_path, content), "--stats", tmp_path / "c.csv").code == code


@pytest.mark.parametrize(("place", "code"), [(slice(0, 10), 0), (slice(100, 150), 1), (slice(100, 110), 1)])
def test_a_pose_that_is_initialised_after_a_tracked_pose_is_lost(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, place: slice, code: int
) -> None:
    states = np.full(COUNT, "tracking", object)
    states[place] = "initialising"
    rows = [f"{row * PERIOD_NS},0.1,{state}" for row, state in enumerate(states)]
    (tmp_path / "c.csv").write_text("\n".join(["stamp_ns,processing_time_s,state", *rows]) + "\n")
    rules = limits(tmp_path, {**POSITION, "completeness": {"lost_max_share": 0.02}})
    assert sfr("score", *files, "--limits", rules, "--stats", tmp_path / "c.csv").code == code


def test_times_that_an_external_node_stated_meet_no_limit(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """The files of a replay have the times that the node stated; the replay measured others."""
    stats = write_calls_of(tmp_path / "calls.csv", "node")
    stats.write_text(stats.read_text().replace(",python,", ",external,"))
    rules = limits(tmp_path, {**POSITION, "timing": {"localisation_max_s": 1.0}})
    score, page = tmp_path / "s.json", tmp_path / "r.html"
    assert sfr("score", *files, "--limits", rules, "--stats", stats, "--json", score).code == 3
    sfr("report", score, "--test-report", page)
    assert "The external node was not isolated" in page.read_text()


def test_calls_of_several_methods_in_one_file_are_refused(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    stats = write_calls_of(tmp_path / "calls.csv", "mine")
    first, second, *others = stats.read_text().splitlines(keepends=True)
    stats.write_text("".join([first, second, *(line.replace("mine", "theirs") for line in others)]))
    done = sfr("score", *files, "--stats", stats)
    assert done.code == 2
    assert "name different methods or configurations (mine 1, theirs 1)" in done.err


FAILING = """
import numpy as np


class Failing:
    version = "1"

    def __init__(self, rig, config):
        self.count = 0

    def process(self, pair):
        self.count += 1
        if self.count == 5:
            raise RuntimeError("out of features")
        pose = np.eye(4)
        pose[0, 3] = 0.02 * self.count
        return pose
"""


def test_a_failed_call_is_found_although_nobody_names_the_calls(tmp_path: Path, sfr: Sfr) -> None:
    """Without `--stats` the calls are written beside the result, and the score reads them."""
    source, method, estimate = write_folder(tmp_path / "data", 12, 0), tmp_path / "mine.py", tmp_path / "e.csv"
    method.write_text(FAILING)
    done = sfr("localise", source, "-o", estimate, "--start", "truth", "--method", f"{method}:Failing")
    assert done.code == 1
    assert (tmp_path / "e.stats.csv").is_file()
    loose = {"minimum_independent": 1, "trajectory": [{"condition": "frames=2", "position_mean_plus_3sigma_m": 9.0}]}
    rules, score = limits(tmp_path, loose), tmp_path / "s.json"
    assert sfr("score", estimate, source, "--limits", rules, "--json", score).code == 1
    assert [item["kind"] for item in json.loads(score.read_text())["findings"]] == ["raised"]
