"""Failures of jobs on local Dask workers: memory, time, crash and bad input fail one job, each with its cause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs the extra [suite]")
from helpers.made_suites import JOB, recording
from sfr_loc_map.suite.running import cluster
from sfr_loc_map.suite.running.cluster import SuiteWorkers, connected, run_jobs
from sfr_loc_map.suite.running.job_outcome import FailureCause
from sfr_loc_map.suite.running.specification import SuiteSettings

TRIES = 2
EXPECTED = {
    "memory": (FailureCause.MEMORY, TRIES, "MB of memory, more than the limit of its worker"),
    "hang": (FailureCause.TIME, TRIES, "not finished after 5 s"),
    "crash": (FailureCause.DIED, TRIES, "killed or crashed"),
    "input": (FailureCause.BAD_INPUT, 1, "no such data set"),
    "fault": (FailureCause.FAULT, TRIES, "ValueError: odd"),
    "flaky": (None, TRIES, ""),
    "good": (None, 1, ""),
}
"""Cause, tries and message by what a job does."""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_job_that_fails_has_its_cause_and_fails_no_other_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from helpers.misbehaving_jobs import Misbehaving

    monkeypatch.setattr(cluster, "TRIES", TRIES)  # one try fewer than usual: each costs the start of a worker
    jobs = [replace(JOB, source=recording(name, sha256=name)) for name in EXPECTED]
    with connected(SuiteSettings(memory_mb=600), workers=2, scheduler=None) as client:
        client.register_plugin(Misbehaving())
        at_work = SuiteWorkers(client, print, 60.0)
        found = {job.source.name: outcome for job, outcome in run_jobs(client, jobs, 5.0, tmp_path, at_work)}
    for name, (cause, tries, words) in EXPECTED.items():
        assert found[name].cause == cause, name
        assert (found[name].result is None) == (cause is not None)
        assert words in found[name].message
        tried = (tmp_path / name).stat().st_size
        # what only waited on a worker that another ended, or whose result was lost with it, is run once more
        assert tried == tries or (name not in ("memory", "hang", "crash") and tried > tries), name
