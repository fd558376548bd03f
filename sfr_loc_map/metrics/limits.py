"""Limits of a requirements file, whose form docs/metrics.md shows, and the verdicts on them.

Every key names figure and unit; limits are upper bounds, except `coverage_min`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.config import load_yaml, suggestion
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.config import CallKind, Condition, ConditionKind, VerdictState
from sfr_loc_map.metrics.score import Interval, Score, TrajectoryScore, Verdict


class LimitPart(StrEnum):
    """Part of the score that limits are on; the parts of a limits file."""

    COMPLETENESS = "completeness"
    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    TARGET = "target"


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the score, the number of values it is made of and its 95 % interval, where it has them."""

    value: float | None = None
    count: int | None = None
    interval: Interval | None = None


COVERAGE_MIN = "coverage_min"  #: The one limit that is a lower bound.
STATISTICS = ("mean", "sigma", "mean_plus_3sigma")

# A limit is added here: its key, which ends in its unit (report.score_tables.limit_unit), and where its figure stands.
# Limits of a suite are judged by suite/summary.py: those of trajectories by pooled figures, others by the worst drive.
PLACES: dict[LimitPart, dict[str, str]] = {
    LimitPart.COMPLETENESS: {
        **{
            f"{name}_max_share": f"trajectory.completeness.{name}_share"
            for name in ("missing", "lost", "degraded", "unmatched", "doubled")
        },
        **{
            f"{name}_max_share": f"map.completeness.{name}_share"
            for name in ("points_without_truth", "pairs_without_cloud")
        },
    },
    LimitPart.TRAJECTORY: {
        f"{error}_{statistic}_{unit}": f"{error}_{unit}.{statistic}"
        for error, unit in (("position", "m"), ("attitude", "deg"), ("heading", "deg"), ("chord", "m"))
        for statistic in STATISTICS
    },
    LimitPart.MAP: {
        **{f"point_error_{name}_m": f"errors.point_error_m.{name}" for name in (*STATISTICS, "p50", "p95")},
        COVERAGE_MIN: "coverage",
    },
    LimitPart.TIMING: {
        "mapping_call_s": "mapping_call.max",
        **{
            f"{kind}_{statistic}_s": f"{kind}.{statistic}"
            for kind in CallKind
            for statistic in ("mean", "mean_plus_3sigma", "p50", "p95", "p99", "max")
        },
    },
    LimitPart.MEMORY: {
        f"{kind}_{peak}_bytes": f"{kind}.{peak}_bytes"
        for kind in (CallKind.LOCALISATION, CallKind.MAPPING, CallKind.MAPPING_CALL)
        for peak in ("peak", "above_idle", "heap_peak", "stack_peak")
    },
}
"""Where each figure that a limit names stands: of a condition, or of the part of the score."""
REQUIREMENT = {"id": str, "text": str, "certain": bool}  #: What a requirement says of itself.
NEEDED = {str: "a text, in quotes, is needed", bool: "true or false is needed"}
SHARES = PLACES[LimitPart.COMPLETENESS]  #: They may stand in the parts `trajectory` and `map` too.
NAMES: Mapping[LimitPart, Collection[str]] = {
    **PLACES,
    LimitPart.TARGET: [*PLACES[LimitPart.TIMING], *PLACES[LimitPart.MEMORY]],
}
"""Names of the figures that each part of the file limits."""


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit: a bound in the unit of its key; of sub-trajectories of a condition, None outside `trajectory`."""

    part: LimitPart
    key: str
    limit: float
    condition: Condition | None = None
    id: str | None = None  #: Number of the requirement.
    text: str | None = None  #: Its text.
    certain: bool = False  #: Whether a pass needs the whole 95 % interval to lie within the limit.


@dataclass(frozen=True, slots=True)
class Limits:
    """All limits of a file, in its order; fewer values than the minimum are not enough for a verdict."""

    limits: tuple[Limit, ...]
    minimum_count: int = 2

    @property
    def conditions(self) -> list[Condition]:
        """Conditions that are limited, each once."""
        return list(dict.fromkeys(item.condition for item in self.limits if item.condition is not None))

    @property
    def allow_missing(self) -> bool:
        """Whether a limit says which share of the drive may be missing."""
        return any(item.key == "missing_max_share" for item in self.limits)


def load_limits(path: Path) -> Limits:
    """Read a limits file; ConfigError if it cannot be read or a key or value is not valid; one line."""
    return parse_limits(load_yaml(path), str(path))


def parse_limits(content: Mapping[str, Any], origin: str) -> Limits:
    """Return the limits of a mapping as in the file; ConfigError, which names the origin, if one is not valid."""
    _check_keys(content, ("minimum_count", *LimitPart), origin)
    minimum = content.get("minimum_count", 2)
    if not isinstance(minimum, int) or isinstance(minimum, bool) or minimum < 2:
        raise ConfigError(f"{origin}: 'minimum_count' is {minimum!r}: a whole number of at least 2 is needed")
    entries = content.get("trajectory", [])
    if not isinstance(entries, list):
        raise ConfigError(f"{origin}: 'trajectory' must be a list, one entry a condition ('- condition: ...')")
    limits: list[Limit] = []
    for number, entry in enumerate(entries, 1):
        place = f"{origin}: trajectory entry {number}"
        if not isinstance(entry, Mapping) or not isinstance(entry.get("condition"), str):
            raise ConfigError(f"{place}: needs 'condition', such as distance=5, and limits beside it")
        try:
            condition = Condition.parse(entry["condition"])
        except MetricsError as error:
            raise ConfigError(f"{place}: {error}") from error
        rest = {key: value for key, value in entry.items() if key != "condition"}
        limits += _limits_of(LimitPart.TRAJECTORY, rest, place, condition)
    for part in LimitPart:
        if part is not LimitPart.TRAJECTORY:
            blocks = content.get(part, {})
            for block in blocks if isinstance(blocks, list) else [blocks]:
                limits += _limits_of(part, block, f"{origin}: '{part}'", None)
    if not limits:
        raise ConfigError(f"{origin}: no limit in it: give at least one under {', '.join(LimitPart)}")
    return Limits(tuple(limits), minimum)


def limits_of(verdicts: Collection[Verdict]) -> Limits | None:
    """Return the limits that verdicts are on, None for none; fewest values and conditions are as by default."""
    found = []
    for item in verdicts:
        key = item.metric.removeprefix("target ")
        parts = (
            [LimitPart.TARGET] if key != item.metric else [part for part in LimitPart if key in PLACES.get(part, ())]
        )
        if parts:
            requirement = {"id": item.id, "text": item.text, "certain": item.needs_certainty}
            found.append(Limit(parts[0], key, item.limit, item.condition, **requirement))  # type: ignore[arg-type]
    return Limits(tuple(found)) if found else None


def _limits_of(part: LimitPart, block: object, origin: str, condition: Condition | None) -> list[Limit]:
    """Return the limits of a block; `id`, `text` and `certain` are of all of it, or of one limit `{limit: ...}`."""
    if not isinstance(block, Mapping):
        raise ConfigError(f"{origin}: a mapping of names to limits is needed, found {type(block).__name__}")
    shares = [key for key, place in SHARES.items() if place.startswith(f"{part}.")]
    _check_keys(block, (*NAMES[part], *shares, *REQUIREMENT), origin)
    of_all = {key: block[key] for key in REQUIREMENT if key in block}
    made = []
    for key, value in block.items():
        if key in REQUIREMENT:
            continue
        entry = dict(value) if isinstance(value, Mapping) else {"limit": value}
        _check_keys(entry, ("limit", *REQUIREMENT), f"{origin}: '{key}'")
        entry = {**of_all, **entry}
        bound = entry.pop("limit", None)
        number = isinstance(bound, (int, float)) and not isinstance(bound, bool)
        if not number or not 0 <= bound < float("inf"):
            raise ConfigError(f"{origin}: '{key}' is {bound!r}: a number >= 0 is needed, in the unit of its name")
        if key in SHARES and bound > 1:
            raise ConfigError(f"{origin}: '{key}' is {bound!r}: a share from 0 to 1 is needed, 0.05 for 5 %")
        for name, kind in REQUIREMENT.items():
            if name == "id" and type(entry.get(name)) is int:
                entry[name] = str(entry[name])
            if name in entry and not isinstance(entry[name], kind):
                raise ConfigError(f"{origin}: '{name}' of '{key}' is {entry[name]!r}: {NEEDED[kind]}")
        where, over = (LimitPart.COMPLETENESS, None) if key in shares else (part, condition)
        made.append(Limit(where, key, float(bound), over, **entry))
    return made


def _check_keys(block: Mapping[str, Any], known: Collection[str], origin: str) -> None:
    for key in block:
        if key not in known:
            raise ConfigError(f"{origin}: unknown key '{key}'{suggestion(str(key), known)}")


def verdicts(limits: Limits | None, score: Score) -> tuple[Verdict, ...]:
    """Return the verdict on each limit: pass, fail, or not enough data.

    First of all those that need no limit: on what the method did wrong; and, where there are limits, that the estimate
    is incomplete. A figure passes at its limit; a mean of a signed figure (heading) is taken without its sign.
    `certain` tells whether the 95 % interval lies on one side of the limit, None where there is no interval.
    """
    judged = list(finding_verdicts(score))
    if limits is None:
        return tuple(judged)
    if score.incomplete is not None and score.trajectory is not None and score.trajectory.completeness is not None:
        judged.append(incomplete_verdict(score.trajectory.completeness.judged_share))
    for limit in limits.limits:
        verdict = verdict_on(limit, figure_of(limit, score), limits.minimum_count)
        judged.append(replace(verdict, by_reading=_by_reading(limit, score, limits.minimum_count)))
    return tuple(judged)


def finding_verdicts(score: Score) -> Iterator[Verdict]:
    """Yield a failed verdict for each kind of finding with which no score can be a pass."""
    for item in score.failures:
        yield _plain_verdict(f"{item.kind.replace(' ', '_')}_calls", 0.0, float(item.count), VerdictState.FAIL)


def incomplete_verdict(share: float | None) -> Verdict:
    """Return the verdict on an estimate of a part of the drive, of which so much was judged."""
    return _plain_verdict("judged_share_min", 1.0, share, VerdictState.INCOMPLETE)


def _plain_verdict(metric: str, limit: float, value: float | None, state: VerdictState) -> Verdict:
    margin = None if value is None else min(value - limit, limit - value)
    figure: dict[str, Any] = {"metric": metric, "limit": limit, "value": value, "margin": margin, "state": state}
    return Verdict(**figure, ci95=None, count=None, certain=None)


def verdict_on(limit: Limit, figure: Figure, minimum_count: int) -> Verdict:
    """Return the verdict on a figure; without a count it is not made of many values."""
    value, interval, certain = figure.value, figure.interval, None
    state, margin = VerdictState.NOT_ENOUGH_DATA, None if value is None else limit.limit - abs(value)
    if value is not None and (figure.count is None or figure.count >= minimum_count):
        certain = None if interval is None else not interval[0] <= limit.limit < interval[1]
        counted = limit.part is LimitPart.COMPLETENESS  # not estimated: there is nothing uncertain
        if not meets(limit, value):
            state = VerdictState.FAIL
        elif certain or counted or not limit.certain:
            state = VerdictState.PASS
    return Verdict(
        metric=f"target {limit.key}" if limit.part is LimitPart.TARGET else limit.key,
        id=limit.id,
        text=limit.text,
        limit=limit.limit,
        value=value,
        ci95=interval,
        margin=-margin if margin is not None and limit.key == COVERAGE_MIN else margin,
        condition=limit.condition,
        count=figure.count,
        state=state,
        certain=certain,
        needs_certainty=limit.certain,
    )


def meets(limit: Limit, value: float) -> bool:
    """Tell whether a value lies within a limit; a figure passes at its limit."""
    return value >= limit.limit if limit.key == COVERAGE_MIN else abs(value) <= limit.limit


def _by_reading(limit: Limit, score: Score, minimum_count: int) -> dict[str, VerdictState]:
    """Return whether the figure of each reading of the document meets a limit; the intervals are of one reading."""
    drive = score.trajectory
    owner = None if drive is None or limit.condition is None else drive.of(limit.condition)
    if owner is None or owner.readings is None or limit.key.startswith("chord"):  # that is the same in each
        return {}
    place = PLACES[limit.part][limit.key]
    found = {name: value_at(reading, place) for name, reading in vars(owner.readings).items()}
    loose = replace(limit, certain=False)
    return {name: verdict_on(loose, Figure(value, owner.count), minimum_count).state for name, value in found.items()}


def figure_of(limit: Limit, score: Score) -> Figure:
    """Return the figure that a limit is on."""
    part, of_target = limit.part, limit.part is LimitPart.TARGET
    if of_target:
        part = LimitPart.TIMING if limit.key in PLACES[LimitPart.TIMING] else LimitPart.MEMORY
    owner: object = getattr(score.target if of_target else score, part, None)
    if part is LimitPart.COMPLETENESS:
        owner = score
    if isinstance(owner, TrajectoryScore) and limit.condition is not None:
        owner = owner.of(limit.condition)
    *way, last = PLACES[part][limit.key].split(".")
    statistic = value_at(owner, ".".join(way)) if way else owner
    count = getattr(statistic, "count", getattr(owner, "count", None))
    if limit.key in ("mapping_call_s", "mapping_call_max_s"):
        count = None  # one call makes a map: its time is the figure
    return Figure(getattr(statistic, last, None), count, getattr(statistic, f"{last}_ci95", None))


def value_at(record: object, place: str) -> Any:  # noqa: ANN401 - of whatever type it has there
    """Return what stands at a place of a record such as `map.coverage`, None where a part of it is absent."""
    for name in place.split("."):
        record = getattr(record, name, None)
    return record


# ---- what could not be judged, and why


def reasons_not_judged(score: Score, asked: Collection[Condition] = ()) -> tuple[str, ...]:
    """Return why something could not be judged, a phrase each; conditions of the settings count if none is asked."""
    if score.contradiction is not None:
        return (score.contradiction,)
    whole = () if score.incomplete is None else (f"incomplete: {score.incomplete}",)
    drive, errors = score.trajectory, None if score.map is None else score.map.errors
    unmet: dict[Condition | None, str] = {}
    if drive is not None:
        never = (part.condition for part in drive.conditions if not part.count)
        extent = drive.matched, drive.path_length_m, drive.duration_s or 0.0
        unmet = {item: _reason(item, *extent) for item in never if not asked or item in asked}
    reasons = [*whole, *unmet.values()]
    if errors is not None and not errors.point_error_m.count:
        reasons.append("map: no point of the cloud has a true point")
    for item in score.verdicts:
        if item.state is VerdictState.NOT_ENOUGH_DATA and item.condition not in unmet:
            over = "" if item.condition is None else f" over {item.condition.label}"
            few = f"only {item.count} values" if item.count else "no data"
            if item.needs_certainty and item.value is not None and (item.ci95 is None or item.certain is not None):
                few = f"'certain' needs its 95 % interval {'' if item.ci95 is None else 'within the limit'}".rstrip()
                few += ", which it does not have" if item.ci95 is None else ""
            reasons.append(f"limit {item.metric}{over}: {few}")
    return tuple(reasons)


def conditions_beyond(truth: Trajectory, conditions: Collection[Condition]) -> tuple[str, ...]:
    """Return why a drive with this truth never meets some conditions, to be said before the work is done."""
    length_m = float(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum())
    duration_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) / NS_PER_S if len(truth) else 0.0
    longest = {ConditionKind.TIME: duration_s, ConditionKind.FRAMES: len(truth) - 1.0}
    # a straight line is no longer than the path
    longest |= dict.fromkeys((ConditionKind.DISTANCE, ConditionKind.DISPLACEMENT), length_m)
    beyond = (
        item for item in conditions if any(part.value > longest.get(part.kind, part.value) for part in item.parts)
    )
    return tuple(_reason(item, len(truth), length_m, duration_s) for item in beyond)


def _reason(condition: Condition, frames: int, length_m: float, duration_s: float) -> str:
    path = f"is {length_m:.1f} m long"
    texts = {ConditionKind.TIME: f"lasts {duration_s:.1f} s", ConditionKind.FRAMES: f"has {frames} frames"}
    texts[ConditionKind.TURN] = "never turns so far"
    texts[ConditionKind.DISPLACEMENT] = "never gets so far in a straight line"
    told = " and ".join(dict.fromkeys(texts.get(part.kind, path) for part in condition.parts))
    named = ",".join(f"{part.kind}={part.value:g}" for part in condition.parts)
    one = "one pose of the estimate has a true pose, at least two are needed"
    return f"condition {named}: {f'the drive {told}' if frames > 1 else one}"
