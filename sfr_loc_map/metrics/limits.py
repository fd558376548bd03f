"""Limits of a requirements file, whose form docs/metrics.md shows, and the verdicts on them.

Every key names figure and unit; limits are upper bounds, except `coverage_min`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.config import load_yaml, suggestion
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.catalogue import CATALOGUE, KINDS, TARGET, FigureKind, Subject
from sfr_loc_map.metrics.config import CallKind, Condition, ConditionKind, Rebase, VerdictState, label_of
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.proof import (
    BOUND,
    Proof,
    Terms,
    bound_row,
    prove,
    sample_of,
    terms_of,
    terms_of_record,
    words_of,
)
from sfr_loc_map.metrics.score import ANY, Figure, Score, Verdict, is_lower_bound
from sfr_loc_map.metrics.statistics import Interval


class LimitPart(StrEnum):
    """Part of the score that limits are on; the parts of a limits file."""

    COMPLETENESS = "completeness"
    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    TARGET = "target"


class Limited(NamedTuple):
    """The number that a limit is on: a row of the table of figures, and a column of it."""

    subject: Subject
    figure: str
    statistic: str
    part: str | None = ANY  #: Any: the first row, which is that of the whole, or of the reading that is judged.

    def of_target(self) -> Limited:
        """Return the same number of the calls that were measured on a target."""
        return self._replace(part=TARGET if self.part in (ANY, None) else f"{TARGET} {self.part}")


NOTHING = Limited(Subject.TRAJECTORY, "", "")
COVERAGE_MIN = "coverage_min"  #: The one limit that is a lower bound.


def names_of(
    kinds: Iterable[FigureKind], statistics: Sequence[str] = STATISTICS, part: str | None = ANY
) -> dict[str, Limited]:
    """Return the names of limits on some figures, which end in the unit: `position_mean_plus_3sigma_m`."""
    return {
        f"{kind.name}_{statistic}_{kind.unit}": Limited(kind.subject, kind.name, statistic, part)
        for kind in kinds
        for statistic in statistics
    }


PLACES: dict[LimitPart, dict[str, Limited]] = {
    LimitPart.COMPLETENESS: {
        f"{kind.name}_max_share": Limited(Subject.COMPLETENESS, kind.name, "value", None)
        for kind in CATALOGUE
        if kind.subject is Subject.COMPLETENESS and kind.name not in ("judged", "longest_gap")
    },
    LimitPart.TRAJECTORY: names_of(
        [kind for kind in CATALOGUE if kind.subject is Subject.TRAJECTORY and kind.name not in ("ape", "rpe")],
        (*STATISTICS, BOUND),
    ),
    LimitPart.MAP: {
        **names_of([KINDS["point_error"]], part=None),
        COVERAGE_MIN: Limited(Subject.MAP, "coverage", "value", None),
    },
    LimitPart.TIMING: {
        "mapping_call_s": Limited(Subject.TIMING, CallKind.MAPPING_CALL.value, "max", None),
        **names_of([kind for kind in CATALOGUE if kind.subject is Subject.TIMING], part=None),
    },
    LimitPart.MEMORY: {
        f"{call}_{kind.name}_bytes": Limited(Subject.MEMORY, kind.name, "value", call.value)
        for call in (CallKind.LOCALISATION, CallKind.MAPPING, CallKind.MAPPING_CALL)
        for kind in CATALOGUE
        if kind.subject is Subject.MEMORY
    },
}
"""The number that each name of a limits file limits, by the parts of the file; names follow from the catalogue."""
REQUIREMENT = {"id": str, "text": str, "certain": bool}  #: What a requirement says of itself.
TERMS = Terms._fields  #: What a limit on a tolerance bound says besides.
NEEDED = {str: "a text, in quotes, is needed", bool: "true or false is needed"}
OF_MAP = ("points_without_truth", "pairs_without_cloud")  #: Figures of completeness that are about the map.
SHARES = {
    name: LimitPart.MAP if limited.figure in OF_MAP else LimitPart.TRAJECTORY
    for name, limited in PLACES[LimitPart.COMPLETENESS].items()
}
"""Limits of completeness, which may be in another part of the file, too."""
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
    terms: Terms | None = None  #: Share, confidence and interpretation of a limit on a tolerance bound.

    @property
    def limited(self) -> Limited:
        """The number that is limited."""
        if self.part is LimitPart.TARGET:
            names = PLACES[LimitPart.TIMING] | PLACES[LimitPart.MEMORY]
            return names[self.key].of_target()
        return PLACES[self.part][self.key]

    @property
    def is_lower_bound(self) -> bool:
        """Whether the figure must not be below the limit."""
        return is_lower_bound(self.key)

    @property
    def is_on_one_call(self) -> bool:
        """Whether one call makes what is limited, so that no number of values is required."""
        return self.key in ("mapping_call_s", "mapping_call_max_s")


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
    found: list[Limit] = []
    for item in verdicts:
        key = item.name.removeprefix("target ")
        parts = [part for part in LimitPart if key in PLACES.get(part, ())]
        if key != item.name:
            parts = [LimitPart.TARGET]
        if parts:
            condition = None if item.condition is None else Condition.parse(item.condition)
            terms = None if item.proof is None else terms_of_record(item.proof)
            found.append(Limit(parts[0], key, item.limit, condition, item.id, item.text, item.needs_certainty, terms))
    return Limits(tuple(found)) if found else None


def _limits_of(part: LimitPart, block: object, origin: str, condition: Condition | None) -> list[Limit]:
    """Return the limits of a block; `id`, `text` and `certain` are of all of it, or of one limit `{limit: ...}`."""
    if not isinstance(block, Mapping):
        raise ConfigError(f"{origin}: a mapping of names to limits is needed, found {type(block).__name__}")
    shares = [key for key, other in SHARES.items() if other is part]
    _check_keys(block, (*NAMES[part], *shares, *REQUIREMENT), origin)
    of_all = {key: block[key] for key in REQUIREMENT if key in block}
    made = []
    for key, value in block.items():
        if key in REQUIREMENT:
            continue
        entry = dict(value) if isinstance(value, Mapping) else {"limit": value}
        is_bound = part is LimitPart.TRAJECTORY and PLACES[part].get(key, NOTHING).statistic == BOUND
        _check_keys(entry, ("limit", *REQUIREMENT, *(TERMS if is_bound else ())), f"{origin}: '{key}'")
        terms, problem = terms_of(entry) if is_bound else (None, None)
        if problem is not None:
            raise ConfigError(f"{origin}: '{key}': {problem}")
        entry = {name: given for name, given in entry.items() if name not in TERMS}
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
        made.append(Limit(where, key, float(bound), over, terms=terms, **entry))
    return made


def _check_keys(block: Mapping[str, Any], known: Collection[str], origin: str) -> None:
    for key in block:
        if key not in known:
            raise ConfigError(f"{origin}: unknown key '{key}'{suggestion(str(key), known)}")


# ---- verdicts


def judged(score: Score, limits: Limits | None) -> Score:
    """Return a score with the verdict on each limit, and over all; tolerance bounds are rows of its table."""
    found = verdicts(limits, score)
    others = tuple(row for row in score.figures if row.figure != BOUND)
    return with_verdict(struct_replace(score, figures=(*others, *bound_rows(found)), verdicts=found))


def with_verdict(score: Score) -> Score:
    """Return a score with the verdict over all its verdicts."""
    return struct_replace(score, verdict=overall_verdict(score))


def overall_verdict(score: Score) -> VerdictState | None:
    """Return the verdict over all limits; no figure judges where estimate and truth contradict each other.

    A method that did something wrong has failed, whatever its figures, and where no limit was given.
    """
    if score.failures:
        return VerdictState.FAIL
    if score.contradiction is not None:
        return None
    states = [item.state for item in score.verdicts if item.state is not VerdictState.INCOMPLETE]
    if VerdictState.FAIL in states:
        return VerdictState.FAIL
    if score.incomplete is not None:
        return VerdictState.INCOMPLETE
    if not states:
        return None
    return VerdictState.PASS if set(states) == {VerdictState.PASS} else VerdictState.NOT_ENOUGH_DATA


def verdicts(limits: Limits | None, score: Score) -> tuple[Verdict, ...]:
    """Return the verdict on each limit: pass, fail, or not enough data.

    First of all those that need no limit: on what the method did wrong; and, where there are limits, that the estimate
    is incomplete. A figure passes at its limit; a mean of a signed figure (heading) is taken without its sign.
    `certain` says whether the 95 % interval lies on one side of the limit, None where there is no interval.
    """
    found = list(finding_verdicts(score))
    if limits is None:
        return tuple(found)
    if score.incomplete is not None and score.has(Subject.TRAJECTORY):
        found.append(incomplete_verdict(score.number("judged")))
    for limit in limits.limits:
        if limit.terms is not None:
            sample = sample_of(score, limit.limited.figure, condition_of(limit))
            found.append(proof_verdict(limit, prove(limit.terms, limit.limit, [[sample]] if sample else [])))
            continue
        verdict = verdict_on(limit, figure_of(limit, score), limits.minimum_count)
        found.append(struct_replace(verdict, by_reading=_by_reading(limit, score, limits.minimum_count)))
    return tuple(found)


def finding_verdicts(score: Score) -> Iterator[Verdict]:
    """Yield a failed verdict for each kind of finding with which no score can be a pass."""
    for item in score.failures:
        yield plain_verdict(f"{item.kind.replace(' ', '_')}_calls", 0.0, float(item.count), VerdictState.FAIL)


def incomplete_verdict(share: float | None) -> Verdict:
    """Return the verdict on an estimate of a part of the drive, of which so much was judged."""
    return plain_verdict("judged_share_min", 1.0, share, VerdictState.INCOMPLETE)


def plain_verdict(name: str, limit: float, value: float | None, state: VerdictState) -> Verdict:
    """Return a verdict that is on no figure of the table."""
    margin = None if value is None else min(value - limit, limit - value)
    return Verdict(name=name, limit=limit, value=value, margin=margin, state=state)


class LimitedFigure(NamedTuple):
    """The number that a limit is on, how many values it is made of and its 95 % interval, where it has them."""

    value: float | None = None
    n: int | None = None
    interval: Interval | None = None
    row: Figure | None = None


def figure_of(limit: Limit, score: Score, part: str | None = ANY) -> LimitedFigure:
    """Return the number that a limit is on, by the reading that is judged or, of a trajectory, by another part."""
    limited = limit.limited
    place = limited.part if part == ANY else part
    condition = ANY if limit.condition is None else limit.condition
    row = score.figure(limited.figure, subject=limited.subject, condition=condition, part=place)
    if row is None:
        return LimitedFigure()
    is_counted = limited.statistic in STATISTICS and not limit.is_on_one_call
    interval = row.interval if limited.statistic == "mean_plus_3sigma" else None
    return LimitedFigure(row.statistic(limited.statistic), row.n if is_counted else None, interval, row)


def verdict_on(limit: Limit, figure: LimitedFigure, minimum_count: int) -> Verdict:
    """Return the verdict on a number; without a count it is not made of many values."""
    value, interval, certain = figure.value, figure.interval, None
    state = VerdictState.NOT_ENOUGH_DATA
    if value is not None and (figure.n is None or figure.n >= minimum_count):
        certain = None if interval is None else not interval[0] <= limit.limit < interval[1]
        counted = limit.part is LimitPart.COMPLETENESS  # not estimated: there is nothing uncertain
        if not meets(limit, value):
            state = VerdictState.FAIL
        elif certain or counted or not limit.certain:
            state = VerdictState.PASS
    limited, row = limit.limited, figure.row
    return Verdict(
        id=limit.id,
        text=limit.text,
        name=f"target {limit.key}" if limit.part is LimitPart.TARGET else limit.key,
        subject=limited.subject,
        condition=None if limit.condition is None else limit.condition.setting,
        part=None if row is None else row.part,
        figure=limited.figure,
        statistic=limited.statistic,
        limit=limit.limit,
        value=value,
        low95=None if interval is None else interval[0],
        high95=None if interval is None else interval[1],
        margin=None if value is None else margin_of(limit, value),
        n=figure.n,
        state=state,
        certain=certain,
        needs_certainty=limit.certain,
    )


def condition_of(limit: Limit) -> str | None:
    """Return the condition of a limit as rows have it."""
    return None if limit.condition is None else limit.condition.setting


def proof_verdict(limit: Limit, proof: Proof) -> Verdict:
    """Return the verdict on a limit with a share and a confidence."""
    verdict = verdict_on(limit, LimitedFigure(proof.bound), 0)
    return struct_replace(verdict, state=proof.state, n=int(proof.record.independent), proof=proof.record)


def bound_rows(found: Iterable[Verdict]) -> Iterator[Figure]:
    """Yield the tolerance bounds of verdicts as rows of the table of figures."""
    for item in found:
        if item.proof is not None and item.figure is not None:
            proof = Proof(item.state, item.value, item.proof)
            yield bound_row(item.figure, KINDS[item.figure].unit, item.condition, proof)


def margin_of(limit: Limit, value: float) -> float:
    """Return the distance from a value to its limit, negative where the limit is missed."""
    return value - limit.limit if limit.is_lower_bound else limit.limit - abs(value)


def meets(limit: Limit, value: float) -> bool:
    """Tell whether a value lies within a limit; a figure passes at its limit."""
    return value >= limit.limit if limit.is_lower_bound else abs(value) <= limit.limit


def _by_reading(limit: Limit, score: Score, minimum_count: int) -> dict[str, VerdictState]:
    """Return whether the figure of each reading of the document meets a limit; the intervals are of one reading."""
    if limit.condition is None or limit.part is not LimitPart.TRAJECTORY:
        return {}
    loose = replace(limit, certain=False)
    found = {str(reading): figure_of(limit, score, reading) for reading in Rebase if not reading.is_fit}
    if any(figure.row is None for figure in found.values()):  # chord errors are the same by each reading
        return {}
    return {name: verdict_on(loose, figure, minimum_count).state for name, figure in found.items()}


# ---- what could not be judged, and why


def reasons_not_judged(score: Score, asked: Collection[Condition] = ()) -> tuple[str, ...]:
    """Return why something could not be judged, a phrase each; conditions of the settings count if none is asked."""
    if score.contradiction is not None:
        return (score.contradiction,)
    whole = () if score.incomplete is None else (f"incomplete: {score.incomplete}",)
    unmet: dict[str | None, str] = {}
    if (drive := score.association) is not None:
        extent = drive.matched, drive.path_length_m, drive.duration_s or 0.0
        for row in score.rows("position", part=str(drive.rebase)):
            if row.condition is not None and not row.n:
                condition = Condition.parse(row.condition)
                if not asked or condition in asked:
                    unmet[row.condition] = _reason(condition, *extent)
    reasons = [*whole, *unmet.values()]
    points = score.figure("point_error")
    if points is not None and not points.n:
        reasons.append("map: no point of the cloud has a true point")
    for item in score.verdicts:
        if item.state is VerdictState.NOT_ENOUGH_DATA and item.condition not in unmet:
            over = "" if item.condition is None else f" over {label_of(item.condition)}"
            few = f"only {item.n} values" if item.n else "no data"
            interval = item.interval
            if item.proof is not None:
                few = words_of(item.proof, item.state)
            if item.needs_certainty and item.value is not None and (interval is None or item.certain is not None):
                few = f"'certain' needs its 95 % interval {'' if interval is None else 'within the limit'}".rstrip()
                few += ", which it does not have" if interval is None else ""
            reasons.append(f"limit {item.name}{over}: {few}")
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
