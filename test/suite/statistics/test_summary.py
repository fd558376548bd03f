"""The decision of a running suite: each result is read and judged once."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from msgspec.structs import replace as struct_replace

from helpers.cli_result import Sfr
from helpers.made_suites import JOB, recording, save_jobs
from helpers.random_drives import drive, score_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.records import InputFile, MethodKind, MethodRecord, Provenance
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.jobs.job_outcome import JobOutcome
from sfr_loc_map.suite.pages.tables import suite_tables
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.run import PlannedRun
from sfr_loc_map.suite.statistics.scored_job import ResultReader
from sfr_loc_map.suite.statistics.summary import summarise
from sfr_loc_map.suite.store import Store


def save_score(store: Store, job: Job, score: Score) -> None:
    """Save a score as the result of a job."""
    provenance = Provenance(version="", configuration={"suite.key": job.key})
    store.save(job, JobOutcome(result=to_json(struct_replace(score, provenance=provenance))))


def test_a_planned_group_without_a_result_is_undecided(tmp_path: Path) -> None:
    """The sequential test of the group without a fault passes after 6 drives; the group with a fault has no result."""
    terms = {"limit": 10.0, "prob": 0.75, "confidence": 0.75, "power": 0.75, "good": 0.05, "interpretation": "ensemble"}
    limits = {"trajectory": [{"condition": "distance=5", "position_bound_m": terms}]}
    sources = [recording(sha256=str(number)) for number in range(12)]
    clean = [dataclasses.replace(JOB, source=source) for source in sources]
    faulty = [dataclasses.replace(job, faults="black") for job in clean]
    store = Store(tmp_path)
    save_jobs(store, [*clean, *faulty], limits=limits)
    parsed = parse_limits(limits, "limits")
    planned = PlannedRun(plan=store.plan, reader=ResultReader(store, parsed), jobs=())
    states = []
    config = TrajectoryScoreConfig(conditions=("distance=5",))
    drives = [drive(number, count=60) for number in range(len(sources))]
    scores = [score_of(estimate, truth, config) for truth, estimate in drives]
    for job, score in zip((*clean, *faulty), scores * 2, strict=True):
        save_score(store, job, score)
        states.append(planned.is_decided())
        if job is clean[-1]:
            found = summarise(store)
            assert [item.state for item in found.on_limits] == ["pass"]
            assert not found.is_decided
            assert found.verdict == "incomplete"
    assert not any(states[:12])
    assert states[-1]
    assert summarise(store).verdict == "pass"


def test_a_suite_with_limits_and_without_a_result_is_incomplete(sfr: Sfr, tmp_path: Path) -> None:
    """No group has a verdict, because the only job waits."""
    suite, store = tmp_path / "suite.yaml", Store(tmp_path / "out")
    limits = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}]}
    suite.write_text(json.dumps({"sources": ["a"], "limits": limits}))
    save_jobs(store, [JOB], limits=limits, files=[suite])
    assert summarise(store).verdict == "incomplete"
    done = sfr("suite", "report", store.folder)
    assert done.code == 3
    assert "1 of 1 jobs have no result yet" in done.err
    save_jobs(store, [JOB])
    assert summarise(store).verdict is None


def test_a_report_of_a_suite_names_each_refused_source(sfr: Sfr, tmp_path: Path) -> None:
    suite, store = tmp_path / "suite.yaml", Store(tmp_path / "out")
    suite.write_text("sources: [gone.mcap]\n")
    save_jobs(store, [], [Refusal("gone.mcap", "source 'gone.mcap': no match")], files=[suite])
    done = sfr("suite", "report", store.folder, "--json", "-")
    assert done.code == 2
    assert "skipped: source 'gone.mcap': no match" in done.err


def test_a_plan_of_an_earlier_version_is_refused_in_one_line(tmp_path: Path) -> None:
    """The key `task` of a job was `kind`."""
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    plan = json.loads((tmp_path / "plan.json").read_text())
    plan["jobs"][0]["kind"] = plan["jobs"][0].pop("task")
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    with pytest.raises(InputError, match="run the suite again") as caught:
        summarise(Store(tmp_path))
    assert len(str(caught.value).splitlines()) == 1


def test_a_ground_truth_in_place_of_that_of_the_recording_is_listed(tmp_path: Path) -> None:
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    inputs = {"truth_file": InputFile(path="survey.csv", sha256="0")}
    provenance = Provenance(version="", configuration={"suite.key": JOB.key}, inputs=inputs)
    store.save(JOB, JobOutcome(result=to_json(Score(figures=(), provenance=provenance))))
    summary = summarise(store)
    assert [(item.source, item.path) for item in summary.replaced_truths] == [("a", "survey.csv")]
    (table,) = (table for table in suite_tables(summary) if table.name == "truths")
    assert [cell.text for cell in table.rows[0]] == ["a", "survey.csv"]


def test_a_run_reads_each_result_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, jobs = Store(tmp_path), [dataclasses.replace(JOB, repeat=number) for number in range(3)]
    save_jobs(store, jobs)
    read: list[str] = []
    score_of_job = Store.score

    def counted(self: Store, job: Job) -> Score:
        read.append(job.key)
        return score_of_job(self, job)

    def save(job: Job) -> None:
        save_score(store, job, Score(figures=()))

    save(jobs[0])
    monkeypatch.setattr(Store, "score", counted)
    planned = PlannedRun(plan=store.plan, reader=ResultReader(store, None), jobs=())
    for job in jobs[1:]:
        save(job)
        assert not planned.is_decided(), "no limit is decided"
    summarise(store, reader=planned.reader)
    assert read == [job.key for job in jobs]


@pytest.mark.parametrize(
    ("configuration", "name", "is_judged"),
    [("-", "nav", True), ("-", "otherloc", False), ("nav", "otherloc", False), ("nav", "nav", True)],
)
def test_given_results_are_of_the_items_of_the_suite(
    tmp_path: Path, configuration: str, name: str, is_judged: bool
) -> None:
    """The calls of given results name their item, which is compared with that of the other groups."""
    localised = dataclasses.replace(JOB, task=JobTask.LOCALISE, configuration=configuration)
    given = dataclasses.replace(JOB, task=JobTask.SCORE, configuration="-")
    store = Store(tmp_path)
    save_jobs(store, [localised, given])
    for number, (job, item) in enumerate(((localised, "nav"), (given, name))):
        truth, estimate = drive(number, count=60)
        score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
        method = MethodRecord(name=item, version="7", kind=MethodKind.PYTHON)
        save_score(store, job, struct_replace(score, method=method))
    found = summarise(store)
    assert (found.verdict is None) == is_judged
    assert any(f"{name} 7" in item.text for item in found.deviations) != is_judged
