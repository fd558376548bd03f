"""The catalogue of figures: one line each, from which every view takes the words for people, and limits their names.

To add a figure, add its line here and, for an error of sub-trajectories, what computes it in
`metrics.trajectory_score.ERRORS`. Reports, comparisons, suites, histories and limits follow.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Subject(StrEnum):
    """What a figure is about."""

    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    COMPLETENESS = "completeness"
    CONSISTENCY = "consistency"


class FigureKind(NamedTuple):
    """A figure of the catalogue."""

    name: str  #: As in the rows of the score.
    subject: Subject
    clause: str  #: Of the specification; empty for a figure that the specification does not define.
    unit: str  #: `m`, `deg`, `px`, `s`, `bytes`, or `1` for counts and fractions.
    title: str  #: Its name for people.
    is_headline: bool = False  #: Whether it stands in the first table of every view.
    is_compared: bool = False  #: Whether two runs are compared by its mean + 3 sigma: smaller is better.


T, M, S, B, C, N = Subject
CATALOGUE = (
    FigureKind("position", T, "4.2.3.1", "m", "position error", is_headline=True, is_compared=True),
    FigureKind("attitude", T, "4.2.3.2", "deg", "attitude error", is_headline=True, is_compared=True),
    FigureKind("heading", T, "4.2.3.3", "deg", "heading error", is_headline=True, is_compared=True),
    FigureKind("chord", T, "", "m", "chord error"),
    FigureKind("ape", T, "", "m", "absolute pose error (APE)"),
    FigureKind("rpe", T, "", "m", "relative pose error (RPE)"),
    FigureKind("point_error", M, "4.3.4", "m", "point error", is_headline=True, is_compared=True),
    FigureKind("nearest_distance", M, "", "m", "distance to the nearest true point", is_headline=True),
    FigureKind("disparity_error", M, "", "px", "disparity error"),
    FigureKind("coverage", M, "4.3.4", "1", "coverage", is_headline=True),
    FigureKind("points", M, "", "1", "points of the cloud"),
    FigureKind("pairs", M, "", "1", "mapping pairs of the ground truth"),
    FigureKind("localisation", S, "4.2.1", "s", "localisation time", is_headline=True),
    FigureKind("mapping_call", S, "4.3.1", "s", "mapping call time", is_headline=True),
    FigureKind("mapping", S, "4.3.1", "s", "mapping time"),
    FigureKind("fusion", S, "4.3.1", "s", "fusion time"),
    FigureKind("peak", B, "4.2.2", "bytes", "peak memory", is_headline=True),
    FigureKind("above_idle", B, "4.2.2", "bytes", "peak memory above the idle process"),
    FigureKind("heap_peak", B, "4.2.2", "bytes", "peak of the heap"),
    FigureKind("stack_peak", B, "4.2.2", "bytes", "peak of the stack"),
    FigureKind("judged", C, "4.1.1", "1", "judged fraction"),
    FigureKind("missing", C, "4.1.1", "1", "missing"),
    FigureKind("lost", C, "4.1.1", "1", "lost"),
    FigureKind("degraded", C, "4.1.1", "1", "degraded"),
    FigureKind("unmatched", C, "4.1.1", "1", "estimates without ground truth"),
    FigureKind("doubled", C, "4.1.1", "1", "estimates with a repeated stamp"),
    FigureKind("longest_gap", C, "4.1.1", "m", "longest gap"),
    FigureKind("points_without_truth", C, "4.3.4", "1", "map points without ground truth"),
    FigureKind("pairs_without_cloud", C, "4.3.4", "1", "mapping pairs without points"),
    FigureKind("nees", N, "", "1", "normalised error squared (NEES)"),
    FigureKind("nees_not_usable", N, "", "1", "sub-trajectories whose covariance cannot be tested"),
    FigureKind("nees_from_steps", N, "", "1", "sub-trajectories tested by the covariance of steps"),
)
KINDS: dict[str, FigureKind] = {kind.name: kind for kind in CATALOGUE}
"""The catalogue by the names of the figures, each of which is used once."""


def title_of(figure: str) -> str:
    """Return the name of a figure for people."""
    return KINDS[figure].title if figure in KINDS else figure.replace("_", " ")
