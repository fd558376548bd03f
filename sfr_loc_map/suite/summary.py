"""What follows from all results of a suite: counts, errors pooled over drives, verdicts, failures.

The sub-trajectories of all drives run alike are one sample, as the specification's statistics ask [4.1.3]: counts,
means and sigmas of the drives give count, mean and sigma of all their values exactly (Chan, Golub, LeVeque 1983). The
95 % interval resamples whole drives: errors within one drive are not independent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.config import Condition, VerdictState
from sfr_loc_map.metrics.limits import (
    COVERAGE_MIN,
    PLACES,
    Figure,
    LimitPart,
    Limits,
    figure_of,
    finding_verdicts,
    incomplete_verdict,
    meets,
    parse_limits,
    value_at,
    verdict_on,
    verdicts,
)
from sfr_loc_map.metrics.score import ConditionScore, IntervalStatistic, Score, Statistic, Verdict
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.statistics import student_quantile
from sfr_loc_map.suite.cluster import WorkerRecord
from sfr_loc_map.suite.figures import figures_of
from sfr_loc_map.suite.job import Job
from sfr_loc_map.suite.specification import Refusal
from sfr_loc_map.suite.store import JobFailure, Store

SCHEMA = "sfr-suite/1"
MIN_DRIVES = 5  #: With fewer drives there is no interval.
RESAMPLES = 2000
SEED = 20260101


@dataclass(frozen=True, slots=True)
class ScoredJob:
    """A job with its score."""

    job: Job
    score: Score

    @property
    def runs(self) -> tuple[str, str, str]:
        """What it has in common with those that were run alike: task, configuration, faults."""
        return self.job.kind.value, self.job.configuration, self.job.faults

    @property
    def figure(self) -> float | None:
        """Mean + 3 sigma of the position over the first condition, None without a trajectory."""
        found: float | None = value_at(self.score, "trajectory.first.position_m.mean_plus_3sigma")
        return found

    def names(self) -> dict[str, object]:
        """Return what it is called, as JSON values."""
        job = self.job
        return {
            "key": job.key,
            "label": job.label,
            "task": job.kind.value,
            "source": job.source.name,
            "configuration": job.configuration,
            "faults": job.faults,
            "repeat": job.repeat,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledCondition:
    """Errors over the sub-trajectories of one condition of all drives, as `ConditionScore` names them."""

    condition: Condition
    drives: int  #: Drives with at least two sub-trajectories.
    count: int  #: Sub-trajectories.
    position_m: IntervalStatistic
    attitude_deg: IntervalStatistic
    heading_deg: IntervalStatistic  #: The mean is taken without its sign.
    chord_m: IntervalStatistic | None = None  #: Of the straight distance.


class GroupVerdict(Verdict):
    """The verdict on one limit over all drives of a group; its count is of sub-trajectories, or of drives."""

    over: str  #: `pooled` values of all drives, or the `worst drive` (figures that cannot be pooled).
    missed_by: int  #: Drives that miss the limit on their own.


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Drives that were run alike: number of drives, of frames and of lost frames, pooled errors, verdicts."""

    task: str
    configuration: str
    faults: str
    drives: int
    lost: int
    matched: int
    conditions: tuple[PooledCondition, ...]
    verdicts: tuple[GroupVerdict, ...]

    @property
    def runs(self) -> tuple[str, str, str]:
        """Task, configuration, faults, as those of its drives."""
        return self.task, self.configuration, self.faults


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What follows from all results of a suite."""

    tasks: int  #: Jobs of the suite.
    waiting: int  #: Jobs that were not run yet.
    groups: tuple[Group, ...]
    drives: tuple[ScoredJob, ...]  #: Every result.
    failures: tuple[JobFailure, ...]
    refusals: tuple[Refusal, ...]
    code: str  #: Fingerprint of the code.
    workers: tuple[WorkerRecord, ...] = ()  #: Workers of all its runs.
    run: Mapping[str, object] = field(default_factory=dict)  #: Commit, branch and date of the code, host, time.

    @property
    def counts(self) -> dict[str, int]:
        """Number of jobs, of those done, failed and waiting."""
        done, failed = len(self.drives), len(self.failures)
        return {"tasks": self.tasks, "done": done, "failed": failed, "waiting": self.waiting}

    @property
    def verdict(self) -> VerdictState | None:
        """The verdict over all, None without limits; a job without result leaves it open."""
        states = [item.state for group in self.groups for item in group.verdicts]
        if not states:
            return None
        for worst in (VerdictState.FAIL, VerdictState.INCOMPLETE):
            if worst in states:
                return worst
        complete = len(self.drives) == self.tasks and not self.refusals
        passed = complete and all(state is VerdictState.PASS for state in states)
        return VerdictState.PASS if passed else VerdictState.NOT_ENOUGH_DATA

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values; of each drive its key, names, verdicts, and where its score stands."""
        parts = {
            name: to_plain(getattr(self, name)) for name in ("verdict", "groups", "failures", "refusals", "workers")
        }
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
            for drive in self.drives
        ]
        head = {"schema": SCHEMA, "version": __version__, "code": self.code, "counts": self.counts}
        return {**head, **self.run, **parts, "drives": drives}


def summarise(store: Store) -> Summary:
    """Return what follows from the results of a suite's folder."""
    entries = store.entries()
    limits = next((parse_limits(job.limits, "limits") for job, _ in entries if job.limits), None)
    drives = []
    for job, state in entries:
        if state == "done":
            score = store.score(job.key)
            judged = tuple(item for item in verdicts(limits, score) if _applies(item, score))
            drives.append(ScoredJob(job, replace(score, verdicts=judged)))
    return Summary(
        tasks=len(entries),
        waiting=sum(state == "waiting" for _, state in entries),
        groups=tuple(groups_of(drives, limits)),
        drives=tuple(drives),
        failures=tuple(store.failure(job.key) for job, state in entries if state == "failed"),
        refusals=store.refusals,
        code=entries[0][0].code if entries else "",
        workers=store.workers(),
        run=store.run,
    )


def _applies(verdict: Verdict, score: Score) -> bool:
    """Tell whether a limit is on what the job made: a map is not judged by the limits of a drive."""
    if verdict.condition is not None:
        return score.trajectory is not None
    if verdict.metric == COVERAGE_MIN or verdict.metric.startswith("point_error"):
        return score.map is not None
    return verdict.value is not None


def groups_of(drives: Sequence[ScoredJob], limits: Limits | None) -> Iterator[Group]:
    """Yield the groups of results, in the order in which they first occur."""
    members: dict[tuple[str, str, str], list[ScoredJob]] = {}
    for drive in drives:
        members.setdefault(drive.runs, []).append(drive)
    for (task, configuration, faults), jobs in members.items():
        scores = [job.score for job in jobs]
        trajectories = [score.trajectory for score in scores if score.trajectory is not None]
        parts: dict[Condition, list[tuple[str, ConditionScore]]] = {}
        for job in jobs:
            for part in () if job.score.trajectory is None else job.score.trajectory.conditions:
                parts.setdefault(part.condition, []).append((job.job.drive, part))
        pooled = {condition: pool(items) for condition, items in parts.items()}
        yield Group(
            task=task,
            configuration=configuration,
            faults=faults,
            drives=len(scores),
            lost=sum(item.lost for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            conditions=tuple(pooled.values()),
            verdicts=tuple(_verdicts(limits, scores, pooled)),
        )


def _verdicts(
    limits: Limits | None, scores: Sequence[Score], pooled: Mapping[Condition, PooledCondition]
) -> Iterator[GroupVerdict]:
    wrong = [item for score in scores for item in finding_verdicts(score)]
    for metric in dict.fromkeys(item.metric for item in wrong):
        mine = [item for item in wrong if item.metric == metric]
        worst = replace(max(mine, key=lambda item: item.value or 0.0), count=len(scores))
        yield GroupVerdict(**vars(worst), over="worst drive", missed_by=len(mine))
    if contradicted := sum(score.contradiction is not None for score in scores):
        open_ = replace(incomplete_verdict(None), metric="convention_mismatch_drives", limit=0.0, count=len(scores))
        open_ = replace(open_, value=float(contradicted), state=VerdictState.NOT_ENOUGH_DATA)
        yield GroupVerdict(**vars(open_), over="worst drive", missed_by=contradicted)
    if parts := [score.trajectory for score in scores if score.incomplete is not None]:
        wholes = [part.completeness for part in parts if part is not None and part.completeness is not None]
        share = min((whole.judged_share for whole in wholes), default=None)
        # a drive that is not whole is no pass, whatever the figures of the others
        whole = replace(incomplete_verdict(share), count=len(scores))
        yield GroupVerdict(**vars(whole), over="worst drive", missed_by=len(parts))
    if limits is None:
        return
    for limit in limits.limits:
        values = [value for score in scores if (value := figure_of(limit, score).value) is not None]
        part = {LimitPart.TRAJECTORY: "trajectory", LimitPart.MAP: "map"}.get(limit.part)
        if not (any(getattr(score, part) is not None for score in scores) if part else values):
            continue  # maps are not judged by the limits of drives
        over, value, interval, count = "worst drive", max(values, key=abs, default=None), None, len(values)
        if limit.condition is not None:
            errors, place = pooled.get(limit.condition), PLACES[limit.part][limit.key]
            over, value, interval = "pooled", value_at(errors, place), value_at(errors, f"{place}_ci95")
            count = 0 if errors is None else errors.count
        elif limit.key == COVERAGE_MIN:
            value = min(values, default=None)
        figure = Figure(value, None if limit.condition is None else count, interval)  # drives need no least number
        verdict = replace(verdict_on(limit, figure, limits.minimum_count), count=count)
        missed = sum(not meets(limit, value) for value in values)
        yield GroupVerdict(**vars(verdict), over=over, missed_by=missed)


def pool(scores: Sequence[tuple[str, ConditionScore]]) -> PooledCondition:
    """Return the pooled errors of the scores of one condition, each with its drive; repeats are of one drive."""
    used = [item for _, item in scores if item.count > 1]
    drives = [drive for drive, item in scores if item.count > 1]

    def pooled(parts: Callable[[ConditionScore], Sequence[Statistic | None]]) -> IntervalStatistic:
        return pooled_statistic([(item.count, parts(item)) for item in used], drives)

    return PooledCondition(
        condition=scores[0][1].condition,
        drives=len({*drives}),
        count=sum(item.count for item in used),
        position_m=pooled(lambda item: (item.components.x_m, item.components.y_m, item.components.z_m)),
        attitude_deg=pooled(lambda item: (item.attitude_deg,)),
        heading_deg=pooled(lambda item: (item.heading_deg,)),
        chord_m=pooled(lambda item: (item.chord_m,)),
    )


def pooled_statistic(
    results: Sequence[tuple[int, Sequence[Statistic | None]]], drives: Sequence[str]
) -> IntervalStatistic:
    """Return mean, sigma and mean + 3 sigma of all values: of each result its count and statistics by component.

    `drives` names the drive of each; the interval resamples drives, each with all of its results.
    """
    used = [
        (drive, n, [part for part in parts if part is not None])
        for drive, (n, parts) in zip(drives, results, strict=True)
        if n > 1 and all(part is not None and part.mean is not None for part in parts)
    ]
    if not used:
        return IntervalStatistic(mean=None, sigma=None, mean_plus_3sigma=None, mean_plus_3sigma_ci95=None)
    numbers = {drive: number for number, drive in enumerate(dict.fromkeys(drive for drive, _, _ in used))}
    count, many = np.array([float(n) for _, n, _ in used]), len(numbers)
    means = np.array([[part.mean for part in parts] for _, _, parts in used], np.float64)
    sigmas = np.array([[part.sigma for part in parts] for _, _, parts in used], np.float64)
    squares = np.square(sigmas) * (count[:, None] - 1.0)
    mean, sigma = (float(values[0]) for values in _pooled(count, means, squares, np.ones((1, len(count)))))
    figure, interval = mean + 3.0 * sigma, None
    if many >= MIN_DRIVES and figure > 0.0:
        weights = drawn_weights(many)[:, [numbers[drive] for drive, _, _ in used]]
        drawn_means, drawn_sigmas = _pooled(count, means, squares, weights)
        spread = float(np.std(np.log(np.maximum(drawn_means + 3.0 * drawn_sigmas, 1e-300))))
        spread *= np.sqrt(many / (many - 1.0))
        factor = float(np.exp(student_quantile(0.975, many - 1.0) * spread))
        interval = (figure / factor, figure * factor)
    return IntervalStatistic(mean=mean, sigma=sigma, mean_plus_3sigma=figure, mean_plus_3sigma_ci95=interval)


def _pooled(
    count: FloatArray, means: FloatArray, squares: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return norms of mean and sigma `(R,)` of all values, each drive counted as often as its weight `(R, D)`.

    Of each drive there are its count `(D,)`, means `(D, d)` and sums of squared deviations from them `(D, d)`.
    """
    total = weights @ count
    mean = (weights @ (count[:, None] * means)) / total[:, None]
    # about the common mean of the drives as they are, so that nothing cancels
    centre = (count[:, None] * means).sum(axis=0) / count.sum()
    second = weights @ (squares + count[:, None] * np.square(means - centre))
    deviations = second - total[:, None] * np.square(mean - centre)
    sigma = np.sqrt(np.maximum(deviations, 0.0) / (total[:, None] - 1.0))
    return np.sqrt(np.square(mean).sum(axis=1)), np.sqrt(np.square(sigma).sum(axis=1))


@lru_cache(maxsize=8)
def drawn_weights(drives: int) -> NDArray[np.float64]:
    """Return how often each drive is drawn `(RESAMPLES, D)`, the same for the same number."""
    rng = np.random.default_rng([SEED, drives])
    return rng.multinomial(drives, np.full(drives, 1.0 / drives), RESAMPLES).astype(np.float64)
