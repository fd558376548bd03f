"""What makes a score incomplete: expected data that are missing or cannot be judged, and data that are wrong.

For each scope of the score, `shortfalls_of` states whether the expected items are unknown (`unknown_items`) and
evaluates the table `SHORTFALLS` (`metrics.completeness.shortfall_kinds`). `largest_complete` returns the largest value
of a figure with which the scope is complete by the rules of the score. `above_most` compares the figure with this
value. Two figures are compared for each limit on errors instead (`missed_at_other_frames`, `met_by_standing`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.completeness.shortfall_kinds import (
    BEYOND,
    SHORTFALLS,
    UNKNOWN_FIGURE,
    UNKNOWN_ITEMS,
    ShortfallKind,
)
from sfr_loc_map.metrics.conditions import Condition, label_of
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND, JUDGED, STANDING, statistic_title, title_of
from sfr_loc_map.metrics.figures.row_part import (
    DISTANCE,
    MOVING,
    OTHER_FRAMES,
    SUB_TRAJECTORIES,
    TIME,
    Place,
    RowPart,
    calls_part,
)
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import LimitSection, Scope, Subject
from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.metrics.judging.limited import SCOPES_OF_ALL_LIMITS, required_scope, required_scopes, scopes_of_tasks
from sfr_loc_map.metrics.score.limits import Limit, meets
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict

NOT_DUE = "no result of the {part} is expected so far"
NO_MESSAGE = "no message of the live run was received"
UNKNOWN_NUMBER = "the expected number of results of the {part} is unknown: score against the source"
NO_CALL = {
    Place.HOST: "no time of {part} was measured: give the calls of the run (option stats)",
    Place.TARGET: "no time of {part} on the target was measured: give the calls on the target (option target_timing)",
}
"""Why the expected calls are unknown, by the computer on which they were made."""
NO_STATE = "it is unknown which poses are {figure}: give the calls of the run (option stats)"
NO_STAMP = "the {part} have no stamps, so their pairs are unknown"
OF_BOUNDS = ("p50", "p95", "p99")
"""Quantiles that a tolerance bound is compared with, in ascending order; the fraction of a bound is at least 50 %."""
STATES_OF_POSES = ("lost", "degraded")  #: Figures of the states of poses, which only a limit requires to be known.


class Shortfall(NamedTuple):
    """A shortfall of a score."""

    kind: ShortfallKind
    scope: RowPart  #: The incomplete scope, with the kind and the place of calls, as the part of the row `judged`.
    most: float  #: Largest value of the figure for which the scope is complete.
    value: float | None  #: Value of the figure; None if it is unknown.
    text: str  #: What is missing or wrong.
    row: int | None = None  #: Index of the row of the figure in the table.
    limit: Limit | None = None  #: The limit that the shortfall affects; None for all limits that require the scope.

    def affects(self, limit: Limit) -> bool:
        """Return whether the shortfall prevents a pass of a limit."""
        if self.limit is not None:
            return self.limit == limit
        if self.kind.of_figures and limit.limited.figure not in self.kind.of_figures:
            return False
        return self.scope in (*SCOPES_OF_ALL_LIMITS, required_scope(limit))

    @property
    def verdict(self) -> Verdict:
        """The verdict that states the shortfall."""
        return Verdict(
            name=self.kind.limit_name or self.kind.figure,
            row=self.row,
            subject=Subject.COMPLETENESS,
            part=self.scope if self.kind.scope is None else None,
            figure=self.kind.figure,
            statistic="value",
            limit=self.most,
            value=self.value,
            margin=None if self.value is None else -abs(self.value - self.most),
            state=VerdictState.INCOMPLETE,
        )


def incompleteness(score: Score) -> list[Shortfall]:
    """Return what makes a score incomplete by its rules."""
    rules = score.active_rules
    scopes = required_scopes(rules, score) if rules.limits else scopes_of_tasks(score)
    return [item for scope in scopes for item in shortfalls_of(scope, score)]


def shortfalls_of(scope: RowPart, score: Score) -> Iterator[Shortfall]:
    """Yield what makes a scope of a score incomplete."""
    yield from unknown_items(scope, score)
    for kind in SHORTFALLS:
        if kind.scope != scope.what or not concerns_limits(kind, score):
            continue
        if kind.figure in STATES_OF_POSES:
            yield from unknown_states(kind, scope, score)
        elif (most := largest_complete(kind, score)) is not None:
            evaluate = OF_EACH_LIMIT.get(kind.figure, above_most)
            yield from evaluate(kind, scope, score, most)


def concerns_limits(kind: ShortfallKind, score: Score) -> bool:
    """Return whether a kind of shortfall affects every limit of its scope, or a limit of the score."""
    return not kind.of_figures or any(limit.limited.figure in kind.of_figures for limit in score.active_rules.limits)


def largest_complete(kind: ShortfallKind, score: Score) -> float | None:
    """Return the largest value of a figure for which the scope is complete by the rules of a score.

    None if the rules accept every value.
    """
    rules = score.active_rules
    most = kind.most if rules.limits else kind.most_without_limits
    if most is None or (rules.partial and kind.partial):
        return None
    has_images = score.association is None or score.association.images is not None
    for limit in rules.limits:
        most = max(most, kind.allowed_fraction(limit.name, limit.limit, has_images=has_images))
    return most if most < 1.0 else None


def text_of(missing: Iterable[Shortfall]) -> str | None:
    """Return what is missing, each text once; None if nothing is missing."""
    return "; ".join(dict.fromkeys(item.text for item in missing)) or None


def is_lifted_by_partial(score: Score) -> bool:
    """Return whether partial judging (`--partial`) accepts an incomplete score."""
    return not incompleteness(struct_replace(score, rules=struct_replace(score.active_rules, partial=True)))


def strictly_missing(score: Score) -> str | None:
    """Return what makes a score incomplete if partial judging and limits on completeness are not applied.

    The comparison of scores uses this text, because the rules of each score must not affect the comparison.
    """
    rules = score.active_rules
    limits = tuple(limit for limit in rules.limits if limit.section is not LimitSection.COMPLETENESS)
    strict = struct_replace(rules, limits=limits, partial=False)
    return text_of(incompleteness(struct_replace(score, rules=strict))) or score.incomplete


# ---- unknown items and states


def unknown_items(scope: RowPart, score: Score) -> Iterator[Shortfall]:
    """Yield a shortfall if the expected items of a scope are unknown, unless `--partial` accepts unknown items."""
    rules = score.active_rules
    if not rules.limits or rules.partial:
        return
    row = score.figure(JUDGED, subject=Subject.COMPLETENESS, part=scope)
    if row is None or row.value is None:
        yield Shortfall(UNKNOWN_ITEMS, scope, 1.0, None, why_unknown(scope, row), score.index_of(row))


def unknown_states(kind: ShortfallKind, scope: RowPart, score: Score) -> Iterator[Shortfall]:
    """Yield a shortfall for each limit on a state of poses, if the state of a pose is unknown."""
    row = score.figure(kind.figure, part=None)
    if row is None or not row.n or row.value is not None:
        return
    for limit in score.active_rules.limits:
        if limit.limited.figure == kind.figure:
            text = NO_STATE.format(figure=kind.figure)
            yield Shortfall(kind, scope, limit.limit, None, text, limit=limit)


# ---- the shortfalls of one kind and scope; `most` is the largest complete value


def above_most(kind: ShortfallKind, scope: RowPart, score: Score, most: float) -> Iterator[Shortfall]:
    """Yield a shortfall if the figure of a kind exceeds its largest complete value, or is unknown."""
    calls = scope.of_calls if kind.of_node is None else kind.of_node
    row = score.figure(kind.figure, subject=Subject.COMPLETENESS, part=calls)
    if row is None:
        return
    index = score.index_of(row)
    if row.value is None and row.n:
        yield Shortfall(kind, scope, most, None, UNKNOWN_FIGURE.format(title=title_of(kind.figure)), index)
    elif row.value is None and kind.text_of_nothing:
        yield Shortfall(kind, scope, most, None, kind.text_of_nothing, index)
    elif row.value is not None and row.value > most:
        text = kind.text.format(percent=percent_of(row), value=f"{row.value:g}", part=calls, gaps=missing_text(score))
        yield Shortfall(kind, scope, most, row.value, text, index)


def limits_missed_at_other_frames(score: Score) -> Iterator[tuple[Limit, Figure, float]]:
    """Yield each limit that the errors at the other frames miss, with these errors and their limited statistic."""
    for limit in score.active_rules.limits:
        if limit.section is not LimitSection.TRAJECTORY:
            continue
        others = score.figure(limit.limited.figure, condition=limit.condition, part=OTHER_FRAMES)
        value = None if others is None else others.statistic(statistic_of(limit))
        if others is not None and value is not None and not meets(limit, value):
            yield limit, others, value


def missed_at_other_frames(kind: ShortfallKind, scope: RowPart, score: Score, most: float) -> Iterator[Shortfall]:
    """Yield a shortfall for each limit that the errors at the other frames miss.

    A figure always depends somewhat on the choice of the starts. Such a limit is therefore a shortfall only in one of
    two cases:

    - The fraction of the frames whose error is far above the judged errors exceeds `most`.
    - The judged errors meet the limit, but the statistic of the other frames is more than `BEYOND` times the limit. A
      few frames of a short loss can raise every statistic except a quantile so far. For these statistics, the 95 %
      quantile of the other frames must also miss the limit.
    """
    for limit, others, value in limits_missed_at_other_frames(score):
        limited = limit.limited
        statistic = statistic_of(limit)
        share = score.figure(ERRORS_BEYOND, condition=limit.condition, part=limited.figure)
        if share is None or share.value is None:
            continue
        judged = score.figure(limited.figure, condition=limit.condition, part=score.reading)
        judged_value = None if judged is None else judged.statistic(statistic)
        is_met = judged_value is not None and meets(limit, judged_value)
        is_of_many = statistic in QUANTILES or others.p95 is None or not meets(limit, others.p95)
        if share.value > most or (is_met and is_of_many and abs(value) > BEYOND * limit.limit):
            text = kind.text.format(
                percent=percent_of(share),
                spacing=1 if score.association is None else score.association.spacing_frames,
                statistic=statistic_title(statistic),
                figure=title_of(limited.figure),
                condition=label_of(limit.condition),
                value=f"{value:.4g} {others.unit}",
                limit=f"{limit.limit:g} {others.unit}",
            )
            yield Shortfall(kind, scope, most, share.value, text, score.index_of(share), limit)


def met_by_standing(kind: ShortfallKind, scope: RowPart, score: Score, most: float) -> Iterator[Shortfall]:
    """Yield a shortfall for each limit that is met because a stationary rover adds most sub-trajectories.

    The errors of the other sub-trajectories miss the limit, or are too few for a verdict. A drive in which the rover is
    stationary throughout is judged like any other.
    """
    for limit in score.active_rules.limits:
        figure = limit.limited.figure
        condition = limit.condition
        if condition is None:
            continue
        share = score.figure(STANDING, condition=condition, part=SUB_TRAJECTORIES)
        moving = score.figure(figure, condition=condition, part=MOVING)
        if share is None or share.value is None or share.value <= most or moving is None:
            continue
        judged = score.number(figure, statistic_of(limit), condition=condition)
        if judged is None or not meets(limit, judged):
            continue
        value = moving.statistic(statistic_of(limit))
        is_enough = score.active_rules.has_enough_independent(moving.independent or 0.0)
        if value is None or not is_enough or not meets(limit, value):
            count = f"{percent_of(share)} % of the sub-trajectories"
            text = kind.text.format(
                added_by_standing=Condition.parse(condition).added_by_standing(count),
                independent=f"{moving.independent or 0.0:.3g}",
                statistic=statistic_title(statistic_of(limit)),
                figure=title_of(figure),
                value="unknown" if value is None else f"{value:.4g} {moving.unit}",
                limit=limit.name,
            )
            yield Shortfall(kind, scope, most, share.value, text, score.index_of(share), limit)


OF_EACH_LIMIT = {ERRORS_BEYOND: missed_at_other_frames, STANDING: met_by_standing}
"""The rules of figures whose shortfall depends on the limits on errors: each of these limits can have a shortfall.

These figures are fractions that depend on the sub-trajectories, and are unknown without sub-trajectories.
"""


# ---- numbers and texts


def percent_of(share: Figure) -> str:
    """Return the value of a row, which is a fraction, in per cent."""
    return f"{100.0 * (share.value or 0.0):.4g}"


def statistic_of(limit: Limit) -> str:
    """Return the limited statistic; for a tolerance bound the largest quantile that does not exceed its fraction.

    The quantiles are fixed in `OF_BOUNDS`, so that a new quantile in the table of figures does not change verdicts.
    """
    if limit.prob is None:
        return limit.limited.statistic
    within = [name for name in OF_BOUNDS if QUANTILES[name] <= 100.0 * limit.prob]
    return within[-1]


def why_unknown(scope: RowPart, row: Figure | None) -> str:
    """Return why the judged fraction of a scope is unknown."""
    if row is None and scope.call is not None:
        return NO_CALL[scope.place].format(part=calls_part("", scope.call).words)
    if row is not None and scope.place is Place.TARGET:
        return NO_STAMP.format(part=calls_part("", scope.call, scope.place).words)
    if row is not None and row.n == 0:
        return NO_MESSAGE if scope.what == Scope.LIVE else NOT_DUE.format(part=scope.words)
    return UNKNOWN_NUMBER.format(part=scope.words)


def missing_text(score: Score) -> str:
    """Return the text of the fraction of a drive that has an estimate, and of the longest gap."""
    drive = score.association
    has_images = drive is None or drive.images is not None
    items = "images" if has_images else "true poses"
    row = score.figure("missing", part=None)
    missing = 0.0 if row is None or row.value is None else row.value
    if row is not None and row.n == 0:
        return f"no {items} were received"
    if drive is None and row is not None and missing == 1.0:
        return f"no pose for any of {row.n} {items}"
    text = f"the estimate covers {100.0 * (1.0 - missing):.4g} % of the {items}"
    longest_m = score.number("longest_gap", part=DISTANCE)
    longest_s = score.number("longest_gap", part=TIME)
    if longest_m is not None and longest_s is not None:
        text += f", and its longest gap is {longest_m:.4g} m and {longest_s:.4g} s"
    if not has_images:
        text += "; if the truth is longer or denser than the images, score against the source with its images"
    return text
