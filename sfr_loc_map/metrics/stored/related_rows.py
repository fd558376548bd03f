"""Check that the rows, records and raw values of a score that belong together are all present and agree.

A limited figure requires its errors or details, and the rows that state whether the score is complete. A row over all
items must agree with the rows of its parts, a fraction with its count, and a row with the record of its poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sfr_loc_map.metrics.completeness.expected_items import answers_completeness
from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS, ShortfallKind
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND, JUDGED, STANDING, Subject
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.row_part import (
    AFTER_FIRST,
    COUNT,
    FIRST,
    MOVING,
    OTHER_FRAMES,
    SUB_TRAJECTORIES,
    Place,
    RowPart,
    Scope,
    is_of_pair,
)
from sfr_loc_map.metrics.figures.rows import Figure, figure_row, number_text
from sfr_loc_map.metrics.score.limits import LimitSection
from sfr_loc_map.metrics.score.score import Score

ROUNDING_M = 1e-9  #: Largest error by rounding of errors that are differences of coordinates.
EXACT = 1e-9  #: Relative tolerance of a number that follows from other rows.
WITHOUT_RESULT: dict[str, tuple[str, Subject]] = {
    Scope.DRIVE: ("missing", Subject.TRAJECTORY),
    Scope.MAP: ("pairs_without_cloud", Subject.MAP),
}
"""The only figure of completeness of a part without estimate or cloud, and the subject that such a part lacks."""


def fault_of_related_rows(score: Score) -> str | None:
    """Return the first required value that is absent, or the first contradiction of rows; None if there is none."""
    return next((problem for check in CHECKS for problem in check(score)), None)


# ---- values that are required


def _required(score: Score) -> Iterator[str]:
    """Yield which details, errors, or rows of other frames and of motion are absent for a limited figure."""
    yield from _required_details(score)
    drive = score.association
    for limit in () if drive is None else score.active_rules.limits:
        figure, condition = limit.limited.figure, limit.condition
        if condition is None:
            continue
        row = score.judged_row(figure, subject=Subject.TRAJECTORY, condition=condition)
        if row is None or not row.n:
            continue
        if score.all_errors(figure, condition) is None:
            yield f"'{row.label}' is limited, but its errors are absent"
        for name, part in _required_beside(score, figure, condition):
            if score.figure(name, condition=condition, part=part) is None:
                yield f"'{row.label}' is limited, but the row '{name} {part}' is absent"


def _required_beside(score: Score, figure: str, condition: str) -> Iterator[tuple[str, str]]:
    """Yield figure and part of the rows of other frames and of motion that a limited figure requires."""
    yield figure, OTHER_FRAMES
    yield ERRORS_BEYOND, figure
    yield STANDING, SUB_TRAJECTORIES
    standing = score.number(STANDING, condition=condition, part=SUB_TRAJECTORIES)
    if 0.0 < (standing or 0.0) < 1.0:
        yield figure, MOVING


def _required_details(score: Score) -> Iterator[str]:
    """Yield the limited figures of the map and of the calls for which the details are missing.

    The report of a run in progress names no inputs and has no details. Details are also absent for the times of a
    target, the answers of an external node, and points without pixels.
    """
    if score.provenance is None or not score.provenance.inputs:
        return
    details = Details() if score.details is None else score.details
    node = None if score.external is None else score.external.task
    for limit in score.active_rules.limits:
        has_pixels = score.cloud is not None and not score.cloud.nearest_only
        if limit.section is LimitSection.MAP and has_pixels and details.map is None:
            yield f"{limit.name} is limited, but the details of the map are absent"
        call = limit.limited.call
        if limit.section not in (LimitSection.TIMING, LimitSection.MEMORY) or call is None or call == node:
            continue
        if score.figure(call, part=None) is not None and call not in details.calls:
            yield f"{limit.name} is limited, but the details of the {call.words} calls are absent"


def _of_judged(score: Score) -> Iterator[str]:
    """Yield a text for absent rows of completeness, and the contradictions between these rows and `judged`."""
    for row in score.rows(JUDGED):
        part = RowPart.of(row.part)
        if row.value is None:
            continue
        kind = part.of_calls.text if part.what in (Scope.CALLS, Scope.MEMORY) else None
        required = _required_shortfalls(score, part)
        for shortfall in required:
            if score.figure(shortfall.figure, part=kind) is None:
                missing_row = " ".join(filter(None, (shortfall.figure, kind)))
                yield f"it has the row '{row.label}', but no row '{missing_row}'"
        absent = [score.number(each.figure, part=kind) or 0.0 for each in required if each.is_of_expected]
        if not absent:
            continue
        # no lower bound for the answers of an external node
        low = 0.0 if part.what == Scope.CALLS and score.external is not None else 1.0 - sum(absent)
        if not low - EXACT <= row.value <= 1.0 - max(absent) + EXACT:
            expected = number_text(1.0 - sum(absent))
            yield f"'{row.label}' is {number_text(row.value)}, but the missing items give {expected}"


def _required_shortfalls(score: Score, part: RowPart) -> list[ShortfallKind]:
    """Return the shortfalls whose rows a part of a score always has."""
    of_part = [kind for kind in SHORTFALLS if kind.scope == part.what and kind.of_node is None]
    only, subject = WITHOUT_RESULT.get(part.what, ("", Subject.COMPLETENESS))
    if not score.has(subject):
        return [kind for kind in of_part if kind.figure == only]
    return [kind for kind in of_part if kind.figure != ERRORS_BEYOND]


# ---- values that follow from others


def _of_answers(score: Score) -> Iterator[str]:
    """Yield the contradictions between the rows about the answers of an external node and its record."""
    for row in () if score.external is None else answers_completeness(score.external):
        stored = score.figure(row.figure, subject=row.subject, part=row.part)
        if stored is None or (stored.n, stored.value) != (row.n, row.value):
            value = "absent" if stored is None else f"{number_text(stored.value)} of {stored.n}"
            yield f"'{row.label}' is {value}, but the answers of the node give {number_text(row.value)} of {row.n}"


def _of_axes(score: Score) -> Iterator[str]:
    """Yield the contradictions between the judged position errors and their components, which a suite pools."""
    for row in score.rows("position", part=score.reading):
        axes = [score.figure("position", condition=row.condition, part=axis) for axis in "xyz"]
        known = [axis for axis in axes if axis is not None]
        if len(known) < len(axes):
            continue
        for statistic in ("mean", "sigma"):
            value = row.statistic(statistic)
            of_axes = [axis.statistic(statistic) for axis in known]
            if value is None or None in of_axes:
                continue
            norm = float(np.linalg.norm(np.array(of_axes, np.float64)))
            if abs(norm - value) > ROUNDING_M + EXACT * max(norm, value):
                yield f"'{statistic}' of '{row.label}' is {value:.9g}, but that of its axes gives {norm:.9g}"


def _of_pairs(score: Score) -> Iterator[str]:
    """Yield the contradictions between the figures of the map points and the rows of the single pairs."""
    for name in ("point_error", "disparity_error"):
        row = score.figure(name, part=None)
        if row is None:
            continue
        parts = [each for each in score.rows(name) if is_of_pair(each.part)]
        pairs = score.number("pairs")
        if pairs is not None and len(parts) != pairs:
            yield f"'{row.label}' has the rows of {len(parts)} pairs, but the ground truth has {pairs:g} pairs"
        yield from _of_parts(row, parts)


def _of_first_calls(score: Score) -> Iterator[str]:
    """Yield the contradictions between the times of all calls and the rows of the first call and of the other calls."""
    node = None if score.external is None else score.external.task
    for kind in CallKind:
        for place in (Place.HOST, Place.TARGET):
            row = score.figure(kind, part=RowPart(place=place))
            first, others = (score.figure(kind, part=RowPart(part, place=place)) for part in (FIRST, AFTER_FIRST))
            if row is None or row.n is None or (place is Place.HOST and kind == node):  # no row of a first answer
                continue
            if first is None or first.value is None or (row.n > 1 and others is None):
                yield f"'{row.label}' has no row of its first call, or no row of the calls after the first"
                continue
            alone = figure_row(kind, n=1, mean=first.value, rmse=first.value, max=first.value)
            yield from _of_parts(row, [alone] if others is None else [alone, others])


def _of_parts(row: Figure, parts: Sequence[Figure]) -> Iterator[str]:
    """Yield the contradictions between the statistics of a row and those of its parts, which contain all its values."""
    known = [part for part in parts if part.n]
    if not known or row.n is None:
        return
    count = sum(part.n or 0 for part in known)
    derived: dict[str, float] = {"n": float(count), "max": max(part.max or 0.0 for part in known)}
    derived["mean"] = sum((part.n or 0) * (part.mean or 0.0) for part in known) / count
    derived["rmse"] = float(np.sqrt(sum((part.n or 0) * (part.rmse or 0.0) ** 2 for part in known) / count))
    for name, value in derived.items():
        stored = row.statistic(name)
        scale = max(value, derived["rmse"]) if name == "mean" else value  # errors of opposite signs cancel in a mean
        if stored is not None and abs(stored - value) > EXACT * abs(scale):
            yield f"'{name}' of '{row.label}' is {stored:.9g}, but its parts give {value:.9g}"


def _of_counts(score: Score) -> Iterator[str]:
    """Yield the contradictions between fractions of completeness and their counts."""
    for name in [kind.figure for kind in SHORTFALLS]:
        share, count = score.figure(name, part=None), score.figure(name, part=COUNT)
        if share is None or count is None or count.value is None or not count.n:
            continue
        if share.value is None:
            yield f"'{name}' is null, but its count is {count.value:.9g} of {count.n}"
        elif abs(share.value * count.n - count.value) > EXACT * count.n:
            yield f"'{name}' is {share.value:.9g} of {count.n}, but its count is {count.value:.9g}"


def _of_standing(score: Score) -> Iterator[str]:
    """Yield the contradictions between the fraction of a stationary rover and the errors of the moving rover."""
    for share in score.rows(STANDING, part=SUB_TRAJECTORIES):
        moving = score.figure("position", condition=share.condition, part=MOVING)
        given = 0 if moving is None else (moving.n or 0) + (moving.unknown or 0)
        total = share.n or 0
        standing = (share.value or 0.0) * total
        if 0.0 < standing < total and abs(standing + given - total) > EXACT * total:
            stated = f"{number_text(share.value)} of {share.n}"
            yield f"'{share.label}' is {stated}, but there are {given} errors of a moving rover"


def _of_association(score: Score) -> Iterator[str]:
    """Yield the contradictions between the counts of poses and those of the association."""
    drive = score.association
    if drive is None:
        return
    for name in ("lost", "degraded"):
        row = score.figure(name, part=COUNT)
        if row is not None and row.value not in (None, getattr(drive, name)):
            yield f"'{name}' is {number_text(row.value)}, but {getattr(drive, name)} frames are {name}"
    doubled = score.figure("doubled", part=COUNT)
    if doubled is not None and doubled.value != drive.estimate_duplicates:
        count = number_text(doubled.value)
        yield f"'doubled' is {count}, but {drive.estimate_duplicates} estimates have a repeated stamp"


CHECKS: tuple[Callable[[Score], Iterator[str]], ...] = (
    _required,
    _of_axes,
    _of_pairs,
    _of_first_calls,
    _of_counts,
    _of_standing,
    _of_association,
    _of_judged,
    _of_answers,
)
"""The checks, in the order in which their contradictions are reported."""
