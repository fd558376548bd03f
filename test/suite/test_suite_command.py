"""`sfr suite run`, `report`, `history` and `plan`: interruption, results on Dask, failures and exit codes."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from helpers.cli_result import Result, Sfr, run_sfr
from helpers.made_suites import SFR, SMALL_DRIVE, made_suite, results, stamps_of
from helpers.processes import wait_until
from helpers.score_rows import row
from sfr_loc_map.calls.call_files import save_stats, stats_beside
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord
from sfr_loc_map.suite.store import Store
from sfr_loc_map.suite_names import Task

DRIVES = 3
LIMITS = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 1.0}]}


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_suite(tmp_path_factory.mktemp("suite"), DRIVES, limits=LIMITS)


@pytest.fixture(scope="module")
def serial(suite: Path, tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> Path:
    """Run the suite on one worker; return the folder of the results."""
    out = tmp_path_factory.mktemp("serial") / "out"
    ran = run_sfr("suite", "run", suite, "--out", out, "--scheduler", scheduler)
    assert ran.code == 0, ran.err
    return out


@pytest.fixture(scope="module")
def summary(serial: Path) -> dict[str, Any]:
    """Content of `suite.json` after the first run."""
    return dict(json.loads((serial / "suite.json").read_text()))


@pytest.mark.slow
def test_a_repeated_run_returns_the_same_summary_and_runs_no_job(
    sfr: Sfr, suite: Path, serial: Path, summary: dict[str, Any]
) -> None:
    before = stamps_of(serial)
    again = sfr("suite", "run", suite, "--out", serial, "--json", "-")
    assert again.code == 0
    assert stamps_of(serial) == before
    assert json.loads(again.out)["groups"] == summary["groups"]


@pytest.mark.slow
def test_the_summary_has_schema_counts_and_verdict(summary: dict[str, Any]) -> None:
    assert summary["schema"] == "sfr-suite/1"
    assert summary["counts"] == {"jobs": DRIVES, "done": DRIVES, "failed": 0, "waiting": 0}
    assert summary["verdict"] == "pass"


@pytest.mark.slow
def test_the_pooled_error_is_that_of_the_sub_trajectories_of_all_drives(serial: Path, summary: dict[str, Any]) -> None:
    (group,) = summary["groups"]
    pooled = row(group, "position")
    assert pooled["independent"] == DRIVES
    scores = [json.loads((serial / drive["file"]).read_text()) for drive in summary["results"]]
    rows = [score["details"]["trajectory"]["sub_trajectories"][0] for score in scores]
    errors = np.concatenate([np.column_stack([row[f"{axis}_m"] for axis in "xyz"]) for row in rows])
    figure = np.linalg.norm(errors.mean(axis=0)) + 3 * np.linalg.norm(errors.std(axis=0, ddof=1))
    assert pooled["mean_plus_3sigma"] == pytest.approx(figure, rel=1e-6)  # the rows are rounded


@pytest.mark.slow
def test_the_page_links_each_result_and_all_linked_files_exist(serial: Path, summary: dict[str, Any]) -> None:
    page = (serial / "report.html").read_text()
    assert all(f'href="pages/{drive["key"]}.html"' in page for drive in summary["results"])
    links = set(re.findall(r'<a href="([^":]+)"', page))
    assert {drive["file"] for drive in summary["results"]} | {"suite.json"} <= links
    assert all((serial / link).is_file() for link in links)


@pytest.mark.slow
def test_a_report_during_a_run_is_printed_and_not_written(sfr: Sfr, serial: Path) -> None:
    page = serial / "report.html"
    before = page.stat().st_mtime_ns
    with Store(serial).locked():
        shown = sfr("suite", "report", serial)
    assert "verdict: pass" in shown.out
    assert "the report is only printed" in shown.err
    assert page.stat().st_mtime_ns == before


@pytest.mark.slow
def test_the_last_printed_line_states_verdict_and_number_of_results(sfr: Sfr, serial: Path) -> None:
    shown = sfr("suite", "report", serial)
    last = [line for line in shown.out.splitlines() if line.strip()][-1]
    assert last.startswith(f"verdict: pass. {DRIVES} of {DRIVES} jobs have a result")


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_suite_that_is_killed_continues_to_the_same_results(
    sfr: Sfr, suite: Path, serial: Path, tmp_path: Path, scheduler: str
) -> None:
    out = tmp_path / "out"
    command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until(lambda: list((out / "results").glob("*.json")), "a result", 150.0)
    process.kill()
    process.wait(60)
    kept = {path: path.stat().st_mtime_ns for path in (out / "results").glob("*.json")}
    assert 1 <= len(kept) <= DRIVES
    (out / "plan.json").unlink()
    done = sfr("suite", "run", suite, "--out", out, "--scheduler", scheduler)
    assert done.code == 0, done.err
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in kept.items())
    assert results(out) == results(serial)
    assert json.loads((out / "suite.json").read_text())["counts"]["done"] == DRIVES


@pytest.mark.slow
def test_results_on_a_dask_cluster_are_those_of_one_worker(sfr: Sfr, suite: Path, serial: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra [suite]")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as cluster:
        done = sfr("suite", "run", suite, "--out", tmp_path / "out", "--scheduler", cluster.scheduler_address)
    assert done.code == 0, done.err
    assert results(tmp_path / "out") == results(serial)


@pytest.mark.slow
def test_equal_suites_are_compared_as_equal(sfr: Sfr, serial: Path) -> None:
    compared = sfr("report", serial, serial, "--json", "-")
    assert compared.code == 0
    figures = json.loads(compared.out)["figures"]
    assert {item["outcome"] for item in figures if item["kind"] == "accuracy"} == {"equal"}


@pytest.mark.slow
def test_the_history_of_equal_suites_has_no_change(sfr: Sfr, serial: Path, tmp_path: Path) -> None:
    page, content = tmp_path / "history.html", json.loads((serial / "suite.json").read_text())
    for number in range(6):
        night = tmp_path / f"night{number}"
        night.mkdir()
        (night / "suite.json").write_text(json.dumps(content | {"time": f"2026-01-0{number + 1}T00:00:00+00:00"}))
    assert sfr("suite", "history", *sorted(tmp_path.glob("night*")), "--html", page).code == 0
    assert "No figure is certainly worse" in page.read_text()


class FailedRun(NamedTuple):
    suite: Path
    out: Path
    result: Result


@pytest.fixture(scope="module")
def failed_run(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> FailedRun:
    """Run a suite with a good estimate, an estimate that is not a trajectory, and a source that does not exist."""
    folder = tmp_path_factory.mktemp("failed")
    suite = made_suite(folder / "made of it", 2)
    (suite.parent / "drive0.csv").write_text("stamp_ns\nnonsense\n")
    content = yaml.safe_load(suite.read_text())
    suite.write_text(yaml.safe_dump(content | {"sources": [*content["sources"], "gone"]}))
    ran = run_sfr("suite", "run", suite, "--out", folder / "out", "--scheduler", scheduler)
    return FailedRun(suite, folder / "out", ran)


@pytest.mark.slow
def test_a_missing_source_is_skipped_with_exit_code_2_also_by_the_report(sfr: Sfr, failed_run: FailedRun) -> None:
    assert failed_run.result.code == 2, failed_run.result.err
    assert failed_run.result.err.count("skipped: source 'gone'") == 1
    found = json.loads((failed_run.out / "suite.json").read_text())
    assert [item["path"] for item in found["refusals"]] == ["gone"]
    assert sfr("suite", "report", failed_run.out).code == 2


@pytest.mark.slow
def test_a_failed_job_is_reported_with_its_cause_beside_the_other_results(failed_run: FailedRun) -> None:
    assert "bad input" in failed_run.result.err
    assert "of 2 jobs" in failed_run.result.err
    found = json.loads((failed_run.out / "suite.json").read_text())
    (key,) = [path.stem for path in (failed_run.out / "failures").iterdir()]
    assert [failure["key"] for failure in found["failures"]] == [key]
    assert found["counts"]["done"] == sum(worker["done"] for worker in found["workers"]) == 1
    assert {"commit", "branch", "date"} == set(found["git"])


@pytest.mark.slow
def test_a_failed_job_is_not_run_again_without_retry_failed(sfr: Sfr, failed_run: FailedRun) -> None:
    dry_run = ("suite", "run", failed_run.suite, "--out", failed_run.out, "--dry-run")
    assert sfr(*dry_run).out.startswith("0 of 2 jobs to run")
    assert "1 of 2 jobs to run" in sfr(*dry_run, "--retry-failed").out


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
    method = MethodRecord(name="theirs", version=None, kind=MethodKind.PYTHON)
    save_stats(stats_beside(estimate), calls, {Task.LOCALISATION: method})
    alone = sfr("score", estimate, suite.parent / "truth0.csv", "--condition", "distance=1")
    assert alone.code == 1, alone.err
    again = sfr(*run)
    summary = json.loads(again.out)
    assert (again.code, summary["verdict"], summary["counts"]["done"]) == (1, "fail", 2)
    (failed,) = [item for item in summary["groups"][0]["verdicts"] if item["verdict"] == "fail"]
    assert (failed["name"], failed["missed_by"]) == ("leaking_calls", 1)


@pytest.fixture(scope="module")
def run_with_bad_drive(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> tuple[Path, Path]:
    """Run a suite of three drives, of which one misses the limit; return its file and folder."""
    folder = tmp_path_factory.mktemp("bad_drive")
    suite = made_suite(folder / "made", 3, limits=LIMITS)
    made_suite(folder / "bad", 3, sigma_m=0.2)
    (folder / "bad/drive2.csv").replace(folder / "made/drive2.csv")
    ran = run_sfr("suite", "run", suite, "--out", folder / "out", "--scheduler", scheduler)
    assert ran.code == 1, ran.err
    return suite, folder / "out"


@pytest.fixture
def missed(run_with_bad_drive: tuple[Path, Path]) -> Iterator[tuple[Path, Path]]:
    """Yield the file and the folder of the suite with a bad drive, and restore both files afterwards."""
    suite, out = run_with_bad_drive
    content = {path: path.read_text() for path in (suite, out / "plan.json")}
    yield suite, out
    for path, text in content.items():
        path.write_text(text)


def remove_bad_drive(suite: Path) -> None:
    content = yaml.safe_load(suite.read_text())
    suite.write_text(yaml.safe_dump(content | {"sources": content["sources"][:2]}))


@pytest.mark.slow
def test_the_comparison_of_suites_ends_with_their_verdict(sfr: Sfr, missed: tuple[Path, Path], tmp_path: Path) -> None:
    _, out = missed
    shutil.copytree(out, tmp_path / "other")
    result = sfr("report", out, tmp_path / "other", "-o", tmp_path / "page.html")
    assert result.code == 1
    assert (tmp_path / "page.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("is_deleted", [False, True], ids=["result_kept", "result_deleted"])
def test_a_plan_without_a_job_is_refused(sfr: Sfr, missed: tuple[Path, Path], is_deleted: bool) -> None:
    """Even if the result of the removed job is deleted, so that no file names the job any more."""
    _, out = missed
    plan = json.loads((out / "plan.json").read_text())
    (job,) = [job for job in Store(out).plan.jobs if job.source.name == "drive2.csv"]
    result = out / f"results/{job.key}.json"
    plan["jobs"] = [job for job in plan["jobs"] if job["source"]["name"] != "drive2.csv"]
    (out / "plan.json").write_text(json.dumps(plan))
    content = result.read_text()
    if is_deleted:
        result.unlink()
    refused = sfr("suite", "report", out)
    result.write_text(content)
    assert (refused.code, "run the suite again" in refused.err) == (2, True), refused.err


@pytest.mark.slow
def test_the_report_refuses_a_suite_file_that_has_changed(sfr: Sfr, missed: tuple[Path, Path]) -> None:
    suite, out = missed
    remove_bad_drive(suite)
    changed = sfr("suite", "report", out)
    assert (changed.code, "has changed since" in changed.err) == (2, True), changed.err


@pytest.mark.slow
def test_a_suite_from_which_a_drive_that_was_run_was_removed_is_incomplete(sfr: Sfr, missed: tuple[Path, Path]) -> None:
    suite, out = missed
    remove_bad_drive(suite)
    for command in (("run", suite, "--out", out), ("report", out, "--overwrite")):
        chosen = sfr("suite", *command, "--json", "-")
        assert (chosen.code, json.loads(chosen.out)["verdict"]) == (2, "incomplete")
        assert "removed: 'drive2.csv' was run" in chosen.err
        assert "is no longer part of the suite" in (out / "report.html").read_text()


@pytest.mark.slow
def test_a_report_needs_neither_the_suite_file_nor_the_sources(sfr: Sfr, missed: tuple[Path, Path]) -> None:
    suite, out = missed
    content = suite.read_text()
    suite.unlink()
    estimate = suite.parent / "drive2.csv"
    moved = estimate.rename(estimate.with_suffix(".moved"))
    report = sfr("suite", "report", out)
    moved.rename(estimate)
    suite.write_text(content)
    assert (report.code, "limits over all drives missed" in report.err) == (1, True), report.err


def test_a_suite_whose_bad_drive_was_replaced_by_another_is_incomplete(
    sfr: Sfr, tmp_path: Path, scheduler: str
) -> None:
    """Both drives are as long as each other, and their files have the same names in different folders."""
    out, words = tmp_path / "out", ("--scheduler", scheduler, "--json", "-")
    bad, good = (made_suite(tmp_path / name, 1, sigma, limits=LIMITS) for name, sigma in (("bad", 0.2), ("good", 1e-3)))
    assert sfr("suite", "run", bad, "--out", out, *words).code == 1
    bad.write_text(good.read_text().replace("estimate: ", "estimate: ../good/").replace("truth: ", "truth: ../good/"))
    swapped = sfr("suite", "run", bad, "--out", out, *words)
    assert (swapped.code, json.loads(swapped.out)["verdict"]) == (2, "incomplete")
    assert "removed: 'drive0.csv' was run" in swapped.err


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("between", "of the frames have errors far above the judged errors"), ("copy", "equal those of the ground truth")],
)
def test_an_incomplete_score_of_a_drive_makes_the_suite_incomplete(
    sfr: Sfr, tmp_path: Path, scheduler: str, kind: str, reason: str
) -> None:
    """Wrong frames between the starts of the sub-trajectories, and copied true poses."""
    suite = made_suite(tmp_path / "made", 2, limits=LIMITS)
    path, truth = suite.parent / "drive0.csv", read_trajectory_file(suite.parent / "truth0.csv").trajectory
    drive = read_trajectory_file(path).trajectory
    is_between = (np.arange(len(drive)) % 5 > 0)[:, None]
    wrong = drive.positions + is_between * np.random.default_rng(0).normal(0.0, 3.0, (len(drive), 3))
    chosen = wrong if kind == "between" else truth.positions
    save_trajectory(path, Trajectory(drive.stamps_ns, chosen, drive.quats_xyzw))
    ran = sfr("suite", "run", suite, "--out", tmp_path / "out", "--scheduler", scheduler, "--json", "-")
    found = json.loads(ran.out)
    assert (ran.code, found["verdict"]) == (3, "incomplete"), ran.err
    assert [reason in drive.get("incomplete", "") for drive in found["results"]] == [True, False], found["results"]


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


LIMIT_MISSED = {"trajectory": [{"condition": "distance=1", "position_mean_m": 0.0}]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "code", "verdict"),
    [
        pytest.param({"limits": LIMITS}, 3, "incomplete", id="limits"),
        pytest.param({}, 3, "incomplete", id="no_limits"),
        pytest.param({"limits": LIMIT_MISSED}, 1, "fail", id="missed"),
        pytest.param({"limits": LIMITS, "partial": True}, 0, "pass", id="partial"),
        pytest.param({"limits": LIMITS | {"completeness": {"missing_max_share": 0.6}}}, 0, "pass", id="allowed_share"),
    ],
)
def test_a_suite_with_half_a_drive_is_incomplete_unless_a_part_is_allowed(
    sfr: Sfr, tmp_path: Path, scheduler: str, settings: dict[str, object], code: int, verdict: str
) -> None:
    suite = made_suite(tmp_path / "made", 2, rebase="displacement", **settings)
    lines = (suite.parent / "drive0.csv").read_text().splitlines(keepends=True)
    (suite.parent / "drive0.csv").write_text("".join(lines[: len(lines) // 2]))
    run = sfr("suite", "run", suite, "--out", tmp_path / "out", "--scheduler", scheduler, "--json", "-")
    found = json.loads(run.out)
    assert (run.code, found["verdict"]) == (code, verdict)
    assert f"verdict: {verdict}. 2 of 2 jobs have a result" in run.err
    deviations = {item["text"]: item["results"] for item in found["deviations"]}
    page = (tmp_path / "out" / "report.html").read_text()
    for text, applies in (
        ("(--partial)", "partial" in settings),
        ("allow missing_max_share 0.6", "completeness" in str(settings)),
    ):
        assert any(text in key and count == 2 for key, count in deviations.items()) == applies
        assert (text in page) == applies
    incomplete = [drive["source"] for drive in found["results"] if "incomplete" in drive]
    assert incomplete == ([] if verdict == "pass" else ["drive0.csv"])
    if incomplete:
        (first, *_) = found["groups"][0]["verdicts"]
        assert (first["name"], first["verdict"], first["missed_by"]) == ("judged", "incomplete", 1)
        assert "incomplete: 1 drive of score" in run.err


@pytest.fixture(scope="module")
def decided(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> tuple[Path, Path, Result]:
    """Run a suite of 12 drives that stops when its sequential test has decided; return file, folder and result."""
    folder = tmp_path_factory.mktemp("decided")
    share = {"limit": 1.0, "prob": 0.75, "confidence": 0.75, "power": 0.75, "good": 0.05, "interpretation": "ensemble"}
    limits = {"trajectory": [{"condition": "distance=1", "position_bound_m": share}]}
    suite = made_suite(folder / "suite", 12, limits=limits, stop_when_decided=True)
    ran = run_sfr("suite", "run", suite, "--out", folder / "out", "--scheduler", scheduler, "--json", "-")
    return suite, folder / "out", ran


@pytest.mark.slow
def test_a_suite_stops_when_its_limit_is_decided(sfr: Sfr, decided: tuple[Path, Path, Result]) -> None:
    """75 % with confidence 75 % and no failure: the sequential test passes after 6 of 12 drives."""
    _, out, ended = decided
    assert ended.code == 0, ended.err
    summary = json.loads(ended.out)
    assert summary["verdict"] == "pass"
    assert summary["counts"]["done"] == 6
    (verdict,) = summary["groups"][0]["verdicts"]
    assert (verdict["proof"]["method"], verdict["proof"]["independent"]) == ("sequential", 6.0)
    run = {drive["source"] for drive in summary["results"]}
    skipped = {f"drive{number}.csv" for number in range(12)} - run
    (line,) = [line for line in ended.err.splitlines() if "not run, because the limits are decided" in line]
    assert len(skipped) == 6
    assert all(f"score {name}" in line for name in skipped)
    page = (out / "report.html").read_text()
    assert page.count("the sequential tests decided all limits before this job") >= 6
    assert sfr("suite", "plan", out).code == 0


@pytest.mark.slow
def test_a_decided_suite_runs_no_further_drive(sfr: Sfr, decided: tuple[Path, Path, Result]) -> None:
    suite, out, _ = decided
    before = stamps_of(out)
    again = sfr("suite", "run", suite, "--out", out, "--workers", 1, "--json", "-")
    assert again.code == 0, again.err
    assert stamps_of(out) == before
    assert "decided by the existing results" in again.err
    assert json.loads(again.out)["verdict"] == "pass"


@pytest.mark.slow
def test_the_dry_run_of_a_decided_suite_lists_no_job(sfr: Sfr, decided: tuple[Path, Path, Result]) -> None:
    suite, out, _ = decided
    listed = sfr("suite", "run", suite, "--out", out, "--dry-run")
    assert listed.out.startswith("0 of 12 jobs to run")
    assert "decided by the existing results: 6 waiting jobs are not needed" in listed.err


BUDGET = {
    "sources": [{"simulate": "scenario.yaml", "seeds": [1], "set": SMALL_DRIVE}],
    "conditions": ["frames=4"],
    "spacing": 2,
    "budget": {"baseline": {"fault": "baseline:amount=1.2"}, "clock": {"fault": "clock:amount=0.01"}},
}


@pytest.mark.slow
def test_an_error_budget_states_the_shares_of_its_sources(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    (tmp_path / "scenario.yaml").write_text("{}\n")
    suite = tmp_path / "budget.yaml"
    suite.write_text(yaml.safe_dump(BUDGET))
    found = sfr("suite", "run", suite, "--out", tmp_path / "out", "--scheduler", scheduler, "--json", "-")
    assert found.code == 0, found.err
    summary = json.loads(found.out)
    assert summary["counts"]["done"] == 4
    (budget,) = summary["budgets"]
    shares = {row["source"]: row["alone"]["value"] for row in budget["rows"]}
    assert shares["baseline"] > 0.8 > 0.2 > shares["clock"]
    assert "Error budget" in (tmp_path / "out/report.html").read_text()


@pytest.mark.parametrize(
    "change", [{"limits": LIMITS}, {"perturb": ["black"]}, {"budget": {"one": {"fault": "yaw"}}}], ids=str
)
def test_an_error_budget_with_limits_faults_or_a_source_without_size_is_refused(
    sfr: Sfr, tmp_path: Path, change: dict[str, object]
) -> None:
    (tmp_path / "scenario.yaml").write_text("{}\n")
    suite = tmp_path / "budget.yaml"
    suite.write_text(yaml.safe_dump(BUDGET | change))
    refused = sfr("suite", "run", suite, "--out", tmp_path / "out")
    assert refused.code == 2
    assert "budget" in refused.err
