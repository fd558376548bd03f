"""Drives that were run alike: their pooled errors and the verdict on each limit over all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.config import Condition, VerdictState
from sfr_loc_map.metrics.limits import COVERAGE_MIN, Limit, LimitPart, Limits, figure_of
from sfr_loc_map.metrics.score import ConditionScore, Interval, Score, TrajectoryScore
from sfr_loc_map.suite.pooling import PooledCondition, pool


class Over(StrEnum):
    """What a verdict over a group is about."""

    POOLED = "pooled"
    WORST = "worst drive"


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupVerdict:
    """The verdict on one limit over all drives of a group.

    Attributes:
        metric: Name of the figure as in the limits file.
        condition: Condition of the sub-trajectories, None outside the trajectory.
        limit: Bound, in the unit of the name.
        value: The figure, None where it is undefined.
        ci95: Its 95 % interval over drives, None where it has none.
        count: Sub-trajectories, or drives that have the figure.
        over: Whether the values of all drives are pooled, or the worst drive decides (figures that cannot be pooled).
        state: The verdict.
        missed_by: Drives that miss the limit on their own.
    """

    metric: str
    condition: Condition | None
    limit: float
    value: float | None
    ci95: Interval | None
    count: int
    over: Over
    state: VerdictState
    missed_by: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Drives that were run alike.

    Attributes:
        task: What was done.
        configuration: Name of the configuration.
        faults: Injected faults, empty for none.
        drives: Results.
        lost: Frames at which the localiser was lost, of all drives.
        matched: Frames of all drives.
        conditions: Pooled errors.
        verdicts: On each limit.
    """

    task: str
    configuration: str
    faults: str
    drives: int
    lost: int
    matched: int
    conditions: tuple[PooledCondition, ...]
    verdicts: tuple[GroupVerdict, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """One result.

    Attributes:
        key: Name of its file in `results/`.
        label: Name of the task.
        task: What was done.
        source: Name of the source.
        configuration: Name of the configuration.
        faults: Injected faults, empty for none.
        repeat: Number of the repetition.
        pairing: Same for the same work on the same data in another suite.
        seconds: How long the task took, None where this is not known.
        score: The score.
    """

    key: str
    label: str
    task: str
    source: str
    configuration: str
    faults: str
    repeat: int
    pairing: str
    seconds: float | None
    score: Score


def groups_of(drives: Sequence[Drive], limits: Limits | None) -> Iterator[Group]:
    """Yield the groups of results, in the order in which they first occur."""
    members: dict[tuple[str, str, str], list[Drive]] = {}
    for drive in drives:
        members.setdefault((drive.task, drive.configuration, drive.faults), []).append(drive)
    for (task, configuration, faults), group in members.items():
        scores = [drive.score for drive in group]
        trajectories = [score.trajectory for score in scores if score.trajectory is not None]
        pooled = _pooled(trajectories)
        yield Group(
            task=task,
            configuration=configuration,
            faults=faults,
            drives=len(group),
            lost=sum(item.lost for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            conditions=tuple(pooled.values()),
            verdicts=() if limits is None else tuple(_verdicts(limits, scores, pooled)),
        )


def _pooled(trajectories: Sequence[TrajectoryScore]) -> dict[Condition, PooledCondition]:
    parts: dict[Condition, list[ConditionScore]] = {}
    for part in (part for item in trajectories for part in item.conditions):
        parts.setdefault(part.condition, []).append(part)
    return {condition: pool(scores) for condition, scores in parts.items()}


@dataclass(frozen=True, slots=True)
class _Found:
    """A figure over a group: as in `GroupVerdict`."""

    value: float | None
    interval: Interval | None
    count: int
    over: Over

    def state(self, limit: Limit, minimum: int) -> VerdictState:
        if self.value is None or (self.over is Over.POOLED and self.count < minimum):
            return VerdictState.NOT_ENOUGH_DATA
        return VerdictState.PASS if _meets(self.value, limit) else VerdictState.FAIL


def _meets(value: float, limit: Limit) -> bool:
    return value >= limit.limit if limit.key == COVERAGE_MIN else abs(value) <= limit.limit


def _verdicts(
    limits: Limits, scores: Sequence[Score], pooled: Mapping[Condition, PooledCondition]
) -> Iterator[GroupVerdict]:
    for limit in limits.limits:
        if not _concerns(limit, scores):
            continue
        values = [value for score in scores if (value := figure_of(limit, score).value) is not None]
        found = _worst(values, limit) if limit.condition is None else _of_pooled(limit, pooled.get(limit.condition))
        yield GroupVerdict(
            metric=f"target {limit.key}" if limit.part is LimitPart.TARGET else limit.key,
            condition=limit.condition,
            limit=limit.limit,
            value=found.value,
            ci95=found.interval,
            count=found.count,
            over=found.over,
            state=found.state(limit, limits.minimum_count),
            missed_by=sum(not _meets(value, limit) for value in values),
        )


def _concerns(limit: Limit, scores: Sequence[Score]) -> bool:
    """Tell whether a limit is on what the tasks made: maps are not judged by the limits of drives."""
    if limit.part is LimitPart.TRAJECTORY:
        return any(score.trajectory is not None for score in scores)
    if limit.part is LimitPart.MAP:
        return any(score.map is not None for score in scores)
    return any(figure_of(limit, score).value is not None for score in scores)


def _worst(values: Sequence[float], limit: Limit) -> _Found:
    lower = limit.key == COVERAGE_MIN
    value = None if not values else min(values) if lower else max(values, key=abs)
    return _Found(value, None, len(values), Over.WORST)


def _of_pooled(limit: Limit, part: PooledCondition | None) -> _Found:
    """Return a figure of the pooled errors, by its key such as `position_mean_plus_3sigma_m`."""
    if part is None:
        return _Found(None, None, 0, Over.POOLED)
    error, _, rest = limit.key.partition("_")
    statistic = {"position": part.position_m, "attitude": part.attitude_deg, "heading": part.heading_deg}[error]
    name = rest.rpartition("_")[0]
    interval = statistic.mean_plus_3sigma_ci95 if name == "mean_plus_3sigma" else None
    return _Found(getattr(statistic, name), interval, part.count, Over.POOLED)
