"""The figures of each drive that suites are compared by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.score import Score
from sfr_loc_map.suite.groups import Drive
from sfr_loc_map.suite.reference_work import REFERENCE


class FigureKind(StrEnum):
    """What a figure is about."""

    ACCURACY = "accuracy"
    TIME = "time"
    MEMORY = "memory"


@dataclass(frozen=True, slots=True, order=True)
class FigureName:
    """A figure; smaller is better for all of them.

    Attributes:
        kind: What it is about.
        name: Name with unit, such as `position over 5 m, m`.
    """

    kind: FigureKind
    name: str


def figures_of(score: Score) -> dict[FigureName, float]:
    """Return the figures of a score that are defined and positive.

    Times count only where nothing else ran on the host; they are multiples of a fixed work measured in the same run.
    """
    return {name: value for name, value in _figures(score) if value is not None and value > 0.0}


def _figures(score: Score) -> Iterator[tuple[FigureName, float | None]]:
    accuracy = FigureKind.ACCURACY
    for part in () if score.trajectory is None else score.trajectory.conditions:
        over = f"over {part.condition.label}"
        yield FigureName(accuracy, f"position {over}, m"), part.position_m.mean_plus_3sigma
        yield FigureName(accuracy, f"attitude {over}, deg"), part.attitude_deg.mean_plus_3sigma
        yield FigureName(accuracy, f"heading {over}, deg"), part.heading_deg.mean_plus_3sigma
    if score.map is not None:
        errors, coverage = score.map.errors, score.map.coverage
        figure = None if errors is None else errors.point_error_m.mean_plus_3sigma
        yield FigureName(accuracy, "map point error, m"), figure
        yield FigureName(accuracy, "map not covered, share"), None if coverage is None else 1.0 - coverage
    yield from _costs(score)


def _costs(score: Score) -> Iterator[tuple[FigureName, float | None]]:
    memory, timing = score.memory, score.timing
    host: Mapping[str, str] = {} if score.provenance is None else score.provenance.host
    reference = float(host.get(REFERENCE, "nan"))
    for kind in ("localisation", "mapping"):
        peaks = None if memory is None else getattr(memory, kind)
        calls = None if timing is None else getattr(timing, kind)
        yield FigureName(FigureKind.MEMORY, f"{kind} peak, bytes"), None if peaks is None else peaks.peak_bytes
        median = None if calls is None else calls.p50
        # NaN, for tasks that were not alone, is not larger than 0 and drops out
        yield (
            FigureName(FigureKind.TIME, f"{kind} p50, of the reference"),
            None if median is None else median / reference,
        )


def by_pairing(drives: tuple[Drive, ...], *, one_configuration: bool) -> dict[tuple[str, str], Drive]:
    """Return drives by what they have in common with those of another suite.

    Args:
        drives: Results of a suite.
        one_configuration: Whether each suite has one configuration, so that its name does not matter.
    """
    return {(drive.pairing, "" if one_configuration else drive.configuration): drive for drive in drives}
