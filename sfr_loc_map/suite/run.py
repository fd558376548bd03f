"""Runs a suite or a search from its file to its pages, for `sfr suite run`, `sfr suite search` and for programs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msgspec.structs import replace as struct_replace

from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import InterruptedRunError, SfrError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.metrics.stored.score_json import json_line
from sfr_loc_map.signals import hold
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome, JobState
from sfr_loc_map.suite.planning.data_set import check_data_sets
from sfr_loc_map.suite.planning.plan import Plan, make_plan
from sfr_loc_map.suite.planning.source_inspection import has_changed
from sfr_loc_map.suite.planning.specification import SuiteSettings, SuiteSpecification
from sfr_loc_map.suite.statistics.groups import are_decided, groups_of
from sfr_loc_map.suite.statistics.looks import looks_before
from sfr_loc_map.suite.statistics.scored_job import ResultReader
from sfr_loc_map.suite.statistics.summary import Summary, summarise
from sfr_loc_map.suite.store import Store
from sfr_loc_map.suite.workers.cluster import SuiteWorkers, connected, run_jobs

if TYPE_CHECKING:
    from sfr_loc_map.suite.search.record import SearchRecord
    from sfr_loc_map.suite.search.specification import SearchSpecification

Say = Callable[[str], None]
"""Function that prints a line of progress of a suite."""
Progress = Callable[[int, int, tuple[Job, JobOutcome] | None], None]
"""Function that reports progress. Its arguments are the number of finished jobs, the number of all jobs, and the last
job with its outcome (None at the start)."""


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
    """Run the jobs of a suite that have no result yet, write the page of the suite, and return the summary.

    The jobs run on `workers` processes of this host (default: `slots_for`), or on the Dask cluster of a `scheduler`
    (its address). With `retry_failed`, failed jobs are repeated. `say` receives each message, and `progress` each
    finished job.

    OutputError if another run uses the folder, or if the folder belongs to another suite or to a search. InputError if
    a stored result is damaged, if the data are not those that the limits name, or if no worker is usable. If an error
    or a signal ends the run, the summary of the finished jobs is written. A signal raises InterruptedRunError.
    """
    settings = specification.settings
    with store.locked():
        planned = plan_run(specification, store, retry_failed=retry_failed)
        store.save_plan(planned.plan)
        planned.check_finished(store)
        for text in planned.texts:
            say(text)
        is_decided = planned.is_decided if settings.stop_when_decided else None
        try:
            if planned.jobs:
                slots = min(slots_for(settings, workers), len(planned.jobs))
                with suite_workers(store, settings, slots, scheduler, say) as at_work:
                    run_and_keep(planned.jobs, store, at_work, say, progress, is_decided)
        except KeyboardInterrupt as error:
            counts = _reported(store, planned.reader).counts
            raise InterruptedRunError(
                f"interrupted: {counts.done} of {counts.jobs} jobs are done and reported; repeat the command to run "
                "the others"
            ) from error
        except Exception:
            with suppress(SfrError):  # the error of the run is raised, and not an error of its report
                _reported(store, planned.reader)
            raise
        return _reported(store, planned.reader)


def _reported(store: Store, reader: ResultReader) -> Summary:
    """Write the page of a suite from its finished jobs, and return the summary. Signals are ignored from now on."""
    hold()
    from sfr_loc_map.suite.pages.page import write_summary  # imported late, because the import is slow

    summary = summarise(store, reader=reader)
    write_summary(summary, store)
    return summary


def run_search(
    specification: SearchSpecification,
    store: Store,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    at_random: bool = False,
    say: Say = lambda line: None,
    progress: Progress = lambda done, total, last: None,
) -> SearchRecord:
    """Search for the worst case, write the page and the file of the case, and return the record.

    `workers`, `scheduler` and `say` are those of `run_suite`. Workers are only started if a point has no result yet.
    With `at_random`, all points are drawn uniformly. `progress` counts the jobs of a batch of points.

    OutputError if another run uses the folder or if the folder belongs to a suite or to another search. InputError if
    the unchanged scenario cannot be run or lacks the figure, if no point can be run, if a job fails for a reason other
    than invalid input, or if no worker is usable. MissingExtraError without optuna or Dask.
    """
    # imported late, because the imports are slow
    from sfr_loc_map.suite.pages.search_page import render_search
    from sfr_loc_map.suite.search.search import CASE, find_worst_case

    settings = specification.running
    slots = slots_for(settings, workers)
    with store.locked(), ExitStack() as stack:
        store.check_owner(specification.path, is_search=True)
        if not store.plan_file.exists():  # a search that is killed before it saves its plan keeps its folder
            store.save_plan(Plan.of_search(specification.path))
        at_work: SuiteWorkers | None = None  # started before the first job

        def run_points(jobs: Sequence[Job]) -> None:
            nonlocal at_work
            if at_work is None:
                at_work = stack.enter_context(suite_workers(store, settings, slots, scheduler, say))
            run_and_keep(jobs, store, at_work, say, progress)

        record, case_file = find_worst_case(specification, store, run_points, at_random=at_random)
        write_text(json_line(record), store.folder / "search.json")
        write_text(render_search(record), store.folder / "search.html")
        write_text(case_file, store.folder / CASE)
    return record


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRun:
    """A run of a suite before any job is executed."""

    plan: Plan  #: All jobs of the suite, and the refused sources.
    reader: ResultReader  #: Reads the results, and judges them by the limits of the suite.
    jobs: Sequence[Job]  #: Jobs to execute, in their order.
    not_needed: int = 0  #: Number of waiting jobs that are skipped, because the existing results decide all limits.

    @property
    def texts(self) -> Iterator[str]:
        """Lines about skipped sources and skipped jobs."""
        for refusal in self.plan.refusals:
            yield f"skipped: {refusal.reason}"
        if self.not_needed:
            yield f"decided by the existing results: {self.not_needed} waiting jobs are not needed"

    def check_finished(self, store: Store) -> None:
        """Read all results and failures in the folder; InputError if one of them is damaged or is not that of its job.

        A run calls this before its first job, so that a damaged file is reported before the work and not after it.
        """
        self.reader.results_of(self.plan.jobs)
        for job in self.plan.jobs:
            if store.state(job) is JobState.FAILED:
                store.failure(job)
        store.left_over()

    def is_decided(self) -> bool:
        """Return whether the results that exist now decide all limits by sequential tests."""
        jobs = self.plan.jobs
        results = self.reader.results_of(jobs)
        finished = {result.job.key for result in results}
        unfinished = [job for job in jobs if job.key not in finished]
        return are_decided([*groups_of(results, self.reader.limits, unfinished)], jobs)


def plan_run(specification: SuiteSpecification, store: Store, *, retry_failed: bool) -> PlannedRun:
    """Return all jobs of a suite, and the jobs to execute. The facts of the sources are cached in the folder.

    For sequential tests, the jobs are executed drive by drive. Once these tests have decided all limits, only failed
    jobs are executed, if `retry_failed` is set. OutputError if the folder belongs to another suite or to a search.
    InputError if the limits name another data set than that of a job.
    """
    store.check_owner(specification.path)
    plan = make_plan(specification, store.cache, store.earlier_plan)
    wanted = (JobState.WAITING, JobState.FAILED) if retry_failed else (JobState.WAITING,)
    jobs = [job for job in plan.jobs if store.state(job) in wanted]
    missing = check_data_sets(plan.jobs, jobs, specification.limits)
    plan = struct_replace(plan, looks=looks_before(plan, store), refusals=(*plan.refusals, *missing))
    planned = PlannedRun(plan=plan, reader=ResultReader(store, specification.limits), jobs=jobs)
    if not jobs or not specification.settings.stop_when_decided:
        return planned
    if planned.is_decided():
        failed = [job for job in jobs if store.state(job) is JobState.FAILED]
        return replace(planned, jobs=failed, not_needed=len(jobs) - len(failed))
    return replace(planned, jobs=sorted(jobs, key=lambda job: (job.drive_order, job.key)))


def slots_for(settings: SuiteSettings, workers: int | None) -> int:
    """Return the number of parallel jobs on this host: `workers`, or the number of cores divided by threads per job."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return workers or max(1, cores // settings.threads)


@contextmanager
def suite_workers(
    store: Store, settings: SuiteSettings, slots: int, scheduler: str | None, say: Say
) -> Iterator[SuiteWorkers]:
    """Yield the workers of a Dask client. Their records are saved in the folder."""
    with connected(settings, workers=slots, scheduler=scheduler) as client:
        at_work = SuiteWorkers(client, settings, lambda text: say(one_line(text)))
        try:
            yield at_work
        finally:
            store.add_workers(list(at_work.records.values()))


def run_and_keep(
    jobs: Sequence[Job],
    store: Store,
    at_work: SuiteWorkers,
    say: Say,
    progress: Progress,
    is_decided: Callable[[], bool] | None = None,
) -> None:
    """Run jobs on workers, and save each outcome when the job has finished.

    A job fails if the files of its source have changed since the plan hashed them, because its result would not be that
    of the planned data. The run stops as soon as `is_decided` states that the saved results decide all limits. `say`
    receives the message about this end.
    """
    with closing(run_jobs(jobs, at_work, store.cache)) as outcomes:
        progress(0, len(jobs), None)
        for done, (job, found) in enumerate(outcomes, 1):
            outcome = source_changed(job) if has_changed(job.source) else found
            store.save(job, outcome)
            progress(done, len(jobs), (job, outcome))
            if is_decided is not None and is_decided():
                say(f"the limits are decided after {done} of {len(jobs)} jobs: the remaining jobs are not needed")
                break


def source_changed(job: Job) -> JobOutcome:
    """Return the outcome of a job whose source was changed after the plan was made."""
    message = f"'{job.source.path}' was changed while the suite was running: repeat the command"
    return JobOutcome(cause=FailureCause.BAD_INPUT, message=message)
