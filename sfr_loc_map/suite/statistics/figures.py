"""The figures of a drive by which suites are compared with each other."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.catalogue import KINDS, TOTAL, Subject, statistic_title
from sfr_loc_map.metrics.config import CallKind, label_of
from sfr_loc_map.metrics.score import Score

LEAST_SHARE = 1e-4  #: Shares are compared in logarithms: that of a map that is covered as a whole.


class FigureKind(StrEnum):
    """What a figure is about."""

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
    """A figure, smaller is better: what it is about, and its name with unit, such as `position over 5 m, m`."""

    kind: FigureKind
    name: str


def figures_of(score: Score) -> dict[FigureName, float]:
    """Return the figures of a score that are defined; those but counts are positive."""
    found: dict[FigureName, float | None] = {}
    errors = [kind for kind in KINDS.values() if kind.subject is Subject.TRAJECTORY]
    for condition in score.conditions:
        over = label_of(condition)
        for kind in errors:
            for statistic in kind.compared:
                title = kind.name if statistic == TOTAL else f"{kind.name} {statistic_title(statistic)}"
                name = FigureName(FigureKind.ACCURACY, f"{title} over {over}, {kind.unit}")
                found[name] = score.number(kind.name, statistic, condition=condition)
        nees = score.figure("nees", condition=condition, part="pose")
        expected = FigureName(FigureKind.NEES, f"NEES over {over}, over that expected")
        found[expected] = None if nees is None or nees.mean is None or not nees.value else nees.mean / nees.value
    point_error = score.number("point_error", "mean_plus_3sigma", part=None)
    found[FigureName(FigureKind.ACCURACY, "map point error, m")] = point_error
    coverage = score.number("coverage", part=None)
    uncovered = None if coverage is None else max(1.0 - coverage, LEAST_SHARE)
    found[FigureName(FigureKind.ACCURACY, "map not covered, share")] = uncovered
    for call in (CallKind.LOCALISATION, CallKind.MAPPING_CALL, CallKind.MAPPING):
        found[FigureName(FigureKind.TIME, f"{call} mean, s")] = score.number(call, "mean", part=None)
        found[FigureName(FigureKind.MEMORY, f"{call} peak, bytes")] = score.number("peak", part=call)
    defined = {name: value for name, value in found.items() if value is not None and value > 0.0}
    if (drive := score.association) is not None:
        defined[FigureName(FigureKind.LOST, "lost, frames")] = drive.lost
        defined[FigureName(FigureKind.DEGRADED, "degraded, frames")] = drive.degraded
        missing = score.number("missing", part="count")
        if missing is not None:
            defined[FigureName(FigureKind.MISSING, "missing, frames")] = missing
    return defined
