"""What makes a score incomplete: expected data that are missing or cannot be judged, and data that are wrong.

`incompleteness` finds the shortfalls of a score by the tables of `metrics.shortfall_kinds`, which state for each kind
what is expected and when the score is incomplete. Every shortfall passes the same two filters: the rules of the score
may accept it, and an evident shortfall is dropped if another one states the same results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.inputs import Task
from sfr_loc_map.metrics.catalogue import ERRORS_BEYOND, KINDS, STANDING, Subject, statistic_title, title_of
from sfr_loc_map.metrics.config import CallKind, VerdictState, label_of
from sfr_loc_map.metrics.drive_completeness import DISTANCE, TIME, LongestGap, covered_text
from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.metrics.judging.limit_scope import judged_parts, limits_of
from sfr_loc_map.metrics.limits import Limit, LimitSection, Rules, margin_of, meets
from sfr_loc_map.metrics.row_part import MOVING, OTHER_FRAMES, SUB_TRAJECTORIES, Place, RowPart, Scope
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.shortfall_kinds import (
    ANSWERS,
    EVIDENT,
    JUDGED,
    SHORTFALLS,
    TEXTS,
    TEXTS_IF_UNKNOWN,
    UNKNOWN_ITEMS,
    UNKNOWN_MEMORY,
    Rule,
    ShortfallKind,
)
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.metrics.verdict import Verdict

NOT_DUE = "no result of the {part} is due yet"
UNKNOWN = "the expected items of the {part} are unknown: score against the source"
NO_CALL = "no {part} call was measured: give the calls of the run (option stats)"
NO_MEMORY = "the memory of {percent} % of the {part} calls was not measured"
NO_STATE = "it is unknown which poses are {figure}: give the calls of the run (option stats)"
NO_STAMP = "the {part} calls have no stamps, so their pairs are unknown"
OF_BOUNDS = ("p50", "p95", "p99")
"""Quantiles that a tolerance bound is compared with, in ascending order; the fraction of a bound is at least 50 %."""
SCOPE_OF = {Task.LOCALISATION: Scope.DRIVE, Task.MAPPING: Scope.MAP}  #: Scope of the results of a task.
KIND_OF = {kind.figure: kind for kind in SHORTFALLS}
STATES = RowPart("states")  #: Part of the shortfalls for unknown states of poses, which affect no other limit.


class Shortfall(NamedTuple):
    """A shortfall of a score."""

    kind: ShortfallKind
    part: RowPart  #: The incomplete scope, with the kind and the place of calls, as the part of the row `judged`.
    most: float  #: Largest value of the figure for which the part is complete.
    value: float | None  #: Value of the figure; None if it is unknown.
    text: str  #: What is missing or wrong.
    row: int | None = None  #: Index of the row of the figure in the table.

    @property
    def verdict(self) -> Verdict | None:
        """The verdict that states the shortfall; None if it is evident and counts without limits, too."""
        if self.kind.rule is Rule.EVIDENT:
            return None
        name = self.kind.limit_name
        return Verdict(
            name=name,
            row=self.row,
            subject=Subject.COMPLETENESS,
            part=self.part.text if self.kind.figure == JUDGED else None,
            figure=self.kind.figure,
            statistic="value",
            limit=self.most,
            value=self.value,
            margin=None if self.value is None else margin_of(name, self.most, self.value),
            state=VerdictState.INCOMPLETE,
        )


def incompleteness(score: Score) -> list[Shortfall]:
    """Return what makes a score incomplete by its rules. Without limits only evident shortfalls count."""
    rules = score.rules or Rules()
    found: list[Shortfall] = []
    for item in (*_of_limits(score, rules), *evident_shortfalls(score)):
        if not is_accepted(item.kind, score, rules) and not _is_stated(item, found):
            found.append(item)
    return found


def text_of(missing: Iterable[Shortfall]) -> str | None:
    """Return what is missing, each text once; None if nothing is missing."""
    return "; ".join(dict.fromkeys(item.text for item in missing)) or None


def is_lifted_by_partial(score: Score) -> bool:
    """Return whether partial judging (`--partial`) accepts an incomplete score."""
    return not incompleteness(struct_replace(score, rules=Rules.of(limits_of(score), partial=True)))


# ---- the two filters


def is_accepted(kind: ShortfallKind, score: Score, rules: Rules) -> bool:
    """Return whether the rules of a score accept a shortfall: by partial judging, or by a limit."""
    if rules.partial and kind.is_lifted_by_partial:
        return True
    names = {limit.name for limit in rules.limits}
    has_images = score.association is None or bool(score.association.images)
    if kind.figure == "images_without_truth" and not has_images and KIND_OF["unmatched"].limit_name in names:
        return True  # these images are the estimates without truth
    return any(map(kind.is_accepted_by, names))


def _is_stated(item: Shortfall, found: Iterable[Shortfall]) -> bool:
    """Return whether another shortfall states what is evident: by the same figure, or by unknown expected items."""
    if item.kind.rule is not Rule.EVIDENT:
        return False
    return any(other.part == item.part and other.kind.figure in (item.kind.figure, JUDGED) for other in found)


# ---- shortfalls of scopes and limits


def _of_limits(score: Score, rules: Rules) -> Iterator[Shortfall]:
    """Yield the shortfalls of the scopes that limits judge, then those that depend on a limit."""
    if not rules.limits:
        return
    for part in judged_parts(rules, score):
        yield from _of_scope(score, part)
        yield from _answered_twice(score, part)
    for find in (_beyond_the_judged, _met_by_standing, _unknown_state):
        for limit in rules.limits:
            yield from find(score, limit, rules)


def _of_scope(score: Score, part: RowPart) -> Iterator[Shortfall]:
    """Yield the shortfalls with the rule `JUDGED` of one scope."""
    row = score.figure(JUDGED, subject=Subject.COMPLETENESS, part=part)
    calls = part.of_calls.text
    if row is None or row.value is None:
        yield Shortfall(UNKNOWN_ITEMS, part, 1.0, None, why_unknown(part, row), score.index_of(row))
        return
    if part.what == Scope.MEMORY:
        if row.value < 1.0:
            text = NO_MEMORY.format(percent=f"{100.0 * (1.0 - row.value):.4g}", part=part.call)
            yield Shortfall(UNKNOWN_MEMORY, part, 1.0, row.value, text, score.index_of(row))
        return
    for kind in SHORTFALLS:
        if kind.scope != part.what or kind.rule is not Rule.JUDGED:
            continue
        found = score.figure(kind.figure, subject=Subject.COMPLETENESS, part=calls)
        value = None if found is None else found.value
        if found is not None and value is None and kind.figure in TEXTS_IF_UNKNOWN:
            yield Shortfall(kind, part, kind.most, None, TEXTS_IF_UNKNOWN[kind.figure], score.index_of(found))
        if value is not None and value > kind.most:
            template = missing_text(score) if kind.figure == "missing" else TEXTS[kind.figure]
            text = template.format(percent=f"{100.0 * value:.4g}", value=f"{value:g}", part=calls)
            yield Shortfall(kind, part, kind.most, value, text, score.index_of(found))


def _answered_twice(score: Score, part: RowPart) -> Iterator[Shortfall]:
    """Yield a shortfall of the results of an external node if pairs have several answers, of which the first is judged.

    The other answers are in no other figure of these results.
    """
    node = score.external
    if node is None or part.what != SCOPE_OF[Task(node.task)] or not node.answers.doubled:
        return
    kind, row = KIND_OF["calls_doubled"], score.figure("calls_doubled", part=node.task)
    text = f"{node.answers.doubled} answers belong to pairs that were answered before"
    yield Shortfall(kind, part, kind.most, None if row is None else row.value, text, score.index_of(row))


def _beyond_the_judged(score: Score, limit: Limit, rules: Rules) -> Iterator[Shortfall]:
    """Yield a shortfall if the errors at the other frames miss a limit.

    A fraction of the frames above `most` must also have an error far above the largest judged error, because the figure
    always depends somewhat on the choice of the starts.
    """
    if limit.section is not LimitSection.TRAJECTORY:
        return
    kind = KIND_OF[ERRORS_BEYOND]
    limited = limit.limited
    share = score.figure(ERRORS_BEYOND, condition=limit.condition, part=limited.figure)
    others = score.figure(limited.figure, condition=limit.condition, part=OTHER_FRAMES)
    if share is None or share.value is None or share.value <= kind.most or others is None:
        return
    value = others.statistic(statistic_of(limit))
    if value is not None and not meets(limit, value):
        text = beyond_text(score, limit, share.value, value)
        yield Shortfall(kind, RowPart(Scope.DRIVE), kind.most, share.value, text, score.index_of(share))


def _met_by_standing(score: Score, limit: Limit, rules: Rules) -> Iterator[Shortfall]:
    """Yield a shortfall if a limit is met because the rover is stationary in most sub-trajectories.

    The errors of the other sub-trajectories miss the limit, or are too few for a verdict. A drive in which the rover is
    stationary throughout is judged like any other.
    """
    kind = KIND_OF[STANDING]
    figure, condition = limit.limited.figure, limit.condition
    share = score.figure(STANDING, condition=condition, part=SUB_TRAJECTORIES) if condition is not None else None
    moving = score.figure(figure, condition=condition, part=MOVING)
    if share is None or moving is None or (share.value or 0.0) <= kind.most:
        return
    value, independent = moving.statistic(statistic_of(limit)), moving.independent or 0.0
    if value is None or independent < rules.minimum_independent or not meets(limit, value):
        text = standing_text(limit, share, moving, value)
        yield Shortfall(kind, RowPart(Scope.DRIVE), kind.most, share.value, text, score.index_of(share))


def _unknown_state(score: Score, limit: Limit, rules: Rules) -> Iterator[Shortfall]:
    """Yield a shortfall if a limit is on a state of poses, but the state of a pose is unknown."""
    kind = KIND_OF.get(limit.limited.figure)
    if kind is None or kind.rule is not Rule.STATED:
        return
    row = score.figure(kind.figure, part=None)
    if row is not None and row.n and row.value is None:
        yield Shortfall(kind, STATES, limit.limit, None, NO_STATE.format(figure=kind.figure))


# ---- evident shortfalls, which also count without limits


def evident_shortfalls(score: Score) -> Iterator[Shortfall]:
    """Yield the shortfalls that the records of a score show, whatever its rules are."""
    for kind in EVIDENT:
        text = EVIDENT_TEXTS[kind.figure](score)
        if text is not None and kind.scope is not None:
            yield Shortfall(kind, RowPart(kind.scope), kind.most, None, text)


def _evident_gap(score: Score) -> str | None:
    """Return which part of a drive evidently has no estimate."""
    drive = score.association
    if drive is not None:
        return drive.incomplete
    return missing_text(score) if score.number("missing", part=None) else None


def _unmapped_pairs(score: Score) -> str | None:
    """Return how many pairs a map contains, if the source has more pairs than the ground truth of the map."""
    row, bare = score.figure(JUDGED, part=Scope.MAP), score.number("pairs_without_cloud", part="count")
    if row is None or not row.n or not bare or row.n <= (score.number("pairs") or 0.0):
        return None
    return f"the map contains {row.n - bare:.0f} of {row.n} pairs"


def _unanswered_pairs(score: Score) -> str | None:
    """Return how many pairs an external localiser has not answered."""
    node = score.external
    if node is None or node.task != CallKind.LOCALISATION or not node.answers.missing:
        return None
    return f"{node.answers.missing} of {node.answers.pairs} pairs have no answer"


EVIDENT_TEXTS: dict[str, Callable[[Score], str | None]] = {
    "missing": _evident_gap,
    "pairs_without_cloud": _unmapped_pairs,
    ANSWERS: _unanswered_pairs,
}
"""What is missing by each kind of evident shortfall; None if nothing is."""


# ---- texts


def standing_text(limit: Limit, share: Figure, moving: Figure, value: float | None) -> str:
    """Return the text about the sub-trajectories with a stationary rover, and about the errors of the moving rover."""
    figure, over = limit.limited.figure, label_of(limit.condition or "")
    number = "unknown" if value is None else f"{value:.4g} {KINDS[figure].unit}"
    return (
        f"the rover is stationary in {100.0 * (share.value or 0.0):.4g} % of the sub-trajectories over {over}; of the "
        f"sub-trajectories in which it moves, {moving.independent or 0.0:.3g} are independent, and "
        f"{statistic_title(statistic_of(limit))} of their {title_of(figure)} is {number}"
    )


def statistic_of(limit: Limit) -> str:
    """Return the limited statistic; for a tolerance bound the largest quantile that does not exceed its fraction.

    The quantiles are fixed in `OF_BOUNDS`, so that a new quantile in the table of figures does not change verdicts.
    """
    if limit.prob is None:
        return limit.limited.statistic
    within = [name for name in OF_BOUNDS if QUANTILES[name] <= 100.0 * limit.prob]
    return within[-1]


def beyond_text(score: Score, limit: Limit, share: float, value: float) -> str:
    """Return the text about the frames whose errors far exceed the judged errors, and about these errors."""
    limited = limit.limited
    spacing = 1 if score.association is None else score.association.spacing_frames
    unit = KINDS[limited.figure].unit
    return (
        f"{100.0 * share:.4g} % of the frames are neither the start nor the end of a judged sub-trajectory, because "
        f"starts are {spacing} frames apart, and have errors far above the judged errors: "
        f"{statistic_title(statistic_of(limit))} of the {title_of(limited.figure)} over "
        f"{label_of(limit.condition or '')} is {value:.4g} {unit} for these frames"
    )


def why_unknown(part: RowPart, row: Figure | None) -> str:
    """Return why the judged fraction of a part is unknown."""
    if row is None and part.call is not None:
        return NO_CALL.format(part=part.of_calls.text)
    if row is not None and part.place is Place.TARGET:
        return NO_STAMP.format(part=part.of_calls.text)
    text = NOT_DUE if row is not None and row.n == 0 else UNKNOWN
    return text.format(part=part.text)


def missing_text(score: Score) -> str:
    """Return the text of the fraction of a drive that has an estimate, and of the longest gap."""
    drive, value = score.association, score.number("missing", part=None) or 0.0
    what = "images" if drive is None or drive.images else "true poses"
    if value == 1.0 and drive is None:
        return f"no pose for any of {score.number('missing', 'n', part=None):.0f} {what}"
    longest_m, longest_s = (score.number("longest_gap", part=part) for part in (DISTANCE, TIME))
    longest = None if longest_m is None or longest_s is None else LongestGap(longest_m, longest_s)
    return covered_text(1.0 - value, what, longest)
