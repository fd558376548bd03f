"""What follows from all results of a suite: counts, pooled errors, verdicts over all and for each drive, failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from sfr_loc_map import __version__
from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.modes import VerdictState
from sfr_loc_map.metrics.records.json_records import to_plain
from sfr_loc_map.metrics.score import Interval, Score, Verdict
from sfr_loc_map.metrics.score_json import from_json
from sfr_loc_map.metrics.verdicts.limited_figures import COVERAGE_MIN, LimitPart
from sfr_loc_map.metrics.verdicts.limits import Limit, Limits, parse_limits
from sfr_loc_map.metrics.verdicts.verdicts import figure_of, verdicts
from sfr_loc_map.suite.plan import Refusal
from sfr_loc_map.suite.pooling import PooledCondition, pool
from sfr_loc_map.suite.store import Entry, Failure, Store

SCHEMA = "sfr-suite/1"


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
    seconds: float | None
    score: Score


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What follows from all results of a suite.

    Attributes:
        tasks: Tasks of the suite.
        done: Tasks with a result.
        failed: Tasks that failed.
        waiting: Tasks that were not run yet.
        groups: Drives that were run alike.
        drives: Every result.
        failures: Why tasks failed.
        refusals: Sources that cannot be read.
        code: Fingerprint of the code.
    """

    tasks: int
    done: int
    failed: int
    waiting: int
    groups: tuple[Group, ...]
    drives: tuple[Drive, ...]
    failures: tuple[Failure, ...]
    refusals: tuple[Refusal, ...]
    code: str

    @property
    def states(self) -> list[VerdictState]:
        """The verdicts over all groups."""
        return [item.state for group in self.groups for item in group.verdicts]

    @property
    def verdict(self) -> VerdictState | None:
        """The verdict over all, None without limits; a task without result leaves it open."""
        if not self.states:
            return None
        if VerdictState.FAIL in self.states:
            return VerdictState.FAIL
        complete = self.done == self.tasks and not self.refusals
        passed = complete and all(state is VerdictState.PASS for state in self.states)
        return VerdictState.PASS if passed else VerdictState.NOT_ENOUGH_DATA

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values; of each drive its key, names, verdicts, and where its score stands."""
        return {
            "schema": SCHEMA,
            "version": __version__,
            "code": self.code,
            "counts": {name: getattr(self, name) for name in ("tasks", "done", "failed", "waiting")},
            "verdict": to_plain(self.verdict),
            "groups": to_plain(self.groups),
            "drives": [_drive_plain(drive) for drive in self.drives],
            "failures": to_plain(self.failures),
            "refusals": to_plain(self.refusals),
        }


def _drive_plain(drive: Drive) -> dict[str, object]:
    names = ("key", "label", "task", "source", "configuration", "faults", "repeat", "seconds")
    figures = {name: getattr(drive, name) for name in names}
    return figures | {"file": f"results/{drive.key}.json", "verdicts": to_plain(drive.score.verdicts)}


def summarise(store: Store, refusals: Sequence[Refusal] = ()) -> Summary:
    """Return what follows from the results of a suite's folder.

    Args:
        store: The folder.
        refusals: Sources that could not be read.

    Raises:
        InputError: If a result cannot be read.
    """
    entries = store.entries()
    limits = next((parse_limits(entry.task.limits, "limits") for entry in entries if entry.task.limits), None)
    drives = [_drive(entry, store, limits) for entry in entries if entry.state == "done"]
    failures = [store.failure(entry.task.key) for entry in entries if entry.state == "failed"]
    return Summary(
        tasks=len(entries),
        done=len(drives),
        failed=len(failures),
        waiting=sum(entry.state == "waiting" for entry in entries),
        groups=tuple(_groups(drives, limits)),
        drives=tuple(drives),
        failures=tuple(item for item in failures if item is not None),
        refusals=tuple(refusals),
        code=entries[0].task.code if entries else "",
    )


def _drive(entry: Entry, store: Store, limits: Limits | None) -> Drive:
    task = entry.task
    score = from_json(store.result_text(task.key), f"'{store.results / task.key}.json'")
    judged = () if limits is None else tuple(item for item in verdicts(limits, score) if _applies(item, score))
    return Drive(
        key=task.key,
        label=task.label,
        task=task.kind.value,
        source=task.source.name,
        configuration=task.configuration,
        faults=task.faults,
        repeat=task.repeat,
        seconds=entry.seconds,
        score=replace(score, verdicts=judged),
    )


def _applies(verdict: Verdict, score: Score) -> bool:
    """Tell whether a limit is on what the task made: a map is not judged by the limits of a drive."""
    if verdict.condition is not None:
        return score.trajectory is not None
    if verdict.metric == COVERAGE_MIN or verdict.metric.startswith("point_error"):
        return score.map is not None
    return verdict.value is not None


def _groups(drives: Sequence[Drive], limits: Limits | None) -> Iterator[Group]:
    names = list(dict.fromkeys((drive.task, drive.configuration, drive.faults) for drive in drives))
    for task, configuration, faults in names:
        members = [
            drive
            for drive in drives
            if (drive.task, drive.configuration, drive.faults) == (task, configuration, faults)
        ]
        scores = [drive.score for drive in members]
        trajectories = [score.trajectory for score in scores if score.trajectory is not None]
        conditions = list(dict.fromkeys(part.condition for item in trajectories for part in item.conditions))
        pooled = {
            condition: pool([part for item in trajectories if (part := item.of(condition)) is not None])
            for condition in conditions
        }
        yield Group(
            task=task,
            configuration=configuration,
            faults=faults,
            drives=len(members),
            lost=sum(item.lost for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            conditions=tuple(pooled.values()),
            verdicts=() if limits is None else tuple(_verdicts(limits, scores, pooled)),
        )


def _verdicts(
    limits: Limits, scores: Sequence[Score], pooled: dict[Condition, PooledCondition]
) -> Iterator[GroupVerdict]:
    for limit in limits.limits:
        found = [(score, figure_of(limit, score)) for score in scores]
        values = [figure.value for _, figure in found if figure.value is not None]
        if not values and not _concerns(limit, scores):
            continue
        lower = limit.key == COVERAGE_MIN
        missed = sum(value < limit.limit if lower else abs(value) > limit.limit for value in values)
        statistic = _pooled_figure(limit, pooled)
        if statistic is not None:
            value, interval, count, over = *statistic, Over.POOLED
        else:
            value = None if not values else min(values) if lower else max(values, key=abs)
            interval, count, over = None, len(values), Over.WORST
        few = value is None or (over is Over.POOLED and count < limits.minimum_count)
        met = not few and (value >= limit.limit if lower else abs(value) <= limit.limit)  # type: ignore[operator, arg-type]
        state = VerdictState.NOT_ENOUGH_DATA if few else VerdictState.PASS if met else VerdictState.FAIL
        yield GroupVerdict(
            metric=f"target {limit.key}" if limit.part is LimitPart.TARGET else limit.key,
            condition=limit.condition,
            limit=limit.limit,
            value=value,
            ci95=interval,
            count=count,
            over=over,
            state=state,
            missed_by=missed,
        )


def _concerns(limit: Limit, scores: Sequence[Score]) -> bool:
    if limit.part is LimitPart.TRAJECTORY:
        return any(score.trajectory is not None for score in scores)
    return limit.part is LimitPart.MAP and any(score.map is not None for score in scores)


def _pooled_figure(
    limit: Limit, pooled: dict[Condition, PooledCondition]
) -> tuple[float | None, Interval | None, int] | None:
    """Return value, interval and count of a figure of the pooled errors; None for a figure that is not among them."""
    if limit.condition is None:
        return None
    part = pooled.get(limit.condition)
    if part is None:
        return None, None, 0
    error, _, rest = limit.key.partition("_")
    statistic = {"position": part.position_m, "attitude": part.attitude_deg, "heading": part.heading_deg}[error]
    name = rest.rpartition("_")[0]
    interval = statistic.mean_plus_3sigma_ci95 if name == "mean_plus_3sigma" else None
    return getattr(statistic, name), interval, part.count
