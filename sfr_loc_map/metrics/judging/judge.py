"""The verdicts of a score, as a pure function of the score.

`with_verdicts` reads the figures, the rules, the findings, the errors of tolerance bounds, the association, and whether
estimate and truth contradict each other. The data of the plots affect no verdict. The verdicts follow in four steps:

1. `with_bounds` judges the limits with a fraction and a confidence, and adds their tolerance bounds to the table.
2. `incomplete.incompleteness` returns the shortfalls: what is missing or wrong.
3. `verdicts_on_limits` judges each limit, first by the limited number alone (`verdict_on`), then by the shortfalls.
4. `overall_verdict` combines these verdicts with those on findings and on shortfalls.

`metrics.stored.file_check` derives the verdicts of a file again when the file is read, and refuses a file whose
verdicts do not follow from its figures. Views show the stored verdicts. A report of several scores judges each score by
the limits that apply to it, and names the other limits (`several_scores.each_by_its_limits`). See docs/metrics.md,
"Verdicts".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import Enum, auto

from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.completeness.shortfall_kinds import OF_LIMIT
from sfr_loc_map.metrics.config import Reading, VerdictState, worst_of
from sfr_loc_map.metrics.figures.catalogue import JUDGED, KINDS
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import LimitSection, Subject
from sfr_loc_map.metrics.judging.incomplete import OF_EACH_LIMIT, Shortfall, incompleteness, text_of
from sfr_loc_map.metrics.judging.limited import LimitedValue, fault_of_data_set, truth_error_of, value_of
from sfr_loc_map.metrics.judging.proof import Proof, bound_row, prove, sample_of
from sfr_loc_map.metrics.score.limits import BOUND, Limit, Limits, margin_of, meets
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import ProofRecord, Verdict


def judged_by(score: Score, limits: Limits | None, *, partial: bool = False) -> Score:
    """Return a score with its rules, the verdict on each limit, and the verdict over all limits.

    `partial` accepts missing data. The score has no rules without limits and without `partial`. InputError if the
    limits name another data set.
    """
    rules = None
    if limits is not None or partial:
        rules = struct_replace(limits or Limits(), partial=partial)
    ruled = struct_replace(score, rules=rules)
    if (fault := fault_of_data_set(ruled)) is not None:
        raise InputError(fault)
    return with_verdicts(ruled)


def with_verdicts(score: Score) -> Score:
    """Return a score with its tolerance bounds as rows, and the verdicts that follow from its figures and rules."""
    table, proved = with_bounds(score)
    shortfalls = incompleteness(table)
    incomplete = text_of(shortfalls)
    verdicts = list(finding_verdicts(table))
    if table.active_rules.limits:
        verdicts += [item.verdict for item in shortfalls]
        verdicts += verdicts_on_limits(table, proved, shortfalls)
    verdict = overall_verdict(table, [item.state for item in verdicts], incomplete)
    return struct_replace(table, incomplete=incomplete, verdicts=tuple(verdicts), verdict=verdict)


def with_bounds(score: Score) -> tuple[Score, dict[Limit, Verdict]]:
    """Return a score with the tolerance bounds as rows, and the verdicts on limits with a fraction and a confidence.

    Bounds that the score already has are replaced.
    """
    rows = [row for row in score.figures if row.figure != BOUND]
    places = {row.keys: place for place, row in enumerate(rows)}
    proved: dict[Limit, Verdict] = {}
    for limit in score.active_rules.limits:
        if limit.terms is None or limit in proved:
            continue
        figure = limit.limited.figure
        sample = sample_of(score, figure, limit.condition)
        truth_error = truth_error_of(limit, score, score.reading)
        proof = prove(limit.terms, limit.limit, {"": [sample]} if sample else {}, truth_error)
        row = bound_row(figure, KINDS[figure].unit, limit.condition, proof)
        if row.keys not in places:  # limits with the same terms have one bound
            places[row.keys] = len(rows)
            rows.append(row)
        proved[limit] = proof_verdict(limit, proof, places[row.keys], truth_error)
    return struct_replace(score, figures=tuple(rows)), proved


def verdicts_on_limits(
    score: Score, proved: Mapping[Limit, Verdict], shortfalls: Sequence[Shortfall]
) -> Iterator[Verdict]:
    """Yield the verdict on each limit of a score: pass, fail, incomplete, not enough data or not judged.

    `proved` has the verdicts on limits with a fraction and a confidence (`with_bounds`). A pass requires that no
    shortfall affects the limit. If estimate and truth contradict each other, all verdicts on limits are `not judged`.
    """
    rules = score.active_rules
    for limit in rules.limits:
        if limit in proved:
            verdict = proved[limit]
        else:
            verdict = verdict_on(limit, value_of(limit, score), rules)
            verdict = struct_replace(verdict, by_reading=_by_reading(limit, score, rules))
        if score.contradiction is not None:
            verdict = struct_replace(verdict, state=VerdictState.NOT_JUDGED, by_reading={})
        elif any(item.affects(limit) for item in shortfalls):
            verdict = of_incomplete(verdict)
        yield verdict


def finding_verdicts(score: Score) -> Iterator[Verdict]:
    """Yield a failed verdict for each kind of finding that prevents a pass."""
    for item in score.fatal_findings:
        yield plain_verdict(f"{item.kind.replace(' ', '_')}_calls", 0.0, float(item.count), VerdictState.FAIL)


def overall_verdict(score: Score, states: Sequence[VerdictState], incomplete: str | None) -> VerdictState | None:
    """Return the verdict over all limits.

    A fatal finding gives the verdict `fail` for any figures, even without limits. If estimate and truth contradict each
    other, there is no verdict.
    """
    if score.fatal_findings:
        return VerdictState.FAIL
    if score.contradiction is not None:
        return None
    return worst_of(states if incomplete is None else [*states, VerdictState.INCOMPLETE])


def of_incomplete(verdict: Verdict) -> Verdict:
    """Return the verdict on a figure of an incomplete part: a pass becomes `incomplete`."""
    is_pass = verdict.state is VerdictState.PASS
    return struct_replace(verdict, state=VerdictState.INCOMPLETE) if is_pass else verdict


def judged_share_verdict(share: float | None) -> Verdict:
    """Return the verdict on an incomplete estimate, of which the fraction `share` was judged."""
    return plain_verdict(JUDGED, 1.0, share, VerdictState.INCOMPLETE)


def plain_verdict(name: str, limit: float, value: float | None, state: VerdictState) -> Verdict:
    """Return a verdict without a row of the table of figures."""
    margin = None if value is None else margin_of(name, limit, value)
    return Verdict(name=name, limit=limit, value=value, margin=margin, state=state)


# ---- the verdict on a limited number


class OpenCause(Enum):
    """Why the numbers of a verdict do not decide between pass and fail (`not enough data`)."""

    NO_VALUE = auto()  #: The limited number is undefined.
    TOO_FEW_VALUES = auto()
    TOO_FEW_INDEPENDENT = auto()
    TRUTH_ERROR = auto()  #: The margin is within the error of the ground truth.
    NOT_CERTAIN = auto()  #: The value meets the limit, but the 95 % interval does not show the required certainty.


def verdict_on(limit: Limit, figure: LimitedValue, rules: Limits) -> Verdict:
    """Return the verdict on the limited number: pass or fail if its numbers decide, otherwise `not enough data`.

    A figure that equals its limit passes. A signed mean (heading) is compared by its absolute value (`margin_of`).
    """
    verdict = verdict_of(limit, figure, VerdictState.NOT_ENOUGH_DATA, certain=is_certain(limit, figure))
    if has_no_items(limit, figure.row):
        return struct_replace(verdict, state=VerdictState.PASS)
    match open_cause(verdict, rules):
        case None:
            return struct_replace(verdict, state=VerdictState.PASS if verdict.is_met else VerdictState.FAIL)
        case OpenCause.TOO_FEW_VALUES | OpenCause.TOO_FEW_INDEPENDENT:
            return struct_replace(verdict, certain=None)
        case _:
            return verdict


def open_cause(verdict: Verdict, rules: Limits) -> OpenCause | None:
    """Return the first cause for which the numbers of a verdict do not decide; None if they decide.

    `reasons.why_open` puts the cause into words. A proof has a rule of its own (`proof.prove`).
    """
    is_enough = rules.has_enough_values(verdict.n)
    if verdict.value is None and (is_enough or not verdict.n):
        return OpenCause.NO_VALUE
    if not is_enough:
        return OpenCause.TOO_FEW_VALUES
    if verdict.condition is not None and not rules.has_enough_independent(verdict.independent):
        return OpenCause.TOO_FEW_INDEPENDENT
    if verdict.is_within_truth_error:
        return OpenCause.TRUTH_ERROR
    is_counted = verdict.subject is Subject.COMPLETENESS  # a count has no uncertainty
    if verdict.is_met and verdict.needs_certainty and not is_counted and not verdict.certain:
        return OpenCause.NOT_CERTAIN
    return None


def has_no_items(limit: Limit, row: Figure | None) -> bool:
    """Return whether a limit on completeness is on a fraction of 0 items, of which none can be missing or wrong."""
    if limit.section is not LimitSection.COMPLETENESS or row is None or row.n != 0:
        return False
    kind = OF_LIMIT[limit.name]
    return not kind.text_of_nothing and kind.figure not in OF_EACH_LIMIT


def is_certain(limit: Limit, figure: LimitedValue) -> bool | None:
    """Return whether the 95 % interval is on the same side of the limit as the value; None without an interval.

    Only upper limits have an interval. The center of the interval is corrected for bias, so the value itself can
    be outside the interval.
    """
    if figure.value is None or figure.interval is None:
        return None
    low95, high95 = figure.interval
    return high95 <= limit.limit if meets(limit, figure.value) else limit.limit < low95


def proof_verdict(limit: Limit, proof: Proof, row_index: int | None, truth_error: float) -> Verdict:
    """Return the verdict on a limit with a fraction and a confidence. Its tolerance bound is a row of the table."""
    independent = proof.record.independent
    figure = LimitedValue(proof.bound, proof.n, row_index=row_index, independent=independent, truth_error=truth_error)
    return verdict_of(limit, figure, proof.state, proof=proof.record)


def verdict_of(
    limit: Limit,
    figure: LimitedValue,
    state: VerdictState,
    *,
    certain: bool | None = None,
    proof: ProofRecord | None = None,
) -> Verdict:
    """Return the verdict on the limited number, with this state."""
    limited = limit.limited
    value = figure.value
    interval = figure.interval
    return Verdict(
        id=limit.id,
        text=limit.text,
        name=limit.shown_name,
        row=figure.row_index,
        subject=limited.subject,
        condition=limit.condition,
        part=limited.part if figure.row is None else figure.row.part,
        figure=limited.figure,
        statistic=limited.statistic,
        limit=limit.limit,
        value=value,
        low95=None if interval is None else interval[0],
        high95=None if interval is None else interval[1],
        margin=None if value is None else margin_of(limit.name, limit.limit, value),
        n=figure.n,
        independent=figure.independent,
        truth_error=figure.truth_error or None,
        state=state,
        certain=certain,
        needs_certainty=limit.certain,
        proof=proof,
    )


def _by_reading(limit: Limit, score: Score, limits: Limits) -> dict[str, VerdictState]:
    """Return the verdict by each reading, without `certain`: only the judged reading has an interval."""
    if limit.condition is None or limit.section is not LimitSection.TRAJECTORY:
        return {}
    loose = struct_replace(limit, certain=False)
    found = {str(reading): value_of(limit, score, reading) for reading in Reading if not reading.is_fit}
    if any(figure.row is None for figure in found.values()):  # chord errors do not depend on the reading
        return {}
    independent = value_of(limit, score).independent  # all readings have the same sub-trajectories
    found = {name: figure._replace(independent=independent) for name, figure in found.items()}
    return {name: verdict_on(loose, figure, limits).state for name, figure in found.items()}
