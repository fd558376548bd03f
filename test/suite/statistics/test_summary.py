"""The decision of a running suite: each result is read and judged once."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from helpers.made_suites import JOB
from sfr_loc_map.metrics.records import Provenance
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.suite.running.job import Job
from sfr_loc_map.suite.running.job_outcome import JobOutcome
from sfr_loc_map.suite.running.store import Store
from sfr_loc_map.suite.statistics.summary import SequentialDecision


def test_a_sequential_decision_reads_each_result_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, jobs = Store(tmp_path), [dataclasses.replace(JOB, repeat=number) for number in range(3)]
    store.save_plan(jobs)
    read: list[str] = []
    score_of_job = Store.score

    def counted(self: Store, job: Job) -> Score:
        read.append(job.key)
        return score_of_job(self, job)

    def save(job: Job) -> None:
        provenance = Provenance(version="", configuration={"suite.key": job.key})
        store.save(job, JobOutcome(result=to_json(Score(figures=(), provenance=provenance))))

    save(jobs[0])
    monkeypatch.setattr(Store, "score", counted)
    decision = SequentialDecision(store, jobs, None)
    for job in jobs[1:]:
        save(job)
        decision.add(job)
        assert not decision.is_made, "no limit is decided"
    assert read == [job.key for job in jobs]
