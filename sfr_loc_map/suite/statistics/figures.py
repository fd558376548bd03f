"""The figures of a drive that comparisons of suites use."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.table.catalogue import CATALOGUE, KINDS, TOTAL, Subject, statistic_title

MAP_ERRORS = [kind for kind in CATALOGUE if kind.subject is Subject.MAP and TOTAL in kind.compared]
"""Map errors that are compared."""
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


@dataclass(frozen=True, slots=True, order=True)
class FigureName:
    """A compared figure: its kind, and its name with unit, such as `position over 5 m, m`.

    Smaller values are better, except for the normalised errors (NEES), which are best at 1.
    """

    kind: ComparedKind
    name: str


def figures_of(score: Score) -> dict[FigureName, float]:
    """Return the compared figures that a score has: all counts and errors, and the positive values of other figures.

    Other figures must be positive because their logarithms are compared. A time or memory of 0 is unknown.
    """
    found: dict[FigureName, float | None] = {}
    errors = [kind for kind in KINDS.values() if kind.subject is Subject.TRAJECTORY]
    for condition in score.conditions:
        over = label_of(condition)
        for kind in errors:
            for statistic in kind.compared:
                title = f"{_compared_title(kind.name, statistic)} over {over}, {kind.unit}"
                name = FigureName(ComparedKind.ACCURACY, title)
                found[name] = score.number(kind.name, statistic, condition=condition)
        nees = score.figure("nees", condition=condition, part="pose")
        expected = FigureName(ComparedKind.NEES, f"NEES over {over}, relative to the expected NEES")
        found[expected] = None if nees is None or nees.mean is None or not nees.value else nees.mean / nees.value
    for kind in MAP_ERRORS:
        for statistic in kind.compared:
            name = FigureName(ComparedKind.ACCURACY, f"map {_compared_title(kind.title, statistic)}, {kind.unit}")
            found[name] = score.number(kind.name, statistic, part=None)
    coverage = score.number("coverage", part=None)
    uncovered = None if coverage is None else max(1.0 - coverage, LEAST_SHARE)
    found[FigureName(ComparedKind.ACCURACY, "map not covered, share")] = uncovered
    for call in (CallKind.LOCALISATION, CallKind.MAPPING_CALL, CallKind.MAPPING):
        found[FigureName(ComparedKind.TIME, f"{call} mean, s")] = score.number(call, "mean", part=None)
        found[FigureName(ComparedKind.MEMORY, f"{call} peak, bytes")] = score.number("peak", part=call)
    known = {name: value for name, value in found.items() if value is not None and value >= 0.0}
    with_minimum = (ComparedKind.ACCURACY, ComparedKind.NEES)
    raised = {name: max(value, LEAST_ERROR) if name.kind in with_minimum else value for name, value in known.items()}
    defined = {name: value for name, value in raised.items() if value > 0.0}
    if (drive := score.association) is not None:
        counts = {
            FigureName(ComparedKind.LOST, "lost, frames"): drive.lost,
            FigureName(ComparedKind.DEGRADED, "degraded, frames"): drive.degraded,
            FigureName(ComparedKind.MISSING, "missing, frames"): score.number("missing", part="count"),
        }
        defined |= {name: count for name, count in counts.items() if count is not None}
    return defined


def map_error_of(score: Score) -> float | None:
    """Return the map error by which results are ranked; None if it is unknown."""
    errors = (score.number(kind.name, kind.compared[0], part=None) for kind in MAP_ERRORS)
    return next((error for error in errors if error is not None), None)


def _compared_title(title: str, statistic: str) -> str:
    return title if statistic == TOTAL else f"{title} {statistic_title(statistic)}"
