"""Summarise the results of a suite: counts, errors pooled over drives, verdicts, failures.

Drives with the same task, configuration and faults form a group. The sub-trajectories of a group are one sample, as the
statistics of the specification require [4.1.3]. Count, mean and sigma of all values follow exactly from those of the
drives (Chan, Golub, LeVeque 1983). The 95 % interval resamples whole drives, because errors within one drive are not
independent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec.structs import asdict, replace

from sfr_loc_map import __version__
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.catalogue import KINDS, SUITE, Subject
from sfr_loc_map.metrics.completeness import expected_row
from sfr_loc_map.metrics.config import VerdictState, worst_of
from sfr_loc_map.metrics.judging.judge import (
    finding_verdicts,
    incomplete_verdict,
    judged,
    of_incomplete,
    plain_verdict,
    proof_verdict,
    verdict_on,
)
from sfr_loc_map.metrics.judging.limit_scope import limits_about, task_of, tasks_of
from sfr_loc_map.metrics.judging.limited_figure import LimitedFigure, figure_of, truth_error_of
from sfr_loc_map.metrics.judging.proof import SEQUENTIAL, prove, sample_of
from sfr_loc_map.metrics.judging.several_scores import items_under_test
from sfr_loc_map.metrics.limits import Interpretation, Limit, Limits, Terms, meets
from sfr_loc_map.metrics.row_part import RowPart
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.table import POOLED, Figure, figure_row
from sfr_loc_map.metrics.tolerance import Sample
from sfr_loc_map.metrics.verdict import Verdict
from sfr_loc_map.suite.running.job import Job, WorkerRecord
from sfr_loc_map.suite.running.specification import Refusal
from sfr_loc_map.suite.running.store import JobFailure, Store
from sfr_loc_map.suite.running.variants import error_sources_of
from sfr_loc_map.suite.statistics.budget import Budget, DriveErrors, budget_of
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.statistics.resampling import MIN_DRIVES, drawn_weights, half_width

SCHEMA = "sfr-suite/1"
AXES = ("x", "y", "z")  #: Pooled parts of the position error.


def group_key_of(job: Job) -> tuple[str, str, str]:
    """Return the key of a job's group: task, configuration, faults or variant of a budget."""
    return job.kind.value, job.configuration, job.alteration


@dataclass(frozen=True, slots=True)
class ScoredJob:
    """A job with its score."""

    job: Job
    score: Score

    @property
    def group_key(self) -> tuple[str, str, str]:
        """Key of the group: task, configuration, faults or variant of a budget."""
        return group_key_of(self.job)

    @property
    def figure(self) -> float | None:
        """Mean + 3 sigma of the position over the first condition, None without a trajectory."""
        return self.score.number("position", "mean_plus_3sigma")

    def names(self) -> dict[str, object]:
        """Return the names of the job as JSON values."""
        job = self.job
        return {
            "key": job.key,
            "label": job.label,
            "task": job.kind.value,
            "source": job.source.name,
            "configuration": job.configuration,
            "faults": job.faults,
            "variant": job.source.variant,
            "seed": job.source.seed,
            "repeat": job.repeat,
        }


class GroupVerdict(Verdict, frozen=True, kw_only=True):
    """The verdict on a limit over all drives of a group; `n` counts sub-trajectories or drives."""

    over: str  #: `pooled` values, the `worst drive` for figures that cannot be pooled, or `all drives` of a proof.
    missed_by: int  #: Number of drives that miss the limit.


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """A group of drives with the same task, configuration and faults: counts, pooled errors, verdicts."""

    task: str
    configuration: str
    faults: str
    drives: int
    lost: int
    matched: int
    figures: tuple[Figure, ...]  #: Errors over the sub-trajectories of all drives, by condition.
    verdicts: tuple[GroupVerdict, ...]

    @property
    def key(self) -> tuple[str, str, str]:
        """Task, configuration, faults: the group key of the drives."""
        return self.task, self.configuration, self.faults


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
    workers: tuple[WorkerRecord, ...] = ()  #: Workers of all runs of the suite.
    run: Mapping[str, object] = field(default_factory=dict)  #: Commit, branch and date of the code; host and time.
    budgets: tuple[Budget, ...] = ()  #: Error budgets, by configuration and condition.

    @property
    def counts(self) -> dict[str, int]:
        """Number of all, done, failed and waiting jobs."""
        done, failed = len(self.results), len(self.failures)
        return {"tasks": self.jobs, "done": done, "failed": failed, "waiting": self.waiting}

    @property
    def verdict(self) -> VerdictState | None:
        """The worst verdict, None without limits; incomplete at best if a job has no result."""
        states = [item.state for group in self.groups for item in group.verdicts]
        if not states:
            return None
        return worst_of(states if self.completeness.value == 1.0 else [*states, VerdictState.INCOMPLETE])

    @property
    def on_limits(self) -> list[GroupVerdict]:
        """The verdicts on limits. Verdicts on findings, contradictions and missing results have no figure."""
        return [item for group in self.groups for item in group.verdicts if item.figure is not None]

    @property
    def is_decided(self) -> bool:
        """Whether sequential tests have decided all limits, so that no more drives are required."""
        return are_decided(self.groups)

    @property
    def completeness(self) -> Figure:
        """The row with the number of planned jobs and the fraction that has a result.

        Waiting jobs are not required once sequential tests have decided all limits.
        """
        needed = self.jobs - self.waiting if self.is_decided else self.jobs
        planned = needed + len(self.refusals)
        return expected_row(RowPart(SUITE), len(self.results), planned or None)

    def to_dict(self) -> dict[str, object]:
        """Return the summary as JSON values, for each drive with names, figures, verdicts and the file of its score."""
        named = ("verdict", "groups", "failures", "refusals", "workers", "budgets")
        parts = {name: to_plain(getattr(self, name)) for name in named}
        drives = [
            drive.names()
            | {"path": drive.job.source.path, "pairing": drive.job.pairing, "file": f"results/{drive.job.key}.json"}
            | {"figures": [[*to_plain(name).values(), value] for name, value in figures_of(drive.score).items()]}
            | {"verdicts": to_plain(drive.score.verdicts)}
            | {
                name: to_plain(value)
                for name in ("incomplete", "contradiction", "findings")
                if (value := getattr(drive.score, name))
            }
            for drive in self.results
        ]
        head = {"schema": SCHEMA, "version": __version__, "code": self.code, "counts": self.counts}
        return {**head, **self.run, **parts, "drives": drives}


def are_decided(groups: Sequence[Group]) -> bool:
    """Return whether sequential tests have decided all limits of groups."""
    items = [item for group in groups for item in group.verdicts]
    return bool(items) and all(
        item.proof is not None
        and item.proof.method == SEQUENTIAL
        and item.state in (VerdictState.PASS, VerdictState.FAIL)
        for item in items
    )


def read_scored_job(job: Job, store: Store, limits: Limits | None) -> ScoredJob:
    """Read the result of a job, and judge the result by the limits that apply to its subjects."""
    score = store.score(job)
    of_score = limits_about(limits, tasks_of(score))
    return ScoredJob(job, judged(score, of_score, partial=job.scoring.partial))


class SequentialDecision:
    """Checks during a suite whether all limits are decided by sequential tests; reads and judges each result once."""

    def __init__(self, store: Store) -> None:
        """Read the existing results."""
        self._store, self._limits = store, store.limits
        done = [job for job in store.jobs if store.state(job.key) == "done"]
        self._scored = {job.key: read_scored_job(job, store, self._limits) for job in done}

    def add(self, job: Job) -> None:
        """Read the result of an ended job."""
        if self._store.state(job.key) == "done":
            self._scored[job.key] = read_scored_job(job, self._store, self._limits)
        else:
            self._scored.pop(job.key, None)

    @property
    def is_made(self) -> bool:
        """Whether no more drives are required."""
        jobs = self._store.jobs
        drives = [self._scored[job.key] for job in jobs if job.key in self._scored]
        unfinished = [job for job in jobs if job.key not in self._scored]
        return are_decided([*groups_of(drives, self._limits, unfinished)])


def summarise(store: Store) -> Summary:
    """Return the summary of the results in a suite's folder."""
    jobs, limits = store.jobs, store.limits
    states = {job.key: store.state(job.key) for job in jobs}
    results = [read_scored_job(job, store, limits) for job in jobs if states[job.key] == "done"]
    return Summary(
        jobs=len(jobs),
        waiting=sum(state == "waiting" for state in states.values()),
        groups=tuple(groups_of(results, limits, [job for job in jobs if states[job.key] != "done"])),
        results=tuple(results),
        failures=tuple(store.failure(job.key) for job in jobs if states[job.key] == "failed"),
        refusals=store.refusals,
        code=jobs[0].code if jobs else "",
        workers=store.workers(),
        run=store.run,
        budgets=tuple(budgets_of(results, jobs)),
    )


def budgets_of(drives: Sequence[ScoredJob], planned: Sequence[Job]) -> Iterator[Budget]:
    """Yield the error budget of each configuration and condition; nothing if the suite is not a budget."""
    sources = error_sources_of([job.source.variant for job in planned])
    if not sources:
        return
    for configuration in dict.fromkeys(drive.job.configuration for drive in drives):
        used = [drive for drive in drives if drive.job.configuration == configuration and drive.job.repeat == 0]
        for condition in dict.fromkeys(condition for drive in used for condition in drive.score.conditions):
            errors: dict[str, dict[str, DriveErrors]] = {}
            for drive in used:
                found = _drive_errors(drive.score, condition)
                if found is not None:
                    errors.setdefault(drive.job.source.variant, {})[drive.job.source.name] = found
            yield budget_of(sources, condition, errors, configuration=configuration)


def _drive_errors(score: Score, condition: str) -> DriveErrors | None:
    """Return the position errors of a drive for a condition; None for fewer than two sub-trajectories."""
    rows = [row for axis in AXES if (row := _axis_row(score, "position", condition, axis)) is not None]
    if len(rows) < len(AXES) or any(row.mean is None or row.sigma is None for row in rows):
        return None
    return DriveErrors(rows[0].n or 0, np.array([row.mean for row in rows]), np.array([row.sigma for row in rows]))


def groups_of(drives: Sequence[ScoredJob], limits: Limits | None, unfinished: Sequence[Job] = ()) -> Iterator[Group]:
    """Yield the groups of results in the order of their first occurrence.

    Within a group, results are sorted by the hashes of their drives and jobs, so that figures and verdicts do not
    depend on the order of the suite's file. `unfinished` are the jobs without a result.
    """
    members: dict[tuple[str, str, str], list[ScoredJob]] = {}
    for drive in drives:
        members.setdefault(drive.group_key, []).append(drive)
    parts_judged = {part for drive in drives for part in tasks_of(drive.score)}
    for key, jobs in members.items():
        task, configuration, faults = key
        jobs = sorted(jobs, key=lambda item: (item.job.drive_key, item.job.key))
        next_drive = min((job.drive_key for job in unfinished if group_key_of(job) == key), default=None)
        scores = [job.score for job in jobs]
        trajectories = [score.association for score in scores if score.association is not None]
        conditions = list(dict.fromkeys(condition for score in scores for condition in score.conditions))
        results = [(job.job.drive_key, job.score) for job in jobs]
        sources = [job.job.source.sha256 for job in jobs]
        pooled = tuple(row for condition in conditions for row in pool(results, condition, sources))
        yield Group(
            task=task,
            configuration=configuration,
            faults=faults,
            drives=len(scores),
            lost=sum(item.lost for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            figures=pooled,
            verdicts=tuple(verdicts_over(limits, results, pooled, parts_judged, next_drive)),
        )


def verdicts_over(
    limits: Limits | None,
    results: Sequence[tuple[str, Score]],
    pooled: tuple[Figure, ...],
    of_suite: Collection[str] = (),
    next_drive: str | None = None,
) -> Iterator[GroupVerdict]:
    """Yield the verdicts over drives with equal settings: first those without a limit, then one for each limit.

    `of_suite` are the subjects of all results of the suite. A limit on none of them has not enough data in each group.
    `next_drive` is the first drive without a result, in the order of the hashes.
    """
    scores = [score for _, score in results]
    wrong = [item for score in scores for item in finding_verdicts(score)]
    for name in dict.fromkeys(item.name for item in wrong):
        mine = [item for item in wrong if item.name == name]
        worst = replace(max(mine, key=lambda item: item.value or 0.0), n=len(scores))
        yield _of_group(worst, "worst drive", len(mine))
    if contradicted := sum(score.contradiction is not None for score in scores):
        value, state = float(contradicted), VerdictState.NOT_JUDGED
        plain = plain_verdict("convention_mismatch_drives", 0.0, value, state)
        yield _of_group(replace(plain, n=len(scores)), "worst drive", contradicted)
    if (several := items_under_test(scores)) > 1:
        plain = plain_verdict("items_under_test_max", 1.0, float(several), VerdictState.NOT_JUDGED)
        yield _of_group(replace(plain, n=len(scores)), "all drives", several)
    if parts := [score for score in scores if score.incomplete is not None]:
        rows = [row for score in parts for row in score.rows("judged", subject=Subject.COMPLETENESS)[:1]]
        shares = [row.value for row in rows if row.value is not None]
        # an incomplete drive prevents a pass, whatever the figures of the other drives
        whole = replace(incomplete_verdict(min(shares, default=None)), n=len(scores))
        yield _of_group(whole, "worst drive", len(parts))
    parts_judged = {part for score in scores for part in tasks_of(score)}
    for limit in () if limits is None else limits.limits:
        if task_of(limit) not in parts_judged and task_of(limit) in of_suite:
            continue  # a limit on another subject of the suite
        if limit.terms is not None:
            yield proof_over_drives(limit, limit.terms, results, next_drive)
            continue
        own = [score for score in scores if task_of(limit) in tasks_of(score)]
        of_each = [figure_of(limit, score) for score in own]
        values = [each.value for each in of_each if each.value is not None]
        worst_value = min(values, default=None) if limit.is_lower_bound else max(values, key=abs, default=None)
        over = "worst drive"
        count = len(values)
        figure = LimitedFigure(worst_value)  # no minimum number of drives is required
        if limit.condition is not None:
            of_all = figure_of(limit, Score(figures=pooled))
            over, count = "pooled", of_all.n or 0
            if of_all.value is None and worst_value is not None:  # quantiles cannot be pooled
                over = "worst drive"
                of_all = of_all._replace(value=worst_value, interval=None, place=None)
            figure = of_all._replace(
                independent=independent_of_drives(limit, results),
                truth_error=max((each.truth_error for each in of_each), default=0.0),
            )
        verdict = replace(verdict_on(limit, figure, limits or Limits()), n=count)
        has_value = [bool(_count_of(limit, score)) for score in own]
        if not all(has_value):
            verdict = of_incomplete(verdict)  # a drive that cannot be judged prevents a pass
        yield _of_group(verdict, over, sum(not meets(limit, found) for found in values))


def independent_of_drives(limit: Limit, results: Sequence[tuple[str, Score]]) -> float:
    """Return the number of independent values of a limited figure; the repeats of a drive count once."""
    of_drives: dict[str, float] = {}
    for drive, score in results:
        if task_of(limit) in tasks_of(score):
            of_drives[drive] = max(of_drives.get(drive, 0.0), figure_of(limit, score).independent or 0.0)
    return sum(of_drives.values())


def samples_by_drive(limit: Limit, results: Sequence[tuple[str, Score]]) -> dict[str, list[Sample]]:
    """Return the errors to which a limit applies, for each run by drive."""
    samples: dict[str, list[Sample]] = {}
    for drive, score in results:
        sample = sample_of(score, limit.limited.figure, limit.condition)
        if sample is not None:
            samples.setdefault(drive, []).append(sample)
    return samples


def proof_over_drives(
    limit: Limit, terms: Terms, results: Sequence[tuple[str, Score]], next_drive: str | None = None
) -> GroupVerdict:
    """Return the verdict over drives on a limit with a probability and a confidence.

    A sequential test uses the drives before the first drive without a result, so that the verdict does not depend on
    the order in which drives finish.
    """
    samples = samples_by_drive(limit, results)
    is_sequential = terms.good is not None and next_drive is not None
    taken = {drive: runs for drive, runs in samples.items() if not is_sequential or drive < (next_drive or "")}
    truth_error = max((truth_error_of(limit, score, score.reading) for _, score in results), default=0.0)
    verdict = proof_verdict(limit, prove(terms, limit.limit, taken), None, truth_error)
    exceeding = sum(any(not (run.sizes <= limit.limit).all() for run in runs) for runs in samples.values())
    over = "worst drive" if terms.interpretation is Interpretation.TEMPORAL else "all drives"
    return _of_group(verdict, over, exceeding)


def _count_of(limit: Limit, score: Score) -> float:
    """Return the number of values of a drive's limited figure; 0 if the figure is unknown."""
    found = figure_of(limit, score)
    if limit.condition is not None and found.row is not None:
        return 0.0 if found.row.unknown else float(found.row.n or 0)
    return 0.0 if found.value is None else 1.0


def _of_group(verdict: Verdict, over: str, missed_by: int) -> GroupVerdict:
    return GroupVerdict(**asdict(verdict), over=over, missed_by=missed_by)


def pool(results: Sequence[tuple[str, Score]], condition: str, sources: Sequence[str] = ()) -> Iterator[Figure]:
    """Yield the pooled errors of scores for a condition; each score is given with the key of its drive.

    Means and sigmas of a vector are pooled axis by axis. `sources` are the hashes of the sources of the results. Of the
    sources that are copies of one drive, only the worst is pooled, because copies would dilute the errors.
    """
    for kind in KINDS.values():
        if kind.subject is not Subject.TRAJECTORY:
            continue
        axes: tuple[str | None, ...] = AXES if kind.name == "position" else (None,)
        used: dict[tuple[str, str], list[list[Figure]]] = {}
        for (drive, score), source in zip(results, sources or [""] * len(results), strict=True):
            rows = [_axis_row(score, kind.name, condition, axis) for axis in axes]
            known = [row for row in rows if row is not None and row.mean is not None and (row.n or 0) > 0]
            if len(known) == len(axes):
                used.setdefault((drive, source), []).append(known)
        has_figure = any(score.rows(kind.name, condition=condition) for _, score in results)
        if has_figure:
            yield pooled_row(kind.name, condition, _without_copies(kind.name, condition, used))


def _without_copies(
    figure: str, condition: str, used: Mapping[tuple[str, str], Sequence[Sequence[Figure]]]
) -> list[tuple[str, Sequence[Figure]]]:
    """Return the rows of the results by drive. Of several sources of a drive, that with the largest figure is used."""
    worst: dict[str, tuple[float, Sequence[Sequence[Figure]]]] = {}
    for (drive, _), results in used.items():
        row = pooled_row(figure, condition, [(drive, rows) for rows in results])
        size = row.mean_plus_3sigma
        if size is None:
            size = float(np.linalg.norm([item.mean or 0.0 for item in results[0]]))
        if drive not in worst or size > worst[drive][0]:
            worst[drive] = size, results
    return [(drive, rows) for drive, (_, results) in worst.items() for rows in results]


def _axis_row(score: Score, figure: str, condition: str, axis: str | None) -> Figure | None:
    """Return the row of an axis of a figure; without axes, the row of the judged reading."""
    if axis is None:
        return score.judged_row(figure, condition=condition)
    return score.figure(figure, condition=condition, part=axis)


def pooled_row(figure: str, condition: str, used: Sequence[tuple[str, Sequence[Figure]]]) -> Figure:
    """Return mean, sigma and mean + 3 sigma of all values; `used` has the drive and the rows by axis of each result.

    The interval resamples drives, each with all of its results. `independent` is the number of drives.
    """
    numbers = {drive: number for number, drive in enumerate(dict.fromkeys(drive for drive, _ in used))}
    many = len(numbers)
    count = np.array([float(rows[0].n or 0) for _, rows in used])
    total = int(count.sum())
    if not used:
        return figure_row(figure, condition, POOLED, n=0, independent=0)
    means = np.array([[row.mean for row in rows] for _, rows in used], np.float64)
    if total < 2:
        return figure_row(figure, condition, POOLED, n=total, independent=many)
    sigmas = np.array([[row.sigma or 0.0 for row in rows] for _, rows in used], np.float64)
    squares = np.square(sigmas) * (count[:, None] - 1.0)
    mean, sigma = (float(values[0]) for values in _pooled(count, means, squares, np.ones((1, len(count)))))
    found: dict[str, Any] = {"mean": mean, "sigma": sigma, "mean_plus_3sigma": mean + 3.0 * sigma}
    if means.shape[1] == 1:  # the mean of a scalar figure keeps its sign
        found["mean"] = float(count @ means[:, 0]) / total
    if many >= MIN_DRIVES and found["mean_plus_3sigma"] > 0.0:
        weights = drawn_weights(many)[:, [numbers[drive] for drive, _ in used]]
        drawn_means, drawn_sigmas = _pooled(count, means, squares, weights)
        logs = np.log(np.maximum(drawn_means + 3.0 * drawn_sigmas, 1e-300))
        factor = float(np.exp(half_width(logs, many)))
        found["low95"], found["high95"] = found["mean_plus_3sigma"] / factor, found["mean_plus_3sigma"] * factor
    return figure_row(figure, condition, POOLED, n=total, independent=many, **found)


def _pooled(
    count: FloatArray, means: FloatArray, squares: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the norms of mean and sigma `(R,)` of all values, with weights `(R, D)` of the results.

    The results are given by counts `(D,)`, means `(D, d)` and sums of squared deviations from the means `(D, d)`.
    """
    total = weights @ count
    mean = (weights @ (count[:, None] * means)) / total[:, None]
    # moments about the unweighted common mean, to avoid cancellation
    centre = (count[:, None] * means).sum(axis=0) / count.sum()
    second = weights @ (squares + count[:, None] * np.square(means - centre))
    deviations = second - total[:, None] * np.square(mean - centre)
    sigma = np.sqrt(np.maximum(deviations, 0.0) / (total[:, None] - 1.0))
    return np.sqrt(np.square(mean).sum(axis=1)), np.sqrt(np.square(sigma).sum(axis=1))
