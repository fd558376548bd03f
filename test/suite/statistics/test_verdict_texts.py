"""The texts about a suite that has no limits or no verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.cli_result import Sfr
from helpers.made_suites import made_suite
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.suite import Store, Summary, load_specification, make_plan, summarise
from sfr_loc_map.suite.jobs.job_outcome import JobOutcome
from sfr_loc_map.suite.jobs.job_run import run_job
from sfr_loc_map.suite.statistics.verdict_texts import verdict_texts_of

LIMITS = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 1.0}]}


def summary_of(suite: Path, out: Path) -> Summary:
    store = Store(out)
    specification = load_specification(suite)
    plan = make_plan(specification, store.cache)
    store.save_plan(plan)
    for job in plan.jobs:
        store.save(job, JobOutcome(result=to_json(run_job(job, out, store.cache))))
    return summarise(store)


def test_a_condition_that_no_drive_has_is_reported(tmp_path: Path) -> None:
    conditions = ["distance=1000", "distance=1"]
    texts = verdict_texts_of(summary_of(made_suite(tmp_path, 1, conditions=conditions), tmp_path / "out"))
    (text,) = texts.without_drives
    assert "distance=1000" in text


@pytest.mark.parametrize(("content", "code"), [({}, 3), ({"limits": LIMITS}, 0)], ids=["no limits", "pass"])
def test_a_condition_that_no_drive_has_is_not_judged(
    sfr: Sfr, tmp_path: Path, content: dict[str, object], code: int
) -> None:
    """A suite that passes by its limits has no limit on the condition."""
    suite = made_suite(tmp_path, 2, conditions=["distance=1000", "distance=1"], **content)
    summary_of(suite, tmp_path / "out")
    assert sfr("suite", "report", tmp_path / "out").code == code
    assert sfr("suite", "report", tmp_path / "out", "--lenient").code == 0


def test_the_reason_of_an_incomplete_drive_is_reported(tmp_path: Path) -> None:
    """An estimate that is a copy of its truth is incomplete, although the estimate covers the drive."""
    suite = made_suite(tmp_path, 1, limits={"trajectory": [{"condition": "distance=1", "position_mean_m": 1.0}]})
    (tmp_path / "drive0.csv").write_bytes((tmp_path / "truth0.csv").read_bytes())
    summary = summary_of(suite, tmp_path / "out")
    (result,) = summary.results
    assert result.score.incomplete is not None
    (text,) = verdict_texts_of(summary).incomplete
    assert result.score.incomplete in text
    assert "covers" not in text
