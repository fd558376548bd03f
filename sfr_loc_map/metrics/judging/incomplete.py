"""The shortfalls of a score: expected data that are missing or cannot be judged, by part of the score."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.catalogue import (
    CALLS,
    DRIVE,
    ERRORS_BEYOND,
    KINDS,
    MAP,
    MEMORY,
    MOVING,
    OTHER_FRAMES,
    STANDING,
    SUB_TRAJECTORIES,
    Subject,
    statistic_title,
    title_of,
)
from sfr_loc_map.metrics.completeness import DISTANCE, TIME, LongestGap, covered_text
from sfr_loc_map.metrics.config import CallKind, VerdictState, label_of
from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.metrics.judging.limit_scope import judged_parts, limits_of
from sfr_loc_map.metrics.limits import COVERAGE_MIN, Limit, Limits, LimitSection, Rules, margin_of, meets
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.shortfall_kinds import BEYOND_MOST, SHORTFALLS, STANDING_MOST
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.metrics.verdict import Verdict

NOT_DUE = "no result of the {part} is due yet"
UNKNOWN = "the expected items of the {part} are unknown: score against the source"
NO_CALL = "no {part} call was measured: give the calls of the run (option stats)"
NO_STAMP = "the {part} calls have no stamps, so that their pairs are unknown"
NO_STATE = "it is unknown which poses are {figure}: give the calls of the run (option stats)"
OF_BOUNDS = ("p50", "p95", "p99")
"""Quantiles that a tolerance bound is compared with, in ascending order; the fraction of a bound is at least 50 %."""
OF_STATES = [kind.figure for kind in SHORTFALLS if kind.is_of_states]
ANSWERS = "answers"  #: Figure of the answers of an external localiser, which only a limit on `missing` allows to lack.
STATES = RowPart("states")  #: Part of the shortfalls for unknown states of poses.


class Shortfall(NamedTuple):
    """Expected data of a part that are missing or cannot be judged."""

    part: RowPart  #: Part of the row `judged`: `drive`, `map`, `calls localisation`, ...
    figure: str  #: Figure that exceeds `most`; `judged` if the expected items are unknown.
    most: float  #: Largest value of the figure for which the part is complete.
    value: float | None
    text: str
    row: int | None = None  #: Index of the row of the figure in the table.

    @property
    def verdict(self) -> Verdict:
        """The verdict that states the shortfall."""
        is_lower_bound = self.figure == "judged"
        name = "judged_share_min" if is_lower_bound else f"{self.figure}_max_share"
        if KINDS[self.figure].is_count:
            name = f"{self.figure}_max"
        return Verdict(
            name=name,
            row=self.row,
            subject=Subject.COMPLETENESS,
            part=self.part.text if is_lower_bound else None,
            figure=self.figure,
            statistic="value",
            limit=self.most,
            value=self.value,
            margin=None if self.value is None else margin_of(name, self.most, self.value),
            state=VerdictState.INCOMPLETE,
        )


class EvidentGap(NamedTuple):
    """Results of a part that are missing whatever is judged, so that a score is incomplete without limits as well."""

    part: RowPart
    figure: str  #: Figure whose shortfall, or whose limit, accounts for the same results.
    text: str


def shortfalls(score: Score) -> list[Shortfall]:
    """Return the shortfalls of the parts of a score that limits judge, without those that the rules allow."""
    limits = limits_of(score)
    if limits is None:
        return []
    found: list[Shortfall] = []
    allowed = allowed_figures(score, limits)
    for part in judged_parts(limits, score):
        found += _shortfalls_of(score, part, allowed)
    if ERRORS_BEYOND not in allowed:
        found += _beyond_the_judged(score, limits)
    if STANDING not in allowed:
        found += _met_by_standing(score, limits)
    for limit in limits.limits:
        figure = limit.limited.figure
        row = score.figure(figure, part=None) if figure in OF_STATES else None
        if row is not None and row.n and row.value is None:
            found.append(Shortfall(STATES, figure, limit.limit, None, NO_STATE.format(figure=figure)))
    return found


def allowed_figures(score: Score, limits: Limits) -> set[str]:
    """Return the figures of completeness that the limits state, and those that a stated limit covers as well."""
    allowed = {item.limited.figure for item in limits.limits if item.section is LimitSection.COMPLETENESS}
    if any(limit.name == COVERAGE_MIN for limit in limits.limits):
        allowed.add("pixels_without_point")
    if "unmatched" in allowed and score.association is not None and not score.association.images:
        allowed.add("images_without_truth")  # if the images are unknown, these are the estimates without truth
    if "missing" in allowed:
        allowed.add(ANSWERS)
    if "poses_of_truth" in allowed:
        allowed.add("errors_of_truth")
    return allowed


def _shortfalls_of(score: Score, part: RowPart, allowed: Collection[str]) -> Iterator[Shortfall]:
    row = score.figure("judged", subject=Subject.COMPLETENESS, part=part)
    is_partial = score.rules is not None and score.rules.partial
    if row is None or row.value is None:
        if not is_partial:
            yield Shortfall(part, "judged", 1.0, None, why_unknown(part, row), score.place_of(row))
        return
    if part.what == MEMORY:
        if row.value < 1.0 and not is_partial and "calls_missing" not in allowed:
            text = f"the memory of {100.0 * (1.0 - row.value):.4g} % of the {part.call} calls was not measured"
            yield Shortfall(part, "judged", 1.0, row.value, text, score.place_of(row))
        return
    calls = part.of_calls.text if part.what == CALLS else None
    for kind in SHORTFALLS:
        most = kind.most
        if kind.part != part.what or most is None or kind.is_by_limit or kind.figure in allowed:
            continue
        if is_partial and not kind.is_wrong:
            continue
        found = score.figure(kind.figure, subject=Subject.COMPLETENESS, part=calls)
        value = None if found is None else found.value
        if found is not None and value is None and kind.unknown:
            yield Shortfall(part, kind.figure, most, None, kind.unknown, score.place_of(found))
        if value is None or value <= most:
            continue
        text = kind.text.format(percent=f"{100.0 * value:.4g}", value=f"{value:g}", part=calls)
        yield Shortfall(part, kind.figure, most, value, text or missing_text(score), score.place_of(found))


def _beyond_the_judged(score: Score, limits: Limits) -> Iterator[Shortfall]:
    """Yield a shortfall for each limit that the errors at the other frames miss.

    A fraction above `BEYOND_MOST` of the frames must also have an error far above the largest judged error, because
    the figure always depends somewhat on the choice of the starts.
    """
    for limit in limits.limits:
        if limit.section is not LimitSection.TRAJECTORY:
            continue
        limited = limit.limited
        share = score.figure(ERRORS_BEYOND, condition=limit.condition, part=limited.figure)
        others = score.figure(limited.figure, condition=limit.condition, part=OTHER_FRAMES)
        if share is None or share.value is None or share.value <= BEYOND_MOST or others is None:
            continue
        value = others.statistic(statistic_of(limit))
        if value is not None and not meets(limit, value):
            text = beyond_text(score, limit, share.value, value)
            yield Shortfall(RowPart(DRIVE), ERRORS_BEYOND, BEYOND_MOST, share.value, text, score.place_of(share))


def _met_by_standing(score: Score, limits: Limits) -> Iterator[Shortfall]:
    """Yield a shortfall for each limit that is met because the rover is stationary in most sub-trajectories.

    The errors of the other sub-trajectories miss the limit, or are too few for a verdict. A drive in which the rover is
    stationary throughout is judged like any other.
    """
    for limit in limits.limits:
        figure, condition = limit.limited.figure, limit.condition
        share = score.figure(STANDING, condition=condition, part=SUB_TRAJECTORIES) if condition is not None else None
        moving = score.figure(figure, condition=condition, part=MOVING)
        if share is None or moving is None or (share.value or 0.0) <= STANDING_MOST:
            continue
        value, independent = moving.statistic(statistic_of(limit)), moving.independent or 0.0
        if value is None or independent < limits.minimum_independent or not meets(limit, value):
            text = standing_text(limit, share, moving, value)
            yield Shortfall(RowPart(DRIVE), STANDING, STANDING_MOST, share.value, text, score.place_of(share))


def standing_text(limit: Limit, share: Figure, moving: Figure, value: float | None) -> str:
    """Return the text of the fraction of sub-trajectories with a stationary rover, and of the errors of the others."""
    figure, over = limit.limited.figure, label_of(limit.condition or "")
    number = "unknown" if value is None else f"{value:.4g} {KINDS[figure].unit}"
    return (
        f"the rover is stationary in {100.0 * (share.value or 0.0):.4g} % of the sub-trajectories over {over}; of the "
        f"others {moving.independent or 0.0:.3g} are independent, and {statistic_title(statistic_of(limit))} of their "
        f"{title_of(figure)} is {number}"
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
    """Return the text of the fraction of frames with far larger errors than the judged ones, and of these errors."""
    limited = limit.limited
    spacing = 1 if score.association is None else score.association.spacing_frames
    unit = KINDS[limited.figure].unit
    return (
        f"{100.0 * share:.4g} % of the frames are in no judged error, because starts are {spacing} frames apart, and "
        f"have errors far above the judged errors: {statistic_title(statistic_of(limit))} of the "
        f"{title_of(limited.figure)} over {label_of(limit.condition or '')} is {value:.4g} {unit} for the frames "
        f"without a judged error"
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


def evident_gaps(score: Score) -> Iterator[EvidentGap]:
    """Yield the results that are evidently missing, independently of the rules."""
    drive, row, node = score.association, score.figure("judged", part=MAP), score.external
    if drive is not None and drive.incomplete:
        yield EvidentGap(RowPart(DRIVE), "missing", drive.incomplete)
    if drive is None and score.number("missing", part=None):
        yield EvidentGap(RowPart(DRIVE), "missing", missing_text(score))
    bare = score.number("pairs_without_cloud", part="count")
    if row is not None and row.n and bare and row.n > (score.number("pairs") or 0.0):
        text = f"the map contains {row.n - bare:.0f} of {row.n} pairs"
        yield EvidentGap(RowPart(MAP), "pairs_without_cloud", text)
    if node is not None and node.task == CallKind.LOCALISATION and node.answers.missing:
        text = f"{node.answers.missing} of {node.answers.pairs} pairs have no answer"
        yield EvidentGap(RowPart(DRIVE), ANSWERS, text)


def incompleteness(score: Score) -> list[Shortfall | EvidentGap]:
    """Return what makes a score incomplete by its rules: its shortfalls, and the gaps that no shortfall states.

    Without limits there are no shortfalls, and only evident gaps count.
    """
    rules, short = score.rules or Rules(), shortfalls(score)
    if rules.partial:
        return [*short]
    stated = {item.figure for item in short} | allowed_figures(score, rules)
    if any(item.figure == "judged" and item.part == RowPart(DRIVE) for item in short):
        stated.add("missing")
    return [*short, *(gap for gap in evident_gaps(score) if gap.figure not in stated)]


def text_of(missing: Iterable[Shortfall | EvidentGap]) -> str | None:
    """Return what is missing, each text once; None if nothing is missing."""
    return "; ".join(dict.fromkeys(item.text for item in missing)) or None


def is_lifted_by_partial(score: Score) -> bool:
    """Return whether partial judging (`--partial`) accepts an incomplete score."""
    return not incompleteness(struct_replace(score, rules=Rules.of(limits_of(score), partial=True)))
