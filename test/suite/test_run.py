"""`run_suite` gives the same results from Python as the command, runs no job twice, and rejects changed sources."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers import ROOT
from helpers.made_suites import JOB, made_suite, recording, straight
from sfr_loc_map.errors import InputError, InterruptedRunError
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.stored.score_json import from_json, to_json
from sfr_loc_map.suite import Store, load_specification, make_plan, run, run_suite
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import JobOutcome, JobState
from sfr_loc_map.suite.jobs.job_run import run_job
from sfr_loc_map.suite.planning.source_inspection import files_of_source, state_of
from sfr_loc_map.suite.statistics.summary import Summary

pytest.importorskip("distributed", reason="needs the extra [suite]")
LIMITS = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 1.0}]}


@pytest.mark.slow
def test_a_suite_is_run_from_python(tmp_path: Path) -> None:
    specification = load_specification(made_suite(tmp_path / "made", 2, limits=LIMITS))
    store = Store(tmp_path / "out")
    steps: list[tuple[int, int, str | None]] = []

    def summary_of_run() -> tuple[str | None, int]:
        steps.clear()
        summary = run_suite(
            specification,
            store,
            workers=1,
            progress=lambda done, total, last: steps.append((done, total, None if last is None else last[0].label)),
        )
        return summary.verdict, len(summary.results)

    assert summary_of_run() == ("pass", 2)
    assert [step[:2] for step in steps] == [(0, 2), (1, 2), (2, 2)]
    assert (tmp_path / "out/report.html").is_file()
    assert summary_of_run() == ("pass", 2)
    assert not steps, "nothing is run twice"


@pytest.mark.parametrize("change", ["written", "replaced", "removed", "before the run", "none"])
def test_a_job_whose_source_changes_during_the_run_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    """The key of its result names the planned data."""
    drive = tmp_path / "drive.mcap"
    drive.write_text("drive")
    job = replace(JOB, source=recording(path=str(drive), state=state_of(files_of_source, drive)))
    if change == "before the run":
        drive.write_text("other")

    def run_jobs(*given: Any) -> Iterator[tuple[Job, JobOutcome]]:
        if change in ("replaced", "removed"):
            drive.unlink()
        if change in ("replaced", "written"):
            drive.write_text("other")
        yield job, JobOutcome(result="{}")

    monkeypatch.setattr(run, "run_jobs", run_jobs)
    store = Store(tmp_path / "out")
    at_work: Any = None
    run.run_and_keep([job], store, at_work, lambda line: None, lambda *step: None)
    assert store.state(job) is (JobState.DONE if change == "none" else JobState.FAILED)
    if change != "none":
        assert "was changed while the suite was running" in store.failure(job).message


def test_an_interrupted_run_reports_its_finished_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    specification = load_specification(made_suite(tmp_path / "made", 2))

    def run_jobs(jobs: Sequence[Job], at_work: object, cache: Path) -> Iterator[tuple[Job, JobOutcome]]:
        yield jobs[0], JobOutcome(result=to_json(run_job(jobs[0], tmp_path, cache)))
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "suite_workers", lambda *settings: nullcontext())
    monkeypatch.setattr(run, "run_jobs", run_jobs)
    monkeypatch.setattr(run, "hold", lambda: None)
    with pytest.raises(InterruptedRunError, match=r"^interrupted: 1 of 2 jobs are done and reported"):
        run_suite(specification, Store(tmp_path / "out"))
    counts = json.loads((tmp_path / "out/suite.json").read_text())["counts"]
    assert counts == {"jobs": 2, "done": 1, "failed": 0, "waiting": 1}


def run_here(suite: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Summary:
    """Run a suite in this process."""

    def run_jobs(jobs: Sequence[Job], at_work: object, cache: Path) -> Iterator[tuple[Job, JobOutcome]]:
        for job in jobs:
            yield job, JobOutcome(result=to_json(run_job(job, folder, cache)))

    monkeypatch.setattr(run, "suite_workers", lambda *settings: nullcontext())
    monkeypatch.setattr(run, "run_jobs", run_jobs)
    monkeypatch.setattr(run, "hold", lambda: None)
    return run_suite(load_specification(suite), Store(folder))


def limits_of(limit_m: float, **terms: object) -> dict[str, object]:
    bound = {"limit": limit_m, "interpretation": "ensemble", **terms}
    return {"trajectory": [{"condition": "distance=1", "position_bound_m": bound}]}


def test_a_suite_that_was_extended_until_it_passed_or_has_other_limits_deviates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nine drives prove 70 % with 95 % confidence if all meet the limit, and fourteen if all but one meet it.

    Six drives prove nothing: a run that could not have passed is not another look.
    """

    def deviations_of(drives: int, limit_m: float, folder: str) -> tuple[VerdictState | None, set[tuple[str, str]]]:
        terms = limits_of(limit_m, prob=0.7, confidence=0.95)
        suite = made_suite(tmp_path / "made" / folder, drives, limits=terms)
        if folder == "with a bad drive":
            save_trajectory(suite.parent / "drive0.csv", straight(60, 1.0, 0))
        summary = run_here(suite, tmp_path / folder, monkeypatch)
        return summary.verdict, {(item.text, item.of) for item in summary.deviations}

    verdict, usual = deviations_of(9, 0.5, "fixed in advance")
    assert verdict == "pass"
    verdict, few = deviations_of(6, 0.5, "extended")
    assert verdict == "not enough data"
    assert deviations_of(6, 0.5, "extended") == (verdict, few), "a report of the same drives is not another look"
    assert deviations_of(9, 0.5, "extended") == ("pass", usual)
    verdict, _ = deviations_of(9, 0.5, "with a bad drive")
    assert verdict != "pass"
    verdict, extended = deviations_of(14, 0.5, "with a bad drive")
    assert verdict == "pass"
    assert "score" in [of for _, of in extended - usual]
    for drives, limit_m, count in ((9, 0.8, 1), (9, 0.5, 0)):
        _, found = deviations_of(drives, limit_m, "fixed in advance")
        assert [of for _, of in found - usual] == ["all results"] * count, "the first limits are not a deviation"


def test_drives_that_are_added_do_not_change_the_decision_of_a_sequential_test(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the two bad drives at the beginning, the test passes after six drives."""
    terms = limits_of(1.0, prob=0.75, confidence=0.75, power=0.75, good=0.05)
    suite = made_suite(tmp_path / "made", 40, limits=terms)
    content = yaml.safe_load(suite.read_text())
    for number in (0, 1):
        save_trajectory(suite.parent / f"drive{number}.csv", straight(60, 1.0, number))
    suite.write_text(yaml.safe_dump(content | {"sources": content["sources"][:2]}))
    failed = run_here(suite, tmp_path / "out", monkeypatch)
    suite.write_text(yaml.safe_dump(content))
    extended = run_here(suite, tmp_path / "out", monkeypatch)
    decisions = [(item.state, item.n) for summary in (failed, extended) for item in summary.on_limits]
    assert decisions[0][0] == "fail"
    assert decisions[0] == decisions[1]


def test_a_part_of_the_data_set_that_the_limits_name_is_incomplete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run_here(made_suite(tmp_path / "made", 3), tmp_path / "all", monkeypatch)
    provenances = [result.score.provenance for result in whole.results]
    named = [item.inputs["truth"].data_set_sha256 for item in provenances if item is not None]
    limits = LIMITS | {"data_set_sha256": named}
    for drives, verdict in ((3, "pass"), (2, "incomplete")):
        suite = made_suite(tmp_path / "made", drives, limits=limits)
        summary = run_here(suite, tmp_path / f"out{drives}", monkeypatch)
        assert (summary.verdict, len(summary.refusals)) == (verdict, 3 - drives)


def test_a_score_of_other_files_is_refused(tmp_path: Path) -> None:
    """An estimate that was swapped between plan and job gives a score whose inputs are not those of the plan."""
    suite = made_suite(tmp_path, 2)
    store = Store(tmp_path / "out")
    jobs = make_plan(load_specification(suite), store.cache).jobs
    (tmp_path / "drive0.csv").write_bytes((tmp_path / "drive1.csv").read_bytes())
    score = run_job(jobs[0], tmp_path, store.cache)
    store.save(jobs[0], JobOutcome(result=to_json(score)))
    with pytest.raises(InputError, match=r"the estimate of .* is not the file of the plan"):
        store.score(jobs[0])
    scored = run_job(jobs[1], tmp_path, store.cache)
    store.save(jobs[1], JobOutcome(result=to_json(scored)))
    assert store.score(jobs[1]) == from_json(to_json(scored), "")


def test_the_python_lines_of_the_documentation_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The block of docs/suites.md loads both files by their names. The runs have tests of their own."""
    made_suite(tmp_path, 1)
    (tmp_path / "scenario.yaml").write_text("{}\n")
    (tmp_path / "search.yaml").write_text("{scenario: scenario.yaml, ranges: {light.sun_elevation_deg: [5, 60]}}\n")
    text = (ROOT / "docs/suites.md").read_text()
    block = text.partition("```python\n")[2].partition("```")[0]
    loaded: list[str] = []

    def note(specification: Any, store: Store, **settings: int) -> None:
        loaded.append(f"{specification.path} in {store.folder}")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sfr_loc_map.suite.run.run_suite", note)
    monkeypatch.setattr("sfr_loc_map.suite.run.run_search", note)
    monkeypatch.setattr("sfr_loc_map.suite.run_suite", note, raising=False)
    monkeypatch.setattr("sfr_loc_map.suite.run_search", note, raising=False)
    exec(block, {"__name__": "__main__"})
    assert loaded == ["suite.yaml in runs/today", "search.yaml in runs/search"]
