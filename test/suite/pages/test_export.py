"""Exports of a suite: JUnit XML, MLflow, and Parquet with the same columns for all suites."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.made_suites import JOB, recording
from sfr_loc_map.errors import OutputError
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobFailure
from sfr_loc_map.suite.pages.export import log_to_mlflow, suite_junit, write_parquet
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.statistics.groups import groups_of
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.statistics.summary import Summary
from sfr_loc_map.suite.statistics.verdict_texts import verdict_texts_of


@pytest.fixture
def summary(score: Score) -> Summary:
    limits = parse_limits({"trajectory": [{"condition": "distance=1", "position_mean_m": 1e-9}]}, "limits")
    drives = [ScoredJob(replace(JOB, source=recording(name)), judged_by(score, limits)) for name in ("first", "other")]
    failed = JobFailure("k", "localise third", "third.mcap", FailureCause.TIME, "not done after 5 s", JOB.description)
    return Summary(
        groups=tuple(groups_of(drives, limits)), results=tuple(drives), failures=(failed,),
        refusals=(Refusal("gone.mcap", "nothing there"),), code="c", run={"host": "h", "git": {"commit": "abc"}},
    )  # fmt: skip


def test_junit_has_every_limit_and_what_has_no_result(summary: Summary) -> None:
    suites = {suite.get("name"): suite for suite in ET.fromstring(suite_junit(summary))}
    assert suites["all drives, localise, default"].get("failures") == "1"
    assert suites["localise first, default"].get("failures") == "1"
    assert suites["localise third"].find("testcase/error").get("message") == "over the time limit: not done after 5 s"
    assert suites["gone.mcap"].get("errors") == "1"


def test_an_undecided_limit_states_the_numbers_that_the_suite_requires(score: Score) -> None:
    """The message of the command names the faults of the group, and both outputs have one reason."""
    limits = parse_limits(
        {"minimum_independent": 50, "trajectory": [{"condition": "distance=1", "position_mean_m": 9.0}]}, "limits"
    )
    drives = [ScoredJob(replace(JOB, faults="black"), judged_by(score, limits))]
    found = Summary(
        groups=tuple(groups_of(drives, limits)), results=(), failures=(), refusals=(), code="c",
        limits=limits,
    )  # fmt: skip
    (undecided,) = verdict_texts_of(found).undecided
    (error,) = ET.fromstring(suite_junit(found)).findall("testsuite/testcase/error")
    assert undecided.startswith("position_mean_m of localise, default, black: ")
    assert undecided.endswith("(50 are required)")
    assert error.get("message") == f"not enough data: {undecided.partition(': ')[2]}"


def test_failures_with_equal_names_are_separate_test_cases(summary: Summary) -> None:
    """Two entries of one scenario and seed with different settings have equal labels."""
    failures = tuple(replace(summary.failures[0], key=key) for key in ("k1", "k2"))
    names = {suite.get("name") for suite in ET.fromstring(suite_junit(replace(summary, failures=failures)))}
    assert {"localise third, k1", "localise third, k2"} <= names


def test_refusals_of_equal_names_are_separate_test_cases(summary: Summary) -> None:
    """A source can be refused for two tasks, and two repeats of a source can be no longer part of a suite."""
    refusals = (Refusal("gone", "no data for 'localise'"), Refusal("gone", "no data for 'map'"))
    found = ET.fromstring(suite_junit(replace(summary, refusals=refusals)))
    messages = {error.get("message") for error in found.findall("testsuite/testcase/error")}
    assert {refusal.reason for refusal in refusals} <= messages


def test_parquet_has_the_same_columns_with_and_without_results(summary: Summary, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra [suite]")
    write_parquet(summary, tmp_path / "full")
    write_parquet(replace(summary, results=()), tmp_path / "empty")
    full, empty = (parquet.read_table(tmp_path / name) for name in ("full", "empty"))
    assert full.schema.equals(empty.schema)
    rows, score = full.to_pylist(), summary.results[0].score
    assert len(rows) == 2 * len(score.figures)
    assert set(summary.results[0].names()) <= set(full.schema.names)
    first = next(row for row in rows if row["figure"] == "position")
    assert first["mean_plus_3sigma"] == score.number("position", "mean_plus_3sigma")
    assert (first["label"], first["condition"], first["part"]) == ("localise first, default", "distance=1", "pose")
    assert (str(full.schema.field("n").type), first["value"]) == ("int64", None)


def test_mlflow_has_the_figures_and_the_files(
    summary: Summary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracking = pytest.importorskip("mlflow.tracking", reason="needs the extra [mlflow]")
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "suite.json").write_text("{}")
    uri = f"file://{tmp_path}/runs"
    client = tracking.MlflowClient(uri)
    run = client.get_run(log_to_mlflow(summary, tmp_path / "out", uri))
    row = summary.groups[0].figures[0]
    name = f"localise/default/{label_of(row.condition)}/position/mean_plus_3sigma"
    assert run.data.metrics[name] == pytest.approx(row.mean_plus_3sigma)
    assert (run.data.metrics["failed"], run.info.status, run.data.tags["sfr.host"]) == (1.0, "FAILED", "h")
    assert [item.path for item in client.list_artifacts(run.info.run_id)] == ["suite.json"]
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises(OutputError, match="rejected the run"):
        log_to_mlflow(summary, tmp_path / "out", "http://127.0.0.1:9")
