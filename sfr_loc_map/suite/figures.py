"""The figures of a drive by which suites are compared with each other."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.limits import value_at
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
    for part in () if score.trajectory is None else score.trajectory.conditions:
        for error, unit in (("position", "m"), ("attitude", "deg"), ("heading", "deg")):
            name = FigureName(FigureKind.ACCURACY, f"{error} over {part.condition.label}, {unit}")
            found[name] = getattr(part, f"{error}_{unit}").mean_plus_3sigma
        nees = None if part.nees is None or part.nees.pose.mean is None else part.nees.pose.mean
        expected = FigureName(FigureKind.NEES, f"NEES over {part.condition.label}, over that expected")
        found[expected] = None if nees is None or part.nees is None else nees / part.nees.pose.expected
    point_error = value_at(score, "map.errors.point_error_m.mean_plus_3sigma")
    found[FigureName(FigureKind.ACCURACY, "map point error, m")] = point_error
    coverage = value_at(score, "map.coverage")
    uncovered = None if coverage is None else max(1.0 - coverage, LEAST_SHARE)
    found[FigureName(FigureKind.ACCURACY, "map not covered, share")] = uncovered
    for kind in (CallKind.LOCALISATION, CallKind.MAPPING_CALL, CallKind.MAPPING):
        found[FigureName(FigureKind.TIME, f"{kind} mean, s")] = value_at(score, f"timing.{kind}.mean")
        found[FigureName(FigureKind.MEMORY, f"{kind} peak, bytes")] = value_at(score, f"memory.{kind}.peak_bytes")
    defined = {name: value for name, value in found.items() if value is not None and value > 0.0}
    if (drive := score.trajectory) is not None:
        defined[FigureName(FigureKind.LOST, "lost, frames")] = drive.lost
        defined[FigureName(FigureKind.DEGRADED, "degraded, frames")] = drive.degraded
        if drive.completeness is not None:
            defined[FigureName(FigureKind.MISSING, "missing, frames")] = drive.completeness.missing
    return defined
