"""Summary of a suite's results: counts of jobs, groups, error budgets, failures, copies of drives and deviations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from msgspec import Struct

from sfr_loc_map import __version__
from sfr_loc_map.metrics.completeness.expected_items import suite_completeness
from sfr_loc_map.metrics.config import VerdictState, worst_of
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import JobFailure, JobState, WorkerRecord
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.statistics.budget import Budget, budgets_of
from sfr_loc_map.suite.statistics.common_deviations import CommonDeviation, common_deviations
from sfr_loc_map.suite.statistics.figures import ComparedFigure, figures_of
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict
from sfr_loc_map.suite.statistics.groups import Group, are_decided, groups_of
from sfr_loc_map.suite.statistics.looks import deviations_of_looks
from sfr_loc_map.suite.statistics.scored_job import ResultReader, ScoredJob
from sfr_loc_map.suite.store import Store

SCHEMA = "sfr-suite/1"


@dataclass(frozen=True, slots=True)
class ReplacedTruth:
    """A source whose ground truth is another file than that of the recording."""

    source: str  #: Name of the source.
    path: str  #: File of the ground truth (`truth.source` in `sfr.yaml`).


class JobCounts(Struct, frozen=True, kw_only=True):
    """Numbers of jobs by their state."""

    jobs: int  #: Number of planned jobs.
    done: int
    failed: int
    waiting: int

    @property
    def text(self) -> str:
        """The numbers in words."""
        return f"{self.done} of {self.jobs} jobs done, {self.failed} failed, {self.waiting} waiting"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The summary of a suite's results."""

    groups: tuple[Group, ...]
    results: tuple[ScoredJob, ...]  #: Scores of the finished jobs: drives, maps and repeats.
    failures: tuple[JobFailure, ...]
    refusals: tuple[Refusal, ...]
    code: str  #: Fingerprint of the code.
    workers: tuple[WorkerRecord, ...] = ()  #: Workers of all runs of the suite.
    run: Mapping[str, object] = field(default_factory=dict)  #: Commit, branch and date of the code; host and time.
    budgets: tuple[Budget, ...] = ()  #: Error budgets, by configuration and condition.
    waiting_jobs: tuple[str, ...] = ()  #: Labels of the jobs that were not run yet.
    is_decided: bool = False  #: Whether sequential tests have decided all limits, so that no more drives are required.
    copies: tuple[tuple[str, ...], ...] = ()  #: Names of the sources that are copies or parts of one drive.
    replaced_truths: tuple[ReplacedTruth, ...] = ()
    deviations: tuple[CommonDeviation, ...] = ()
    limits: Limits | None = None  #: Limits of the suite; None if there are none.

    @property
    def counts(self) -> JobCounts:
        """Numbers of all, done, failed and waiting jobs."""
        done = len(self.results)
        failed = len(self.failures)
        waiting = len(self.waiting_jobs)
        return JobCounts(jobs=done + failed + waiting, done=done, failed=failed, waiting=waiting)

    @property
    def is_judged(self) -> bool:
        """Whether the suite has limits, even if no job has a result yet, or verdicts on findings."""
        return self.limits is not None or any(group.verdicts for group in self.groups)

    @property
    def verdict(self) -> VerdictState | None:
        """The worst verdict, None if the suite is not judged; incomplete at best if a job has no result."""
        if not self.is_judged:
            return None
        states = [item.state for group in self.groups for item in group.verdicts]
        is_complete = bool(states) and self.completeness.value == 1.0
        return worst_of(states if is_complete else [*states, VerdictState.INCOMPLETE])

    @property
    def on_limits(self) -> list[GroupVerdict]:
        """The verdicts on limits. Verdicts on findings, contradictions and missing results have no figure."""
        return [item for group in self.groups for item in group.verdicts if item.figure is not None]

    def score_of(self, group: Group) -> Score:
        """Return the pooled figures and verdicts of a group as a score.

        The rules of this score have the minimum counts of the suite's limits but not the limits, so that `on_limits` of
        the score is empty.
        """
        limits = self.limits or Limits()
        rules = Limits(minimum_count=limits.minimum_count, minimum_independent=limits.minimum_independent)
        return Score(figures=group.figures, verdicts=group.verdicts, rules=rules)

    @property
    def not_run(self) -> tuple[str, ...]:
        """Labels of the jobs that were not run because sequential tests had decided all limits."""
        return self.waiting_jobs if self.is_decided else ()

    @property
    def completeness(self) -> Figure:
        """The row with the number of planned jobs and the fraction that has a result.

        Waiting jobs are not required once sequential tests have decided all limits.
        """
        counts = self.counts
        needed = counts.done + counts.failed if self.is_decided else counts.jobs
        planned = needed + len(self.refusals)
        return suite_completeness(counts.done, planned or None)

    @property
    def compared_figures(self) -> tuple[ComparedFigure, ...]:
        """Figures of the results that comparisons and histories use."""
        return tuple(dict.fromkeys(figure for result in self.results for figure in figures_of(result.score)))

    def to_dict(self) -> dict[str, object]:
        """Return the summary as JSON values; each result has its names, figures, verdicts and the file of its score."""
        rows = ("deviations", "groups", "failures", "refusals", "workers", "budgets", "copies", "replaced_truths")
        named = ("verdict", *rows)
        parts = {name: to_plain(getattr(self, name)) for name in named}
        parts["waiting_jobs"] = [] if self.is_decided else list(self.waiting_jobs)
        parts["not_run"] = list(self.not_run)
        head = {"schema": SCHEMA, "version": __version__, "code": self.code}
        head["counts"] = to_plain(self.counts)
        parts["compared_figures"] = to_plain(self.compared_figures)
        return {**head, **self.run, **parts, "results": [result.to_dict() for result in self.results]}


def summarise(store: Store, reader: ResultReader | None = None) -> Summary:
    """Read the results in the folder of a suite, judge them by the limits of the plan, and return their summary.

    A `reader` with the limits of the plan may have read some of the results before. InputError if the plan, a result or
    a failure cannot be read, or if a result is not that of its job.
    """
    plan = store.plan
    jobs = plan.jobs
    if reader is None:
        limits = parse_limits(plan.stated_limits, f"'{store.plan_file}': limits") if plan.stated_limits else None
        reader = ResultReader(store, limits)
    in_state: dict[JobState, list[Job]] = {state: [] for state in JobState}
    for job in jobs:
        in_state[store.state(job)].append(job)
    results = reader.results_of(in_state[JobState.DONE])
    unfinished = [*in_state[JobState.FAILED], *in_state[JobState.WAITING]]
    groups = tuple(groups_of(results, reader.limits, unfinished))
    return Summary(
        groups=groups,
        results=tuple(results),
        failures=tuple(store.failure(job) for job in in_state[JobState.FAILED]),
        refusals=(*plan.refusals, *store.left_over()),
        code=jobs[0].code if jobs else "",
        workers=store.workers(),
        run=to_plain(plan.run),
        budgets=tuple(budgets_of(results, jobs)),
        waiting_jobs=tuple(job.label for job in in_state[JobState.WAITING]),
        is_decided=are_decided(groups, jobs),
        copies=tuple(copies_in(jobs)),
        replaced_truths=replaced_truths_in(results),
        deviations=(*deviations_of_looks(plan, groups, results), *common_deviations(results)),
        limits=reader.limits,
    )


def copies_in(jobs: Sequence[Job]) -> Iterator[tuple[str, ...]]:
    """Yield the names of the sources that are copies or parts of one drive, for each drive with several sources."""
    names: dict[object, dict[str, None]] = {}
    for job in jobs:
        of_drive = names.setdefault(job.source.drive_identity, {})
        of_drive |= dict.fromkeys((job.source.name, *job.source.identical))
    yield from (tuple(of_drive) for of_drive in names.values() if len(of_drive) > 1)


def replaced_truths_in(results: Sequence[ScoredJob]) -> tuple[ReplacedTruth, ...]:
    """Return the sources whose results have another ground truth than that of the recording, each once."""
    found: dict[ReplacedTruth, None] = {}
    for result in results:
        provenance = result.score.provenance
        file = None if provenance is None else provenance.inputs.get("truth_file")
        if file is not None:
            found[ReplacedTruth(result.job.source.name, file.path)] = None
    return tuple(found)
