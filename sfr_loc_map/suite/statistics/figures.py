"""The figures of a result that comparisons of suites, histories and the best results of a group use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import CATALOGUE, KINDS, TOTAL, statistic_title
from sfr_loc_map.metrics.figures.row_part import COUNT, POSE
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.score import Score

MAP_ERRORS = [kind for kind in CATALOGUE if kind.subject is Subject.MAP and TOTAL in kind.tested]
"""Map errors whose differences are tested."""
LEAST_ERROR = 1e-6
"""Minimum compared error, in its unit (m, deg or relative), because the logarithms of errors are compared."""
LEAST_SHARE = 1e-4  #: Minimum uncovered fraction of a map, because the logarithms of fractions are compared.


class ComparedKind(StrEnum):
    """Kind of a compared figure."""

    ACCURACY = "accuracy"
    NEES = "nees"
    LOST = "lost"
    DEGRADED = "degraded"
    MISSING = "missing"
    FAILED = "failed"
    TIME = "time"
    MEMORY = "memory"


@dataclass(frozen=True, slots=True)
class ComparedFigure:
    """A compared figure. Figures with the same keys are equal, even if two versions of the program display other names.

    Smaller values are better, except for the normalised errors (NEES), which are best at 1.
    """

    kind: ComparedKind
    name: str = field(compare=False)  #: Displayed name with unit, such as `position over 5 m, m`.
    figure: str  #: Figure of the catalogue.
    statistic: str  #: Column of its row.
    condition: str = ""  #: Condition of its row; empty if it has none.
    part: str = ""  #: Part of its row if the part is not the judged one.


def figures_of(score: Score) -> dict[ComparedFigure, float]:
    """Return the compared figures that a score has: all counts and errors, and the positive values of other figures.

    Other figures must be positive because their logarithms are compared. A time or memory of 0 is unknown.
    """
    found = dict(chain(_trajectory_figures(score), _map_figures(score), _call_figures(score)))
    known = {figure: value for figure, value in found.items() if value is not None and value >= 0.0}
    with_minimum = (ComparedKind.ACCURACY, ComparedKind.NEES)
    raised = {
        figure: max(value, LEAST_ERROR) if figure.kind in with_minimum else value for figure, value in known.items()
    }
    defined = {figure: value for figure, value in raised.items() if value > 0.0}
    counts = {figure: count for figure, count in _counts(score) if count is not None}
    return {**defined, **counts}


def _trajectory_figures(score: Score) -> Iterator[tuple[ComparedFigure, float | None]]:
    """Yield the errors of a trajectory for each condition, and the NEES relative to the expected NEES."""
    errors = [kind for kind in KINDS.values() if kind.subject is Subject.TRAJECTORY]
    for condition in score.conditions:
        over = label_of(condition)
        for kind in errors:
            for statistic in kind.tested:
                name = f"{_compared_title(kind.name, statistic)} over {over}, {kind.unit}"
                figure = ComparedFigure(ComparedKind.ACCURACY, name, kind.name, statistic, condition)
                yield figure, score.number(kind.name, statistic, condition=condition)
        nees = score.figure("nees", condition=condition, part=POSE)
        name = f"NEES over {over}, relative to the expected NEES"
        relative = None if nees is None or nees.mean is None or not nees.expected else nees.mean / nees.expected
        yield ComparedFigure(ComparedKind.NEES, name, "nees", "mean", condition, POSE), relative


def _map_figures(score: Score) -> Iterator[tuple[ComparedFigure, float | None]]:
    """Yield the errors of a map, and the fraction of the truth that the map does not cover."""
    for kind in MAP_ERRORS:
        for statistic in kind.tested:
            name = f"map {_compared_title(kind.title, statistic)}, {kind.unit}"
            figure = ComparedFigure(ComparedKind.ACCURACY, name, kind.name, statistic)
            yield figure, score.number(kind.name, statistic, part=None)
    coverage = score.number("coverage", part=None)
    uncovered = None if coverage is None else max(1.0 - coverage, LEAST_SHARE)
    yield ComparedFigure(ComparedKind.ACCURACY, "map not covered, share", "coverage", "value"), uncovered


def _call_figures(score: Score) -> Iterator[tuple[ComparedFigure, float | None]]:
    """Yield the mean time and the peak memory of each kind of call."""
    for call in (CallKind.LOCALISATION, CallKind.MAPPING_CALL, CallKind.MAPPING):
        time = ComparedFigure(ComparedKind.TIME, f"{call} mean, s", call.value, "mean")
        yield time, score.number(call, "mean", part=None)
        peak = ComparedFigure(ComparedKind.MEMORY, f"{call} peak, bytes", "peak", "value", part=call.value)
        yield peak, score.number("peak", part=call)


def _counts(score: Score) -> Iterator[tuple[ComparedFigure, float | None]]:
    """Yield the numbers of lost, degraded and missing frames of a trajectory."""
    if (drive := score.association) is not None:
        missing = score.number("missing", part=COUNT)
        counts = {ComparedKind.LOST: drive.lost, ComparedKind.DEGRADED: drive.degraded, ComparedKind.MISSING: missing}
        for kind, count in counts.items():
            yield ComparedFigure(kind, f"{kind}, frames", kind.value, "value", part=COUNT), count


def map_error_of(score: Score) -> float | None:
    """Return the map error by which results are ranked; None if it is unknown."""
    errors = (score.number(kind.name, kind.tested[0], part=None) for kind in MAP_ERRORS)
    return next((error for error in errors if error is not None), None)


def _compared_title(title: str, statistic: str) -> str:
    return title if statistic == TOTAL else f"{title} {statistic_title(statistic)}"
