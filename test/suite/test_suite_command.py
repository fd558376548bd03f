"""`sfr suite run`, `report`, `history`, `plan` and `search`: interruption, results on Dask, failures and exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from helpers.cli_result import Sfr
from helpers.made_suites import SFR, made_suite, results
from helpers.score_rows import row
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file, save_trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.records import MethodKind, MethodRecord
from sfr_loc_map.runs.call_files import save_stats, stats_beside
from sfr_loc_map.runs.calls import CallRecord

DRIVES = 3
LIMITS = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 1.0}]}


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_suite(tmp_path_factory.mktemp("suite"), DRIVES, limits=LIMITS)


@pytest.fixture(scope="module")
def serial(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("serial") / "out"
    subprocess.run([*SFR, "suite", "run", str(suite), "--out", str(out), "--workers", "1"], check=True)
    return out


@pytest.mark.slow
def test_a_suite_is_run_once_judged_and_reported(sfr: Sfr, suite: Path, serial: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (serial / "results").iterdir()}
    assert len(before) == DRIVES
    again = sfr("suite", "run", suite, "--out", serial, "--json", "-")
    assert again.code == 0
    assert {path: path.stat().st_mtime_ns for path in (serial / "results").iterdir()} == before
    summary = json.loads(again.out)
    assert summary["schema"] == "sfr-suite/1"
    assert summary["counts"] == {"tasks": DRIVES, "done": DRIVES, "failed": 0, "waiting": 0}
    assert summary["verdict"] == "pass"
    (group,) = summary["groups"]
    pooled = row(group, "position")
    assert pooled["independent"] == DRIVES
    scores = [json.loads((serial / drive["file"]).read_text()) for drive in summary["drives"]]
    rows = [score["details"]["trajectory"]["sub_trajectories"][0] for score in scores]
    errors = np.concatenate([np.column_stack([row[f"{axis}_m"] for axis in "xyz"]) for row in rows])
    figure = np.linalg.norm(errors.mean(axis=0)) + 3 * np.linalg.norm(errors.std(axis=0, ddof=1))
    assert pooled["mean_plus_3sigma"] == pytest.approx(figure, rel=1e-6), "the rows are rounded"
    page = (serial / "report.html").read_text()
    assert all(f'href="pages/{drive["key"]}.html"' in page for drive in summary["drives"])
    links = set(re.findall(r'<a href="([^":]+)"', page))
    assert {drive["file"] for drive in summary["drives"]} | {"suite.json"} <= links
    assert all((serial / link).is_file() for link in links)
    shown = sfr("suite", "run", suite, "--out", serial)
    last = [line for line in shown.out.splitlines() if line.strip()][-1]
    assert last.startswith(f"verdict: pass. {DRIVES} of {DRIVES} jobs have a result")
    assert json.loads((serial / "suite.json").read_text())["groups"] == summary["groups"]


@pytest.mark.slow
def test_stopped_twice_it_goes_on_and_ends_with_the_same_results(suite: Path, serial: Path, tmp_path: Path) -> None:
    out, command = (tmp_path / "out", [sys.executable, "-m", "sfr_loc_map"])
    command += ["suite", "run", str(suite), "--out", str(out), "--workers", "2"]
    for number, (how, code) in enumerate([(signal.SIGINT, 130), (signal.SIGKILL, -9)], 1):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while len(list((out / "results").glob("*.json"))) < number and time.monotonic() < end:
            time.sleep(0.02)
        os.kill(process.pid, how)
        assert process.wait(60) == code
    kept = {path: path.stat().st_mtime_ns for path in (out / "results").glob("*.json")}
    assert 2 <= len(kept) <= DRIVES
    (out / "plan.json").unlink()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in kept.items())
    assert results(out) == results(serial)
    assert json.loads((out / "suite.json").read_text())["counts"]["done"] == DRIVES


@pytest.mark.slow
def test_on_dask_the_results_are_the_same(sfr: Sfr, suite: Path, serial: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra [suite]")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as cluster:
        done = sfr("suite", "run", suite, "--out", tmp_path / "out", "--scheduler", cluster.scheduler_address)
    assert done.code == 0, done.err
    assert results(tmp_path / "out") == results(serial)


@pytest.mark.slow
def test_two_suites_and_their_history(sfr: Sfr, serial: Path, tmp_path: Path) -> None:
    compared = sfr("report", serial, serial, "--json", "-")
    assert compared.code == 0
    figures = json.loads(compared.out)["figures"]
    assert {item["outcome"] for item in figures if item["kind"] == "accuracy"} == {"equal"}
    page = tmp_path / "history.html"
    assert sfr("suite", "history", serial, serial, "--html", page).code == 0
    assert "No figure is certainly worse" in page.read_text()


@pytest.mark.slow
def test_what_fails_is_named_and_left_alone_until_it_is_asked_for(sfr: Sfr, tmp_path: Path) -> None:
    suite = made_suite(tmp_path / "made of it", 2)
    (tmp_path / "made of it" / "drive0.csv").write_text("stamp_ns\nnonsense\n")
    suite.write_text(
        yaml.safe_dump((content := yaml.safe_load(suite.read_text())) | {"sources": [*content["sources"], "gone"]})
    )
    out = tmp_path / "out"
    done = sfr("suite", "run", suite, "--out", out)
    assert done.code == 2, done.err
    assert "of 2 jobs" in done.err, done.err
    assert "skipped: source 'gone'" in done.err
    found = json.loads((out / "suite.json").read_text())
    assert (found["counts"]["done"], [item["path"] for item in found["refusals"]]) == (1, ["gone"])
    assert {"commit", "branch", "date"} == set(found["git"])
    assert sum(worker["done"] for worker in found["workers"]) == 1
    assert sfr("suite", "report", out).code == 2, "what was refused is still known"
    (key,) = [path.stem for path in (out / "failures").iterdir()]
    assert "bad input" in done.err
    (failure,) = json.loads((out / "suite.json").read_text())["failures"]
    assert failure["key"] == key
    assert sfr("suite", "run", suite, "--out", out, "--dry-run").out.startswith("0 of 2 jobs to run")
    assert "1 of 2" in sfr("suite", "run", suite, "--out", out, "--dry-run", "--retry-failed").out


@pytest.mark.slow
def test_the_calls_beside_an_estimate_are_judged_as_by_score(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """A finding of a call fails the suite; calls that appear later are another job."""
    suite = made_suite(tmp_path / "made", 2, limits=LIMITS)
    out = tmp_path / "out"
    run = ("suite", "run", suite, "--out", out, "--scheduler", scheduler, "--json", "-")
    assert sfr(*run).code == 0
    estimate = suite.parent / "drive0.csv"
    stamps = np.loadtxt(estimate, np.int64, delimiter=",", skiprows=1, usecols=0)
    calls = [CallRecord(int(stamp), 0.1, TrackingState.TRACKING) for stamp in stamps]
    calls[7] = replace(calls[7], finding="leaking: memory grows by 3.0 MB per call over 50 calls")
    save_stats(stats_beside(estimate), calls, MethodRecord(name="theirs", version=None, kind=MethodKind.PYTHON))
    alone = sfr("score", estimate, suite.parent / "truth0.csv", "--condition", "distance=1")
    assert alone.code == 1, alone.err
    again = sfr(*run)
    summary = json.loads(again.out)
    assert (again.code, summary["verdict"], summary["counts"]["done"]) == (1, "fail", 2)
    (failed,) = [item for item in summary["groups"][0]["verdicts"] if item["verdict"] == "fail"]
    assert (failed["name"], failed["missed_by"]) == ("leaking_calls", 1)


@pytest.mark.slow
def test_a_suite_without_its_bad_drive_and_an_edited_plan_pass_nothing(
    sfr: Sfr, tmp_path: Path, scheduler: str
) -> None:
    suite = made_suite(tmp_path / "made", 3, limits=LIMITS)
    made_suite(tmp_path / "bad", 3, sigma_m=0.2)
    (tmp_path / "bad/drive2.csv").replace(tmp_path / "made/drive2.csv")
    content = suite.read_text()
    out = tmp_path / "out"
    run = ("suite", "run", suite, "--out", out, "--scheduler", scheduler, "--json", "-")
    report = ("suite", "report", out, "--json", "-")
    assert (ran := sfr(*run)).code == 1, ran.err
    plan = (out / "plan.json").read_text()

    edited = json.loads(plan)
    edited["limits"]["trajectory"][0]["position_mean_plus_3sigma_m"] = 9.0
    (out / "plan.json").write_text(json.dumps(edited))
    refused = sfr(*report)
    assert (refused.code, "has other limits than" in refused.err) == (2, True), refused.err

    edited = json.loads(plan)
    bad = [job for job in edited["jobs"] if job["source"]["name"] == "drive2.csv"]
    edited["jobs"].remove(*bad)
    (out / "plan.json").write_text(json.dumps(edited))
    without = sfr(*report)
    assert (without.code, json.loads(without.out)["verdict"]) == (2, "incomplete")
    assert "skipped: 'drive2.csv' was run" in without.err

    (out / "plan.json").write_text(plan)
    suite.write_text(yaml.safe_dump((whole := yaml.safe_load(content)) | {"sources": whole["sources"][:2]}))
    changed = sfr(*report)
    assert (changed.code, "has changed since" in changed.err) == (2, True), changed.err
    chosen = sfr(*run)
    assert (chosen.code, json.loads(chosen.out)["verdict"]) == (2, "incomplete")
    assert "skipped: 'drive2.csv' was run" in chosen.err
    suite.unlink()
    assert "was not compared with this file" in sfr(*report).err


def test_a_suite_with_another_drive_in_place_of_its_bad_drive_passes_nothing(sfr: Sfr, tmp_path: Path) -> None:
    """Both drives are as long as each other, and their files have the same names in different folders."""
    out, words = tmp_path / "out", ("--workers", 1, "--json", "-")
    bad, good = (made_suite(tmp_path / name, 1, sigma, limits=LIMITS) for name, sigma in (("bad", 0.2), ("good", 1e-3)))
    assert sfr("suite", "run", bad, "--out", out, *words).code == 1
    swapped = sfr("suite", "run", good, "--out", out, *words)
    assert (swapped.code, json.loads(swapped.out)["verdict"]) == (2, "incomplete")
    assert "skipped: 'drive0.csv' was run" in swapped.err


def test_wrong_frames_between_the_starts_and_copies_pass_no_suite(sfr: Sfr, tmp_path: Path) -> None:
    """What makes the score of a drive incomplete makes the suite incomplete."""
    for name, said in (("between", "of the frames are in no judged error"), ("copy", "are those of the ground truth")):
        suite = made_suite(tmp_path / name, 2, limits=LIMITS)
        path, truth = suite.parent / "drive0.csv", read_trajectory_file(suite.parent / "truth0.csv").trajectory
        drive = read_trajectory_file(path).trajectory
        is_between = (np.arange(len(drive)) % 5 > 0)[:, None]
        wrong = drive.positions + is_between * np.array([0.0, 0.0, 3.0])
        chosen = wrong if name == "between" else truth.positions
        save_trajectory(path, Trajectory(drive.stamps_ns, chosen, drive.quats_xyzw))
        ran = sfr("suite", "run", suite, "--out", tmp_path / name / "out", "--workers", 1, "--json", "-")
        found = json.loads(ran.out)
        assert (ran.code, found["verdict"]) == (3, "incomplete"), ran.err
        assert [said in drive.get("incomplete", "") for drive in found["drives"]] == [True, False], found["drives"]


def test_usage_errors_are_one_line(sfr: Sfr, tmp_path: Path) -> None:
    suite = made_suite(tmp_path / "made", 1)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.jpg").touch()
    for arguments, words in (
        (("run", suite, "--out", tmp_path / "other"), "is not the folder of a suite"),
        (("run", suite, "--out", tmp_path / "out", "--workers", "1", "--scheduler", "tcp://x:1"), "give one of them"),
        (("report", tmp_path / "none"), "plan.json is missing"),
        (("compare", tmp_path / "none", tmp_path / "none"), "use sfr report A B"),
    ):
        done = sfr("suite", *arguments)
        assert done.code == 2
        assert words in done.err
        assert len(done.err.splitlines()) == 1
    assert yaml.safe_load(suite.read_text())["sources"]


@pytest.mark.slow
def test_a_suite_with_half_a_drive_is_incomplete_unless_a_part_is_allowed(
    sfr: Sfr, tmp_path: Path, scheduler: str
) -> None:
    cases: dict[str, tuple[dict[str, object], int, str]] = {
        "limits": ({"limits": LIMITS}, 3, "incomplete"),
        "none": ({}, 3, "incomplete"),
        "missed": ({"limits": {"trajectory": [{"condition": "distance=1", "position_mean_m": 0.0}]}}, 1, "fail"),
        "partial": ({"limits": LIMITS, "partial": True}, 0, "pass"),
        "share": ({"limits": LIMITS | {"completeness": {"missing_max_share": 0.6}}}, 0, "pass"),
    }
    for name, (more, code, verdict) in cases.items():
        suite = made_suite(tmp_path / name, 2, rebase="displacement", **more)
        lines = (suite.parent / "drive0.csv").read_text().splitlines(keepends=True)
        (suite.parent / "drive0.csv").write_text("".join(lines[: len(lines) // 2]))
        run = sfr("suite", "run", suite, "--out", tmp_path / name / "out", "--scheduler", scheduler, "--json", "-")
        found = json.loads(run.out)
        assert (run.code, found["verdict"]) == (code, verdict), name
        assert f"verdict: {verdict}. 2 of 2 jobs have a result" in run.err
        half = [drive for drive in found["drives"] if "incomplete" in drive]
        if verdict == "pass":
            assert not half
            continue
        assert half[0]["source"] == "drive0.csv"
        (first, *_) = found["groups"][0]["verdicts"]
        assert (first["name"], first["verdict"], first["missed_by"]) == ("judged_share_min", "incomplete", 1)
        assert "incomplete: 1 of 2 results of score" in run.err


@pytest.mark.slow
def test_a_campaign_stops_when_its_limit_is_decided(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """75 % with 75 % and no failure: the sequential test passes after 6 of 12 drives, and that is a pass."""
    share = {"limit": 1.0, "prob": 0.75, "confidence": 0.75, "power": 0.75, "good": 0.05, "interpretation": "ensemble"}
    limits = {"trajectory": [{"condition": "distance=1", "position_bound_m": share}]}
    file = made_suite(tmp_path / "suite", 12, limits=limits, stop_when_decided=True)
    out = tmp_path / "out"
    ended = sfr("suite", "run", file, "--out", out, "--scheduler", scheduler, "--json", "-")
    assert ended.code == 0, ended.err
    summary = json.loads(ended.out)
    assert summary["verdict"] == "pass"
    assert summary["counts"]["done"] == 6
    (verdict,) = summary["groups"][0]["verdicts"]
    assert (verdict["proof"]["method"], verdict["proof"]["independent"]) == ("sequential", 6.0)
    assert sfr("suite", "plan", out).code == 0


@pytest.mark.slow
def test_an_error_budget_states_the_shares_of_its_sources(sfr: Sfr, tmp_path: Path) -> None:
    small = {"terrain.coarseness": 8, "rocks.cover": 0.01, "rocks.smallest_m": 0.15, "panorama.enabled": False}
    small |= {"drive.pairs": 12, "drive.segments": ["straight 2"], "sensor.samples": 1}
    small |= {"loc.width": 160, "loc.height": 160, "loc.focal_px": 130}
    (tmp_path / "scenario.yaml").write_text("{}\n")
    content = {
        "sources": [{"simulate": "scenario.yaml", "seeds": [1, 2], "set": small}],
        "conditions": ["frames=4"],
        "spacing": 2,
        "budget": {"baseline": {"fault": "baseline:amount=1.2"}, "clock": {"fault": "clock:amount=0.01"}},
    }
    suite = tmp_path / "budget.yaml"
    suite.write_text(yaml.safe_dump(content))
    found = sfr("suite", "run", suite, "--out", tmp_path / "out", "--workers", "1", "--json", "-")
    assert found.code == 0, found.err
    summary = json.loads(found.out)
    assert summary["counts"]["done"] == 2 * 4
    (budget,) = summary["budgets"]
    shares = {row["source"]: row["alone"]["value"] for row in budget["rows"]}
    assert shares["baseline"] > 0.8 > 0.2 > shares["clock"]
    assert "Error budget" in (tmp_path / "out/report.html").read_text()

    for change in ({"limits": LIMITS}, {"perturb": ["black"]}, {"budget": {"one": {"fault": "yaw"}}}):
        suite.write_text(yaml.safe_dump(content | change))
        refused = sfr("suite", "run", suite, "--out", tmp_path / "other")
        assert refused.code == 2
        assert "budget" in refused.err


@pytest.mark.slow
def test_a_search_finds_a_weakness_goes_on_and_leaves_a_case(sfr: Sfr, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    small = {"terrain.coarseness": 16, "rocks.cover": 0.01, "rocks.smallest_m": 0.3, "panorama.enabled": False}
    small |= {"drive.pairs": 12, "drive.segments": ["straight 2"], "sensor.samples": 1}
    small |= {"loc.width": 160, "loc.height": 160, "loc.focal_px": 130}
    (tmp_path / "scenario.yaml").write_text("{}\n")
    content = {
        "scenario": "scenario.yaml",
        "set": small,
        "ranges": {
            "baseline": {"fault": "baseline", "range": [0.8, 1.2]},
            "shift": {"fault": "shift", "range": [-0.2, 0.2]},
        },
        "condition": "frames=4",
        "limit": 0.05,
        "runs": 6,
        "slices": 2,
        "running": {"spacing": 2},
    }
    search = tmp_path / "search.yaml"
    search.write_text(yaml.safe_dump(content))
    first = sfr("suite", "search", search, "--out", tmp_path / "out", "--workers", "2", "--json", "-")
    assert first.code == 1, first.err
    found = json.loads(first.out)
    assert found["schema"] == "sfr-search/1"
    assert found["case"]["ratio"] >= 1.0 > found["usual"]["ratio"]
    assert abs(found["case"]["point"]["baseline"] - 1.0) > 0.02
    assert "Worst case" in (tmp_path / "out/search.html").read_text()
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out/results").iterdir()}

    again = sfr("suite", "search", search, "--out", tmp_path / "out", "--workers", "2", "--json", "-")
    assert json.loads(again.out) == found
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out/results").iterdir()} == before

    case = sfr("suite", "run", tmp_path / "out/case.yaml", "--out", tmp_path / "case", "--workers", "1", "--json", "-")
    assert case.code == 0, case.err
    groups = json.loads(case.out)["groups"]
    value = next(row["mean_plus_3sigma"] for row in groups[-1]["figures"] if row["figure"] == "position")
    assert value / 0.05 == pytest.approx(found["case"]["ratio"], rel=1e-6)

    for change in ({"ranges": {"sky": [0, 1]}}, {"figure": "speed"}, {"ranges": {"terrain.slope_deg": [9, 1]}}):
        search.write_text(yaml.safe_dump(content | change))
        assert sfr("suite", "search", search, "--out", tmp_path / "other").code == 2
