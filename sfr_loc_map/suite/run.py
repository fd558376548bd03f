"""A suite from its file to its summary: what `sfr suite run` does, for programs as well."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from sfr_loc_map.errors import InterruptedRunError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.signals import hold
from sfr_loc_map.suite.running.cluster import SuiteWorkers, connected, run_jobs
from sfr_loc_map.suite.running.job import Job, JobOutcome
from sfr_loc_map.suite.running.plan import make_plan
from sfr_loc_map.suite.running.specification import Refusal, SuiteSettings, SuiteSpecification
from sfr_loc_map.suite.running.store import Store
from sfr_loc_map.suite.statistics.summary import SequentialDecision, Summary, summarise

if TYPE_CHECKING:
    from distributed import Client

Say = Callable[[str], None]
"""Takes a line of what is reported while a suite runs."""
Progress = Callable[[int, int, tuple[Job, JobOutcome] | None], None]
"""Takes the number of the tasks that are done, of all of them, and the last one with its outcome, None at the start."""


def run_suite(
    specification: SuiteSpecification,
    store: Store,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    say: Say = lambda line: None,
    progress: Progress = lambda done, total, last: None,
) -> Summary:
    """Run the tasks of a suite that have no result yet, write its page, and return what follows from all results.

    The tasks run on `workers` processes of this host, by default one a core, or on the Dask cluster of a `scheduler`.
    InterruptedRunError if a signal ended it, after what was done is reported.
    """
    settings = specification.settings
    interrupted = False
    with store.locked():
        planned, refusals = planned_jobs(specification, store)
        store.plan(planned, refusals, specification.limits, specification.files)
        for refusal in refusals:
            say(f"left out: {refusal.reason}")
        jobs = open_jobs(planned, store, settings, retry_failed=retry_failed)
        try:
            if jobs:
                slots = min(slots_for(settings, workers), len(jobs))
                with suite_workers(store, settings, slots, scheduler, say) as (client, at_work):
                    run_and_keep(jobs, store, settings, client, at_work, say, progress)
        except KeyboardInterrupt:
            interrupted = True
        finally:  # whatever ended it, the suite reports what it has
            hold()
            from sfr_loc_map.suite.pages.page import write_summary  # its imports take as long as all of the start

            summary = summarise(store)
            write_summary(summary, store)
    if interrupted:
        done = f"{summary.counts['done']} of {summary.tasks} tasks are done and reported"
        raise InterruptedRunError(f"interrupted: {done}; the same command continues")
    return summary


def planned_jobs(specification: SuiteSpecification, store: Store) -> tuple[list[Job], list[Refusal]]:
    """Return the jobs of a suite and its unreadable sources; the folder keeps what is known of the sources."""
    return make_plan(specification, store.facts_of, store.cache)


def open_jobs(planned: Sequence[Job], store: Store, settings: SuiteSettings, *, retry_failed: bool) -> list[Job]:
    """Return the jobs that have to be run; a sequential test takes their drives in this order."""
    wanted = ("waiting", "failed") if retry_failed else ("waiting",)
    jobs = [job for job in planned if store.state(job.key) in wanted]
    if settings.stop_when_decided:
        jobs.sort(key=lambda job: (job.drive, job.key))
    return jobs


def slots_for(settings: SuiteSettings, workers: int | None) -> int:
    """Return how many jobs run at a time on this host: as many as `workers`, by default one a core."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return workers or max(1, cores // settings.threads)


@contextmanager
def suite_workers(
    store: Store, settings: SuiteSettings, slots: int, scheduler: str | None, say: Say
) -> Iterator[tuple[Client, SuiteWorkers]]:
    """Yield a client of Dask and its workers; what they did is kept in the folder."""
    with connected(settings, workers=slots, scheduler=scheduler) as client:
        at_work = SuiteWorkers(client, lambda text: say(one_line(text)), settings.wait_s)
        try:
            yield client, at_work
        finally:
            store.add_workers(list(at_work.records.values()))


def run_and_keep(
    jobs: Sequence[Job],
    store: Store,
    settings: SuiteSettings,
    client: Client,
    at_work: SuiteWorkers,
    say: Say,
    progress: Progress,
) -> None:
    """Run jobs and keep what comes of each, until sequential tests have decided if the suite ends then."""
    decision = SequentialDecision(store) if settings.stop_when_decided else None
    with closing(run_jobs(client, jobs, settings.timeout_s, store.cache, at_work)) as outcomes:
        progress(0, len(jobs), None)
        for done, (job, outcome) in enumerate(outcomes, 1):
            store.save(job, outcome)
            progress(done, len(jobs), (job, outcome))
            if decision is None:
                continue
            decision.add(job)
            if decision.is_made:
                say(f"decided after {done} of {len(jobs)} tasks: the others are not needed")
                break
