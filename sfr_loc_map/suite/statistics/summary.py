"""Summary of a suite's results: counts of jobs, groups with pooled errors and verdicts, failures.

The results with the same task, configuration and faults form a group.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
from msgspec import Struct

from sfr_loc_map import __version__
from sfr_loc_map.metrics.completeness.expected_items import suite_completeness
from sfr_loc_map.metrics.config import VerdictState, worst_of
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limit_scope import limits_about, tasks_of
from sfr_loc_map.metrics.judging.proof import SEQUENTIAL
from sfr_loc_map.metrics.judging.several_scores import undeclared_items
from sfr_loc_map.metrics.score.limits import Limits, Rules
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.metrics.table.catalogue import KINDS
from sfr_loc_map.metrics.table.rows import Figure
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.suite.running.job import NO_CONFIGURATION, GroupKey, Job
from sfr_loc_map.suite.running.job_outcome import JobFailure, JobState, WorkerRecord
from sfr_loc_map.suite.running.specification import Refusal
from sfr_loc_map.suite.running.store import Store
from sfr_loc_map.suite.running.variants import error_sources_of
from sfr_loc_map.suite.statistics.budget import Budget, DriveErrors, budget_of
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict, verdicts_over
from sfr_loc_map.suite.statistics.pooling import DriveScore, pool, rows_by_axis

NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")  #: A number in a sentence.
SCHEMA = "sfr-suite/1"  #: Other programs read this version: its keys are fixed.


@dataclass(frozen=True, slots=True)
class ScoredJob:
    """A job with its score."""

    job: Job
    score: Score

    @property
    def of_drive(self) -> DriveScore:
        """The score with the keys by which repeats and copies of a drive are identified."""
        return DriveScore(self.job.drive_key, self.score, self.job.source.sha256)

    @property
    def position_m(self) -> float | None:
        """Mean + 3 sigma of the position error of the first condition, m; None without a trajectory."""
        return self.score.number("position", "mean_plus_3sigma")

    def names(self) -> dict[str, object]:
        """Return the names of the job as JSON values."""
        job = self.job
        return {
            "key": job.key,
            "label": job.label,
            "task": job.task.value,
            "source": job.source.name,
            "configuration": job.configuration,
            "faults": job.faults,
            "variant": job.source.variant,
            "seed": job.source.seed,
            "repeat": job.repeat,
        }

    def to_dict(self) -> dict[str, object]:
        """Return names, figures and verdicts of the result, and the file of its score, as JSON values."""
        content = self.names() | {
            "path": self.job.source.path,
            "pairing": self.job.pairing,
            "file": f"results/{self.job.key}.json",
            "figures": [[*to_plain(name).values(), value] for name, value in figures_of(self.score).items()],
            "verdicts": to_plain(self.score.verdicts),
        }
        for name in ("incomplete", "contradiction", "findings"):
            if value := getattr(self.score, name):
                content[name] = to_plain(value)
        return content


@dataclass(frozen=True, slots=True)
class ReplacedTruth:
    """A source whose ground truth is another file than that of the recording."""

    source: str  #: Name of the source.
    path: str  #: File of the ground truth (`truth.source` in `sfr.yaml`).


class CommonDeviation(Struct, frozen=True, kw_only=True):
    """A deviation of one or more results from the specification, or data of these results that is not judged."""

    text: str  #: The deviation of the result with the largest number in the text.
    results: int  #: Number of results with this deviation.
    of: str  #: Label of the result whose deviation is `text`.


class Group(Struct, frozen=True, kw_only=True):
    """The results with the same task, configuration and faults: counts, pooled errors, verdicts."""

    task: str
    configuration: str
    faults: str
    results: int = msgspec.field(name="drives")  #: Number of results, each repeat counted.
    lost: int
    matched: int
    figures: tuple[Figure, ...]  #: Errors over the sub-trajectories of all drives, by condition.
    verdicts: tuple[GroupVerdict, ...]

    @property
    def key(self) -> GroupKey:
        """What the jobs of the group have in common."""
        return GroupKey(self.task, self.configuration, self.faults)


class JobCounts(Struct, frozen=True, kw_only=True):
    """Numbers of jobs by their state."""

    jobs: int = msgspec.field(name="tasks")  #: Number of planned jobs.
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

    jobs: int  #: Number of planned jobs.
    waiting: int  #: Number of jobs that were not run yet.
    groups: tuple[Group, ...]
    results: tuple[ScoredJob, ...]  #: Scores of the finished jobs: drives, maps and repeats.
    failures: tuple[JobFailure, ...]
    refusals: tuple[Refusal, ...]
    code: str  #: Fingerprint of the code.
    order_seed: int = 0  #: Seed of the order in which sequential tests take the drives.
    workers: tuple[WorkerRecord, ...] = ()  #: Workers of all runs of the suite.
    run: Mapping[str, object] = field(default_factory=dict)  #: Commit, branch and date of the code; host and time.
    budgets: tuple[Budget, ...] = ()  #: Error budgets, by configuration and condition.
    waiting_jobs: tuple[str, ...] = ()  #: Labels of the jobs that were not run yet.
    planned_groups: tuple[GroupKey, ...] = ()  #: Groups of all planned jobs, also groups without a result.
    copies: tuple[tuple[str, ...], ...] = ()  #: Names of the sources that are copies or parts of one drive.
    replaced_truths: tuple[ReplacedTruth, ...] = ()
    deviations: tuple[CommonDeviation, ...] = ()
    limits: Limits | None = None  #: Limits of the suite; None if there are none.

    @property
    def counts(self) -> JobCounts:
        """Numbers of all, done, failed and waiting jobs."""
        done, failed = len(self.results), len(self.failures)
        return JobCounts(jobs=self.jobs, done=done, failed=failed, waiting=self.waiting)

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

        Its rules have the minimum counts of the suite's limits but not the limits, so that `on_limits` is empty.
        """
        limits = self.limits or Limits()
        rules = Rules(minimum_count=limits.minimum_count, minimum_independent=limits.minimum_independent)
        return Score(figures=group.figures, verdicts=group.verdicts, rules=rules)

    @property
    def is_decided(self) -> bool:
        """Whether sequential tests have decided all limits, so no more drives are required."""
        return are_decided(self.groups, self.planned_groups)

    @property
    def not_run(self) -> tuple[str, ...]:
        """Labels of the jobs that were not run because sequential tests had decided all limits."""
        return self.waiting_jobs if self.is_decided else ()

    @property
    def completeness(self) -> Figure:
        """The row with the number of planned jobs and the fraction that has a result.

        Waiting jobs are not required once sequential tests have decided all limits.
        """
        needed = self.jobs - self.waiting if self.is_decided else self.jobs
        planned = needed + len(self.refusals)
        return suite_completeness(len(self.results), planned or None)

    def to_dict(self) -> dict[str, object]:
        """Return the summary as JSON values; each result has its names, figures, verdicts and the file of its score."""
        rows = ("deviations", "groups", "failures", "refusals", "workers", "budgets", "copies", "replaced_truths")
        named = ("verdict", *rows)
        parts = {name: to_plain(getattr(self, name)) for name in named}
        parts["waiting_jobs"] = [] if self.is_decided else list(self.waiting_jobs)
        head = {"schema": SCHEMA, "version": __version__, "code": self.code, "order_seed": self.order_seed}
        head["counts"] = to_plain(self.counts)
        return {**head, **self.run, **parts, "drives": [result.to_dict() for result in self.results]}


def are_decided(groups: Sequence[Group], planned: Collection[GroupKey]) -> bool:
    """Return whether sequential tests have decided all limits of the planned groups.

    A planned group without a result is undecided.
    """
    has_all_groups = {group.key for group in groups}.issuperset(planned)
    items = [item for group in groups for item in group.verdicts]
    return bool(has_all_groups and items) and all(
        item.proof is not None
        and item.proof.method == SEQUENTIAL
        and item.state in (VerdictState.PASS, VerdictState.FAIL)
        for item in items
    )


def read_scored_job(job: Job, store: Store, limits: Limits | None) -> ScoredJob:
    """Read the result of a job, and judge the result by the limits that apply to its subjects."""
    score = store.score(job)
    of_score = limits_about(limits, tasks_of(score))
    return ScoredJob(job, judged_by(score, of_score, partial=job.scoring.partial))


class SequentialDecision:
    """Checks during a suite whether all limits are decided by sequential tests; reads and judges each result once."""

    def __init__(self, store: Store, jobs: Sequence[Job], limits: Limits | None) -> None:
        """Read the existing results of the jobs of a suite."""
        self._store, self._jobs, self._limits = store, jobs, limits
        self._planned = planned_groups_of(jobs)
        done = [job for job in jobs if store.state(job) is JobState.DONE]
        self._scored = {job.key: read_scored_job(job, store, limits) for job in done}

    def add(self, job: Job) -> None:
        """Read the result of a finished job."""
        if self._store.state(job) is JobState.DONE:
            self._scored[job.key] = read_scored_job(job, self._store, self._limits)
        else:
            self._scored.pop(job.key, None)

    @property
    def is_made(self) -> bool:
        """Whether no more drives are required."""
        results = [self._scored[job.key] for job in self._jobs if job.key in self._scored]
        unfinished = [job for job in self._jobs if job.key not in self._scored]
        return are_decided([*groups_of(results, self._limits, unfinished)], self._planned)


def summarise(store: Store, unchecked: Sequence[str] = ()) -> Summary:
    """Return the summary of the results in a suite's folder.

    `unchecked` are sentences about parts of the plan that were not compared with the suite. They are deviations.
    """
    jobs, limits = store.jobs, store.limits
    in_state: dict[JobState, list[Job]] = {state: [] for state in JobState}
    for job in jobs:
        in_state[store.state(job)].append(job)
    results = [read_scored_job(job, store, limits) for job in in_state[JobState.DONE]]
    unfinished = [*in_state[JobState.FAILED], *in_state[JobState.WAITING]]
    order_seed = jobs[0].order_seed if jobs else 0
    about_all = (*unchecked, *_chosen_order(order_seed))
    return Summary(
        jobs=len(jobs),
        waiting=len(in_state[JobState.WAITING]),
        groups=tuple(groups_of(results, limits, unfinished)),
        results=tuple(results),
        failures=tuple(store.failure(job) for job in in_state[JobState.FAILED]),
        refusals=store.refusals,
        code=jobs[0].code if jobs else "",
        order_seed=order_seed,
        workers=store.workers(),
        run=store.run,
        budgets=tuple(budgets_of(results, jobs)),
        waiting_jobs=tuple(job.label for job in in_state[JobState.WAITING]),
        planned_groups=planned_groups_of(jobs),
        copies=tuple(copies_in(jobs)),
        replaced_truths=replaced_truths_in(results),
        deviations=(*_of_all_results(about_all, results), *common_deviations(results)),
        limits=limits,
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


def _chosen_order(order_seed: int) -> Iterator[str]:
    """Yield a sentence if the order of the drives was chosen, because the verdict can depend on the order."""
    if order_seed:
        yield (
            f"The order in which sequential tests take the drives was chosen: order_seed {order_seed}, default 0. "
            "The verdict can depend on this order. It is unknown whether the seed was chosen before the results."
        )


def _of_all_results(sentences: Sequence[str], results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield sentences that are about all results as deviations."""
    for text in sentences:
        yield CommonDeviation(text=text, results=len(results), of="all results")


def common_deviations(results: Sequence[ScoredJob]) -> tuple[CommonDeviation, ...]:
    """Return the deviations of all results, and a deviation if several results do not name their item under test.

    Sentences that differ only in numbers are one deviation.
    """
    found: dict[str, CommonDeviation] = {}
    for result in results:
        sentences = {NUMBER.sub("0", text): text for text in deviations_of(result.score)}
        for kind, text in sentences.items():
            item = CommonDeviation(text=text, results=1, of=result.job.label)
            if (known := found.get(kind)) is not None:
                largest = max(known, item, key=lambda each: largest_number(each.text))
                item = msgspec.structs.replace(largest, results=known.results + 1)
            found[kind] = item
    return (*_unnamed_items(results), *_several_items(results), *found.values())


def _unnamed_items(results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield a deviation if several results do not name their item under test, because their items may differ."""
    unnamed = [result for result in results if result.score.method is None]
    if len(unnamed) > 1:
        text = "The results do not name their item under test. Their items may differ (the calls name the item)."
        yield CommonDeviation(text=text, results=len(unnamed), of=unnamed[0].job.label)


def _several_items(results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield a deviation that names the items under test if the suite does not declare all of them."""
    if items := _undeclared_items(results):
        text = f"The results come from several items under test or configurations: {', '.join(items)}."
        yield CommonDeviation(text=text, results=len(results), of="all results")


def _undeclared_items(results: Sequence[ScoredJob]) -> tuple[str, ...]:
    """Return the names of the items under test if a result has another item than the configurations of the suite."""
    undeclared = [result.score for result in results if result.job.configuration == NO_CONFIGURATION]
    declared = [result.score for result in results if result.job.configuration != NO_CONFIGURATION]
    return undeclared_items(undeclared, declared)


def largest_number(text: str) -> float:
    """Return the largest number in a text, 0 without one."""
    return max((float(match[0]) for match in NUMBER.finditer(text)), default=0.0)


def budgets_of(results: Sequence[ScoredJob], planned: Sequence[Job]) -> Iterator[Budget]:
    """Yield the error budget of each configuration and condition; nothing if the suite is not a budget."""
    sources = error_sources_of([job.source.variant for job in planned])
    if not sources:
        return
    for configuration in dict.fromkeys(result.job.configuration for result in results):
        used = [result for result in results if result.job.configuration == configuration and result.job.repeat == 0]
        for condition in dict.fromkeys(condition for result in used for condition in result.score.conditions):
            errors: dict[str, dict[str, DriveErrors]] = {}
            for result in used:
                found = _drive_errors(result.score, condition)
                if found is not None:
                    errors.setdefault(result.job.source.variant, {})[result.job.source.name] = found
            yield budget_of(sources, condition, errors, configuration=configuration)


def _drive_errors(score: Score, condition: str) -> DriveErrors | None:
    """Return the position errors of a drive for a condition; None for fewer than two sub-trajectories."""
    rows = rows_by_axis(score, KINDS["position"], condition)
    if not rows or any(row.mean is None or row.sigma is None for row in rows):
        return None
    return DriveErrors(rows[0].n or 0, np.array([row.mean for row in rows]), np.array([row.sigma for row in rows]))


def planned_groups_of(jobs: Sequence[Job]) -> tuple[GroupKey, ...]:
    """Return the groups of planned jobs, in the order of their first occurrence."""
    return tuple(dict.fromkeys(job.group for job in jobs))


def by_group(results: Sequence[ScoredJob]) -> dict[GroupKey, list[ScoredJob]]:
    """Return the results of each group by its key, in the order of their first occurrence."""
    members: dict[GroupKey, list[ScoredJob]] = {}
    for result in results:
        members.setdefault(result.job.group, []).append(result)
    return members


def groups_of(results: Sequence[ScoredJob], limits: Limits | None, unfinished: Sequence[Job] = ()) -> Iterator[Group]:
    """Yield the groups of results in the order of their first occurrence.

    Within a group, results are sorted by the hashes of their drives and jobs, so that figures and verdicts do not
    depend on the order of the suite's file. `unfinished` are the jobs without a result.
    """
    suite_subjects = {subject for result in results for subject in tasks_of(result.score)}
    several = len(_undeclared_items(results))
    for key, unsorted in by_group(results).items():
        in_group = sorted(unsorted, key=lambda item: (item.job.drive_key, item.job.key))
        next_drive = min((job.drive_key for job in unfinished if job.group == key), default=None)
        scores = [result.score for result in in_group]
        trajectories = [score.association for score in scores if score.association is not None]
        conditions = list(dict.fromkeys(condition for score in scores for condition in score.conditions))
        of_drives = [result.of_drive for result in in_group]
        suite_items = several if key.configuration == NO_CONFIGURATION else 0
        pooled = tuple(row for condition in conditions for row in pool(of_drives, condition))
        yield Group(
            task=key.task,
            configuration=key.configuration,
            faults=key.faults,
            results=len(scores),
            lost=sum(item.lost or 0 for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            figures=pooled,
            verdicts=tuple(verdicts_over(limits, of_drives, pooled, suite_subjects, next_drive, suite_items)),
        )
