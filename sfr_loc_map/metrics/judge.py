"""The judge: verdicts are a pure function of a score.

Of the score it reads the figures, the rules, the findings, the errors of tolerance bounds, the association, the answers
of an external node, and whether estimate and truth contradict each other. No view drops or edits a verdict.
`metrics.score_json` derives the verdicts of a file again when the file is read, and refuses a file whose verdicts do
not follow from its figures. docs/metrics.md, "Verdicts".
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.catalogue import KINDS, Subject
from sfr_loc_map.metrics.completeness import CALLS, DRIVE, LIVE, MAP, MEMORY
from sfr_loc_map.metrics.config import CallKind, Condition, ConditionKind, Rebase, VerdictState, label_of
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.limits import COVERAGE_MIN, OF_MAP, WORST, Limit, LimitPart, Limits
from sfr_loc_map.metrics.proof import BOUND, Interpretation, Proof, Terms, bound_row, prove, sample_of, words_of
from sfr_loc_map.metrics.score import ANY, Figure, LimitRecord, Rules, Score, Verdict, is_lower_bound
from sfr_loc_map.metrics.shortfalls import SHORTFALLS
from sfr_loc_map.metrics.statistics import Interval
from sfr_loc_map.metrics.tolerance import CONFIDENCE
from sfr_loc_map.metrics.truth_error import ATTITUDE

COVERAGE_FACTORS = {"mean_plus_3sigma": 3.0, "max": 3.0, "p99": 3.0, "p95": 2.0}
"""Standard deviations of the truth's error that a statistic may be off by, 1 for others."""
NOT_DUE = "nothing of the {part} is due yet"
ROUNDING = 1e-9  #: Relative difference up to which a stored number is the derived one.
UNKNOWN = "what was expected of the {part} is unknown: score against the source"


# ---- the rules of a score


def rules_of(limits: Limits | None, *, partial: bool) -> Rules | None:
    """Return limits as a score keeps them; None where there is no limit and no part was asked for."""
    if limits is None and not partial:
        return None
    records = () if limits is None else tuple(_record_of(limit) for limit in limits.limits)
    rules = Rules(limits=records, partial=partial)
    if limits is not None:
        least = {"minimum_count": limits.minimum_count, "minimum_independent": limits.minimum_independent}
        rules = struct_replace(rules, **least)
    return struct_replace(rules, sha256=hash_of(rules))


def hash_of(rules: Rules) -> str:
    """Return the hash of rules."""
    return hashlib.sha256(msgspec.json.encode(struct_replace(rules, sha256=""))).hexdigest()


def limits_of(score: Score) -> Limits | None:
    """Return the limits that a score was judged by, None without limits."""
    rules = score.rules
    if rules is None or not rules.limits:
        return None
    limits = []
    for item in rules.limits:
        condition = None if item.condition is None else Condition.parse(item.condition)
        terms = None
        if item.prob is not None and item.confidence is not None:
            interpretation = Interpretation(item.interpretation or Interpretation.TEMPORAL)
            power = CONFIDENCE if item.power is None else item.power
            terms = Terms(item.prob, item.confidence, interpretation, bool(item.normal), power, item.good)
        limits.append(
            Limit(
                part=LimitPart(item.part),
                key=item.name,
                limit=item.limit,
                condition=condition,
                id=item.id,
                text=item.text,
                certain=item.certain,
                terms=terms,
            )
        )
    return Limits(tuple(limits), rules.minimum_count, rules.minimum_independent)


def _record_of(limit: Limit) -> LimitRecord:
    given = {} if limit.terms is None else limit.terms._asdict()
    # a whole number of a limits file is hashed as the float that it is read back as
    terms: dict[str, Any] = {name: float(value) if type(value) is int else value for name, value in given.items()}
    return LimitRecord(
        **terms,
        part=limit.part.value,
        name=limit.key,
        limit=float(limit.limit),
        condition=None if limit.condition is None else limit.condition.setting,
        id=limit.id,
        text=limit.text,
        certain=limit.certain,
    )


# ---- completeness


class Shortfall(NamedTuple):
    """What of a part cannot be judged, though it was expected."""

    part: str  #: `drive`, `map`, `calls localisation`, ...
    figure: str  #: Figure that is beyond its largest fraction; `judged` where what was expected is unknown.
    most: float  #: That fraction.
    value: float | None
    text: str

    @property
    def verdict(self) -> Verdict:
        """The verdict that states the shortfall."""
        is_lower_bound = self.figure == "judged"
        name = "judged_share_min" if is_lower_bound else f"{self.figure}_max_share"
        if KINDS[self.figure].is_count:
            name = f"{self.figure}_max"
        return Verdict(
            name=name,
            subject=Subject.COMPLETENESS,
            part=self.part if is_lower_bound else None,
            figure=self.figure,
            statistic="value",
            limit=self.most,
            value=self.value,
            margin=None if self.value is None else margin_of(name, self.most, self.value),
            state=VerdictState.INCOMPLETE,
        )


def shortfalls(score: Score) -> list[Shortfall]:
    """Return what of the judged parts of a score is not complete; empty where a part was asked for."""
    limits = limits_of(score)
    if limits is None:
        return []
    found: list[Shortfall] = []
    allowed = {limit.key.removesuffix("_max_share") for limit in limits.limits if limit.part is LimitPart.COMPLETENESS}
    if any(limit.key == COVERAGE_MIN for limit in limits.limits):
        allowed.add("pixels_without_point")
    for part in parts_of(limits, score):
        found += _shortfalls_of(score, part, allowed)
    return found


def parts_of(limits: Limits, score: Score) -> list[str]:
    """Return the parts of a score that limits judge, as the rows `judged` name them."""
    found = [DRIVE] if score.has(Subject.TRAJECTORY) or score.figure("judged", part=DRIVE) else []
    found += [MAP] if score.has(Subject.MAP) or score.figure("judged", part=MAP) else []
    found += [LIVE] if score.figure("judged", part=LIVE) else []
    for limit in limits.limits:
        if (part := part_of(limit)) not in found and part is not None and figure_of(limit, score).value is not None:
            found.append(part)
    return found


def about(limit: Limit) -> str:
    """Return whether a limit is about a drive or a map."""
    limited = limit.limited
    names = (limited.figure, limited.part or "") if limited.subject is Subject.MEMORY else (limited.figure,)
    if limited.subject in (Subject.TIMING, Subject.MEMORY):
        return DRIVE if any(CallKind.LOCALISATION in name for name in names) else MAP
    return MAP if limited.subject is Subject.MAP or limited.figure in OF_MAP else DRIVE


def what_of(score: Score) -> list[str]:
    """Return whether a score is about a drive, a map, or both."""
    found = []
    for part, subject in ((DRIVE, Subject.TRAJECTORY), (MAP, Subject.MAP)):
        if score.has(subject) or score.figure("judged", part=part) is not None:
            found.append(part)
    return found


def limits_about(limits: Limits | None, parts: Collection[str]) -> Limits | None:
    """Return the limits that are about a drive or a map; None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if about(limit) in parts)
    return replace(limits, limits=chosen) if limits is not None and chosen else None


def each_by_its_limits(scores: Sequence[Score]) -> list[Score]:
    """Return scores that were judged by one limits file, each by the limits that are about it.

    A limit leaves a score only if another score, which is of the part that the limit is about, is judged by the same
    limit. A limit on a map therefore stays with every score where there are drives alone.
    """
    every = [(what_of(score), limits_of(score)) for score in scores]
    found = []
    for score, (own, limits) in zip(scores, every, strict=True):
        elsewhere = [
            item for parts, given in every if given is not None for item in given.limits if about(item) in parts
        ]
        kept = [item for item in limits.limits if about(item) in own or item not in elsewhere] if limits else []
        if limits is not None and len(kept) < len(limits.limits):
            is_partial = score.rules is not None and score.rules.partial
            score = judged(score, replace(limits, limits=tuple(kept)) if kept else None, partial=is_partial)
        found.append(score)
    return found


def part_of(limit: Limit) -> str | None:
    """Return the part whose completeness a limit needs; None for limits on completeness itself."""
    if limit.part is LimitPart.TRAJECTORY:
        return DRIVE
    if limit.part is LimitPart.MAP:
        return MAP
    if limit.part is LimitPart.COMPLETENESS:
        return None
    limited = limit.limited
    place = "target " if limit.part is LimitPart.TARGET else ""
    if limited.subject is Subject.TIMING:
        return f"{place}{CALLS} {limited.figure}"
    return f"{place}{MEMORY} {(limited.part or '').removeprefix('target ')}"


def _shortfalls_of(score: Score, part: str, allowed: Collection[str]) -> Iterator[Shortfall]:
    row = score.figure("judged", subject=Subject.COMPLETENESS, part=part)
    is_partial = score.rules is not None and score.rules.partial
    if row is None or row.value is None:
        if not is_partial:
            text = NOT_DUE if row is not None and row.n == 0 else UNKNOWN
            yield Shortfall(part, "judged", 1.0, None, text.format(part=part))
        return
    words = part.split()
    if MEMORY in words:
        if row.value < 1.0 and not is_partial and "calls_missing" not in allowed:
            text = f"the memory of {100.0 * (1.0 - row.value):.4g} % of the {words[-1]} calls was not measured"
            yield Shortfall(part, "judged", 1.0, row.value, text)
        return
    of_calls = CALLS in words
    kind = part.replace(f"{CALLS} ", "") if of_calls else None
    for figure, _, most, text in (each for each in SHORTFALLS if each.part == (CALLS if of_calls else part)):
        asked = is_partial and figure not in ("calls_other", "calls_doubled")
        value = score.number(figure, subject=Subject.COMPLETENESS, part=kind)
        if figure in allowed or asked or most is None or value is None or value <= most:
            continue
        said = text.format(percent=f"{100.0 * value:.4g}", value=f"{value:g}", part=kind)
        yield Shortfall(part, figure, most, value, missing_text(score) if figure == "missing" else said)


def missing_text(score: Score) -> str:
    """Return how much of a drive has no estimate."""
    drive, value = score.association, score.number("missing", part=None) or 0.0
    what = "images" if drive is None or drive.images else "true poses"
    if value == 1.0 and drive is None:
        return f"no pose for any of {score.number('missing', 'n', part=None):.0f} {what}"
    text = f"the estimate covers {100.0 * (1.0 - value):.4g} % of the {what}"
    longest_m, longest_s = (score.number("longest_gap", part=part) for part in ("distance", "time"))
    if longest_m is not None and longest_s is not None:
        text += f", its longest gap is {longest_m:.4g} m and {longest_s:.4g} s"
    if what == "true poses":
        text += "; where the truth is longer or denser than the images, score against the source with its images"
    return text


def why_incomplete(score: Score) -> str | None:
    """Return what of the expected data cannot be judged; without limits only what is plainly absent."""
    if score.rules is not None and score.rules.limits:
        texts = [item.text for item in shortfalls(score)]
    elif score.rules is not None and score.rules.partial:
        texts = []
    else:
        texts = [] if score.association is None or not score.association.incomplete else [score.association.incomplete]
        if score.association is None and score.number("missing", part=None):
            texts = [missing_text(score)]
        pairs, bare = score.number("pairs"), score.number("pairs_without_cloud", part="count")
        row = score.figure("judged", part=MAP)
        if row is not None and row.n and bare and row.n > (pairs or 0.0):
            texts.append(f"the map holds {row.n - bare:.0f} of {row.n} pairs")
    node = score.external
    is_partial = score.rules is not None and score.rules.partial
    allows = score.rules is not None and any(item.name == "missing_max_share" for item in score.rules.limits)
    is_silent = node is not None and node.task == CallKind.LOCALISATION and node.answers.missing
    if node is not None and is_silent and not is_partial and not allows:
        texts.append(f"{node.answers.missing} of {node.answers.pairs} pairs have no answer")
    return "; ".join(dict.fromkeys(texts)) or None


# ---- several scores


class Common(NamedTuple):
    """The verdict over several scores; None where there is none in common."""

    state: VerdictState | None
    text: str = ""


WORST_FIRST = (
    VerdictState.FAIL,
    VerdictState.NOT_JUDGED,
    VerdictState.INCOMPLETE,
    VerdictState.NOT_ENOUGH_DATA,
    None,
    VerdictState.PASS,
)


def common_verdict(scores: Sequence[Score]) -> Common:
    """Return the verdict over scores: the worst, and a pass only if all are of one item under test, which is named."""
    states = [score.verdict for score in scores]
    worst = min(states, key=WORST_FIRST.index, default=None)
    items = {None if score.method is None else (score.method.name, score.method.version, score.method.sha256)
             for score in scores}  # fmt: skip
    if worst is None and any(states):
        return Common(None, "There is no common verdict: not every score was judged by limits.")
    if worst is not VerdictState.PASS or len(scores) < 2:
        return Common(worst)
    if None in items:
        return Common(None, "There is no common verdict: not every score names its item under test.")
    if len(items) > 1:
        return Common(None, f"There is no common verdict: the scores are of {len(items)} items under test.")
    return Common(worst)


# ---- verdicts


def judged(score: Score, limits: Limits | None, *, partial: bool = False) -> Score:
    """Return a score with its rules, the verdict on each limit, and over all."""
    return judged_again(struct_replace(score, rules=rules_of(limits, partial=partial)))


def judged_again(score: Score) -> Score:
    """Return a score with the verdicts that follow from its figures and rules; tolerance bounds are rows as well."""
    score = struct_replace(score, incomplete=why_incomplete(score))
    score = struct_replace(score, verdicts=verdicts(score))
    others = tuple(row for row in score.figures if row.figure != BOUND)
    score = struct_replace(score, figures=(*others, *bound_rows(score.verdicts)))
    return struct_replace(score, verdict=overall_verdict(score))


def judged_at_the_end(score: Score, missing: str) -> Score:
    """Return a score so far as that of a run that is over, of which something is missing; its figures are unchanged.

    The last report of a live run was made while results were still due. What is missing then makes it incomplete,
    unless a part was asked for or a limit says how much may be missing.
    """
    rules = score.rules
    allows = rules is not None and (rules.partial or any(item.name == "missing_max_share" for item in rules.limits))
    if allows or score.incomplete is not None or not missing:
        return score
    states = {VerdictState.PASS: VerdictState.INCOMPLETE}
    found = tuple(struct_replace(item, state=states.get(item.state, item.state)) for item in score.verdicts)
    score = struct_replace(score, incomplete=missing, verdicts=found)
    return struct_replace(score, verdict=overall_verdict(score))


def contradiction_of(score: Score) -> str | None:
    """Return what of a stored score does not follow from its figures and its rules; None if everything does."""
    if score.rules is not None and score.rules.sha256 != hash_of(score.rules):
        return "its limits are not those that it was judged by (rules.sha256)"
    for row in score.figures:
        if row.mean is None or row.sigma is None or row.mean_plus_3sigma is None:
            continue
        expected = abs(row.mean) + 3.0 * row.sigma
        if abs(row.mean_plus_3sigma - expected) > ROUNDING * max(expected, 1e-300):
            return f"mean_plus_3sigma of {label(row)} is {row.mean_plus_3sigma:.9g}, |mean| + 3 sigma is {expected:.9g}"
    again = judged_again(score)
    if again.figures != score.figures:
        return "its tolerance bounds do not follow from its sub-trajectories"
    if len(again.verdicts) != len(score.verdicts):
        return f"it has {len(score.verdicts)} verdicts, from its figures and limits follow {len(again.verdicts)}"
    for stored, derived in zip(score.verdicts, again.verdicts, strict=True):
        for field in Verdict.__struct_fields__:
            mine, theirs = getattr(stored, field), getattr(derived, field)
            if mine != theirs and not _is_near(mine, theirs):
                place = f"{json_name(field)} of the verdict on {stored.name}"
                return f"{place} is {_text(mine)}, from the figures follows {_text(theirs)}"
    for field in ("verdict", "incomplete"):
        mine, theirs = getattr(score, field), getattr(again, field)
        if mine != theirs:
            return f"{field} is {_text(mine)}, from the figures follows {_text(theirs)}"
    return None


def json_name(field: str) -> str:
    """Return the name of a field of a verdict in the JSON."""
    return "verdict" if field == "state" else field


def label(row: Figure) -> str:
    """Return what names a row of the table."""
    return " ".join(filter(None, (row.figure, row.condition, row.part)))


def _is_near(mine: object, theirs: object) -> bool:
    if not isinstance(mine, float | int) or not isinstance(theirs, float | int):
        return False
    return abs(mine - theirs) <= ROUNDING * max(abs(mine), abs(theirs))


def _text(value: object) -> str:
    return "null" if value is None else f"'{value}'" if isinstance(value, str) else f"{value}"


def overall_verdict(score: Score) -> VerdictState | None:
    """Return the verdict over all limits; no figure judges where estimate and truth contradict each other.

    A method that did something wrong has failed, whatever its figures, and where no limit was given.
    """
    if score.failures:
        return VerdictState.FAIL
    if score.contradiction is not None:
        return None
    states = [item.state for item in score.verdicts]
    if VerdictState.FAIL in states:
        return VerdictState.FAIL
    if score.incomplete is not None or VerdictState.INCOMPLETE in states:
        return VerdictState.INCOMPLETE
    if not states:
        return None
    return VerdictState.PASS if set(states) == {VerdictState.PASS} else VerdictState.NOT_ENOUGH_DATA


def verdicts(score: Score) -> tuple[Verdict, ...]:
    """Return the verdict on each limit of a score: pass, fail, incomplete, not enough data or not judged.

    First of all the verdicts that need no limit: on what the method did wrong, and, where there are limits, on what
    is not complete. A figure passes at its limit, and only if the part that it is about is complete. A mean of a
    signed figure (heading) is taken without its sign. Where estimate and truth contradict each other, no figure of them
    judges anything: verdicts on limits are `not judged`. `certain` says whether the 95 % interval lies on one side of
    the limit, None where there is no interval.
    """
    found = list(finding_verdicts(score))
    limits = limits_of(score)
    if limits is None:
        return tuple(found)
    short = shortfalls(score)
    found += [item.verdict for item in short]
    parts = {item.part for item in short}
    if score.incomplete is not None and not short:
        parts.add(DRIVE)
    for limit in limits.limits:
        if limit.terms is None:
            verdict = verdict_on(limit, figure_of(limit, score), limits)
            verdict = struct_replace(verdict, by_reading=_by_reading(limit, score, limits))
        else:
            sample = sample_of(score, limit.limited.figure, condition_of(limit))
            verdict = proof_verdict(limit, prove(limit.terms, limit.limit, {"": [sample]} if sample else {}))
        if score.contradiction is not None:
            verdict = struct_replace(verdict, state=VerdictState.NOT_JUDGED, by_reading={})
        elif verdict.state is VerdictState.PASS and (LIVE in parts or part_of(limit) in parts):
            verdict = struct_replace(verdict, state=VerdictState.INCOMPLETE)
        found.append(verdict)
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
    margin = None if value is None else margin_of(name, limit, value)
    return Verdict(name=name, limit=limit, value=value, margin=margin, state=state)


class LimitedFigure(NamedTuple):
    """The number that a limit is on, how many values it is made of and its 95 % interval, where it has them."""

    value: float | None = None
    n: int | None = None
    interval: Interval | None = None
    row: Figure | None = None
    independent: float | None = None  #: How many of the values are independent, None where that is not defined.
    truth_error: float = 0.0  #: What the error of the truth may change the number by.


def figure_of(limit: Limit, score: Score, part: str | None = ANY) -> LimitedFigure:
    """Return the number that a limit is on, by the reading that is judged or, of a trajectory, by another part."""
    limited = limit.limited
    place = limited.part if part == ANY else part
    condition = ANY if limit.condition is None else limit.condition
    if place == WORST:
        rows = score.rows(limited.figure, subject=limited.subject)
        row = max(rows, key=lambda item: math.inf if item.value is None else item.value, default=None)
    elif place == ANY:
        row = score.judged_row(limited.figure, subject=limited.subject, condition=condition)
    else:
        row = score.figure(limited.figure, subject=limited.subject, condition=condition, part=place)
    if row is None:
        return LimitedFigure()
    is_counted = limited.statistic in STATISTICS and not limit.is_on_one_call
    interval = row.interval if limited.statistic == "mean_plus_3sigma" else None
    count = row.n if is_counted else None
    error = truth_error_of(limit, score)
    return LimitedFigure(row.statistic(limited.statistic), count, interval, row, row.independent, error)


def truth_error_of(limit: Limit, score: Score) -> float:
    """Return what the error of the truth may change a limited number by: that of both ends of a sub-trajectory."""
    limited = limit.limited
    if limit.part is not LimitPart.TRAJECTORY:
        return 0.0
    part = None if limited.figure in ("position", "chord") else ATTITUDE
    sigma = score.number("truth_error", part=part) or 0.0
    return COVERAGE_FACTORS.get(limited.statistic, 1.0) * float(np.sqrt(2.0)) * sigma


def is_enough(limit: Limit, figure: LimitedFigure, limits: Limits) -> bool:
    """Tell whether a number is made of enough values, of which enough are independent."""
    if figure.n is not None and figure.n < limits.minimum_count:
        return False
    is_of_many = limit.part is LimitPart.TRAJECTORY and figure.independent is not None
    return not is_of_many or (figure.independent or 0.0) >= limits.minimum_independent


def verdict_on(limit: Limit, figure: LimitedFigure, limits: Limits) -> Verdict:
    """Return the verdict on a number; without a count it is not made of many values."""
    value, interval, certain = figure.value, figure.interval, None
    state = VerdictState.NOT_ENOUGH_DATA
    if value is not None and is_enough(limit, figure, limits):
        certain = None if interval is None else not interval[0] <= limit.limit < interval[1]
        counted = limit.part is LimitPart.COMPLETENESS  # not estimated: there is nothing uncertain
        if figure.truth_error and abs(margin_of(limit.key, limit.limit, value)) <= figure.truth_error:
            state = VerdictState.NOT_ENOUGH_DATA
        elif not meets(limit, value):
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
        margin=None if value is None else margin_of(limit.key, limit.limit, value),
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
    verdict = verdict_on(limit, LimitedFigure(proof.bound), Limits(()))
    return struct_replace(verdict, state=proof.state, n=proof.n, proof=proof.record)


def bound_rows(found: Iterable[Verdict]) -> Iterator[Figure]:
    """Yield the tolerance bounds of verdicts as rows of the table of figures."""
    for item in found:
        if item.proof is not None and item.figure is not None:
            proof = Proof(item.state, item.value, item.proof, item.n or 0)
            yield bound_row(item.figure, KINDS[item.figure].unit, item.condition, proof)


def margin_of(name: str, limit: float, value: float) -> float:
    """Return the distance from a value to the limit of this name, negative where the limit is missed."""
    return value - limit if is_lower_bound(name) else limit - abs(value)


def meets(limit: Limit, value: float) -> bool:
    """Tell whether a value lies within a limit; a figure passes at its limit."""
    return value >= limit.limit if limit.is_lower_bound else abs(value) <= limit.limit


def _by_reading(limit: Limit, score: Score, limits: Limits) -> dict[str, VerdictState]:
    """Return whether the figure of each reading of the document meets a limit; the intervals are of one reading."""
    if limit.condition is None or limit.part is not LimitPart.TRAJECTORY:
        return {}
    loose = replace(limit, certain=False)
    found = {str(reading): figure_of(limit, score, reading) for reading in Rebase if not reading.is_fit}
    if any(figure.row is None for figure in found.values()):  # chord errors are the same by each reading
        return {}
    independent = figure_of(limit, score).independent  # the readings are of the same sub-trajectories
    found = {name: figure._replace(independent=independent) for name, figure in found.items()}
    return {name: verdict_on(loose, figure, limits).state for name, figure in found.items()}


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
            few = few_words(item, score)
            interval = item.interval
            if item.proof is not None:
                few = words_of(item.proof, item.state)
            if item.needs_certainty and item.value is not None and (interval is None or item.certain is not None):
                few = f"'certain' needs its 95 % interval {'' if interval is None else 'within the limit'}".rstrip()
                few += ", which it does not have" if interval is None else ""
            reasons.append(f"limit {item.name}{over}: {few}")
    return tuple(reasons)


def few_words(item: Verdict, score: Score) -> str:
    """Return why a limited number is not made of enough data."""
    rules = score.rules or Rules()
    limits = limits_of(score) or Limits(())
    for limit in limits.limits:
        same = (limit.key, limit.limit, condition_of(limit)) == (item.name, item.limit, item.condition)
        error = truth_error_of(limit, score) if same else 0.0
        if error and item.margin is not None and abs(item.margin) <= error:
            return f"its margin of {item.margin:.3g} is within the error of the truth, {error:.3g}"
    row = score.figure(item.figure or "", condition=item.condition, part=item.part)
    if not item.n:
        return "no data" if row is None or not row.unknown else f"all {row.unknown} values are unknown"
    independent = None if row is None else row.independent
    if item.n >= rules.minimum_count and independent is not None and independent < rules.minimum_independent:
        return f"{item.n} values, of which {independent:.3g} are independent ({rules.minimum_independent:g} are needed)"
    if row is not None and row.unknown:
        return f"{row.unknown} of {item.n + row.unknown} values are unknown"
    return f"only {item.n} values"


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
