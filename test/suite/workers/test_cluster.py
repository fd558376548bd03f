"""Failures of jobs on local Dask workers: memory, time, crash and bad input fail one job, each with its cause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs the extra [suite]")
from helpers.made_suites import JOB, recording
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome
from sfr_loc_map.suite.planning.specification import SuiteSettings
from sfr_loc_map.suite.workers import cluster
from sfr_loc_map.suite.workers.cluster import SuiteWorkers, connected, run_jobs

DEADLY = {
    "memory": (FailureCause.MEMORY, "MB of memory, more than the limit of its worker"),
    "hang": (FailureCause.TIME, "not finished after 5 s"),
    "crash": (FailureCause.DIED, "killed or crashed"),
}
OTHERS = {
    "input": (FailureCause.BAD_INPUT, "no such data set"),
    "fault": (FailureCause.FAULT, "ValueError: odd"),
    "flaky": (None, ""),
    "good": (None, ""),
}
"""Cause and message by what a job does: a job that is deadly kills its worker each time, a flaky job once."""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_job_that_fails_has_its_cause_and_fails_no_other_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each death costs the start of a worker, so that only the other jobs have a second try."""
    from helpers.misbehaving_jobs import Misbehaving

    found = {}
    settings = SuiteSettings(memory_mb=600, timeout_s=5.0, wait_s=60.0)
    for tries, names in ((1, DEADLY), (2, OTHERS)):
        monkeypatch.setattr(cluster, "TRIES", tries)
        with connected(settings, workers=2, scheduler=None) as client:
            client.register_plugin(Misbehaving())
            at_work = SuiteWorkers(client, settings, print)
            jobs = [replace(JOB, source=recording(name, sha256=name)) for name in names]
            for job, outcome in run_jobs(jobs, at_work, tmp_path):
                found[job.source.name] = outcome
    for name, (cause, words) in (DEADLY | OTHERS).items():
        assert found[name].cause == cause, name
        assert (found[name].result is None) == (cause is not None)
        assert words in found[name].message
    tried = {name: (tmp_path / name).stat().st_size for name in DEADLY | OTHERS}
    assert all(tried[name] == 1 for name in DEADLY), tried
    assert tried["flaky"] >= 2, tried


class Ended:
    """A future of Dask that has ended with this status, and whose result cannot be received or is an error."""

    def __init__(self, status: str, error: Exception) -> None:
        self.status = status
        self._error = error

    def result(self) -> JobOutcome:
        raise self._error


@pytest.mark.parametrize("error", [ConnectionError("closed"), TimeoutError("late"), ValueError("odd")])
def test_only_an_error_that_the_job_raised_is_its_failure(error: Exception) -> None:
    """If the result of a finished job cannot be received, the job has not failed and is repeated by the next run."""
    assert cluster._outcome_of(Ended("error", error), JOB, None).cause is FailureCause.FAULT
    with pytest.raises(type(error)):
        cluster._outcome_of(Ended("finished", error), JOB, None)
    with pytest.raises(ConnectionError, match="lost"):
        cluster._outcome_of(Ended("lost", error), JOB, None)
