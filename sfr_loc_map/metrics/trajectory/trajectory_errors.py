"""The sub-trajectories of a condition and the rows of their errors [4.1, 4.2.3]. The formulas are in `formulas`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics import formulas, other_formulas
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.metrics.figures.catalogue import KINDS, FigureKind
from sfr_loc_map.metrics.figures.row_part import distance_part
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.formulas import Lengths
from sfr_loc_map.metrics.frames.association import StampedPoses
from sfr_loc_map.metrics.frames.placement import PlacedFrames
from sfr_loc_map.metrics.statistics.intervals import interval95
from sfr_loc_map.metrics.statistics.tolerance import THREE_SIGMA, Sample, confidence_of, moments
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories

DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Path lengths for the error as a function of the distance travelled."""
DISTANCES_SPACING, DISTANCES_BASE_M = 10, 50.0
"""Minimum number of frames between the starts of these sub-trajectories, and the length, m, beyond which this number is
proportional to the length, because overlapping sub-trajectories add little information."""
DISTANCES_MAX_STARTS = 5000  #: Sub-trajectories with more starts within them are ignored: the rover was stationary.
FRACTIONS = (THREE_SIGMA, 0.95)  #: Fractions of the errors for which the confidence of mean + 3 sigma is stated.


def all_error_figures() -> list[FigureKind]:
    """Return all figures of sub-trajectories; those of a ground truth without heights are the last."""
    kinds = (kind for kind in KINDS.values() if kind.compute_errors is not None)
    return sorted(kinds, key=lambda kind: kind.is_without_height)


def error_figures(*, has_height: bool) -> list[FigureKind]:
    """Return the figures of sub-trajectories for a ground truth with or without heights."""
    return [kind for kind in all_error_figures() if not (has_height and kind.is_without_height)]


def errors_of(kind: FigureKind, sub_trajectories: SubTrajectories) -> FloatArray:
    """Return the errors of a figure of sub-trajectories."""
    assert kind.compute_errors is not None  # true of all `all_error_figures`
    return kind.compute_errors(sub_trajectories)


# ---- selection


def select(condition: Condition, spacing: int, path: StampedPoses, length_m: Lengths) -> tuple[IntArray, IntArray]:
    """Return the frames N and N+x of the sub-trajectories of a condition over a path [4.1.1].

    N+x is the first frame at which all parts of the condition hold. A start whose condition is never met is skipped.
    """
    count = len(path.stamps_ns)
    starts = formulas.start_frames(count, spacing)
    ends = np.minimum(starts + 1, count)
    metres = turn_deg = 0.0
    for each in condition.components:
        if each.kind is ConditionKind.DISTANCE:
            ends = np.maximum(ends, formulas.ends_by_distance(starts, length_m, each.value))
        elif each.kind is ConditionKind.TIME:
            time_ns = round(each.value * NS_PER_S)
            ends = np.maximum(ends, formulas.ends_by_time(starts, path.stamps_ns, time_ns))
        elif each.kind is ConditionKind.FRAMES:
            ends = np.maximum(ends, formulas.ends_by_frames(starts, int(each.value)))
        elif each.kind is ConditionKind.DISPLACEMENT:
            metres = each.value
        else:
            turn_deg = each.value
    if metres or turn_deg:
        ends = other_formulas.ends_apart(starts, ends, path.position, path.attitude, metres, turn_deg)
    is_met = ends < count
    return starts[is_met], ends[is_met]


def overlap_of(starts: IntArray, ends: IntArray, spacing: int) -> float:
    """Return the mean number of starts within one sub-trajectory."""
    return int(np.sum(-(-(ends - starts) // spacing))) / max(len(starts), 1)


# ---- rows


def error_row(
    kind: FigureKind, condition: str | None, part: str, sub_trajectories: SubTrajectories, overlap: float = 0.0
) -> Figure:
    """Return the row of a figure, with its 95 % interval if the overlap of the sub-trajectories is given."""
    errors = errors_of(kind, sub_trajectories)
    statistics = formulas.statistics(errors)
    if not overlap:
        return figure_row(kind.name, condition, part, statistics=statistics)
    low95, high95 = interval95(errors, overlap, unsigned=kind.is_unsigned) or (None, None)
    independent = len(errors) / overlap
    return figure_row(
        kind.name, condition, part, statistics=statistics, independent=independent, low95=low95, high95=high95
    )


def error_rows(
    condition: str, sub_trajectories: SubTrajectories, overlap: float, placed: PlacedFrames
) -> Iterator[Figure]:
    """Yield the errors of one condition by the judged reading, by direction, and by the other readings."""
    kinds = error_figures(has_height=placed.truth.has_height)
    judged, *others = placed.readings
    for kind in kinds:
        yield error_row(kind, condition, judged, sub_trajectories, overlap)
    for direction, values in sub_trajectories.by_direction().items():
        yield figure_row("position", condition, direction, statistics=formulas.statistics(values))
    for reading in others:
        by_reading = placed.sub_trajectories(sub_trajectories.starts, sub_trajectories.ends, reading)
        for kind in kinds:
            if not kind.is_of_all_readings:
                yield error_row(kind, condition, reading, by_reading)


def largest_fraction(rows: Sequence[Figure], figure: str) -> Figure | None:
    """Return the row of the largest fraction of a figure over the conditions; None if no fraction is known."""
    fractions = [row for row in rows if row.figure == figure and row.value is not None]
    if not fractions:
        return None
    largest = max(fractions, key=lambda row: row.value or 0.0)
    return figure_row(figure, n=largest.n, value=largest.value)


def growth_rows(placed: PlacedFrames, spacing: int) -> Iterator[Figure]:
    """Yield the rows of the error as a function of the length of the sub-trajectory."""
    length_m = placed.length_m
    count = len(length_m)
    for metres in DISTANCES_M:
        apart = max(spacing, round(DISTANCES_SPACING * max(metres / DISTANCES_BASE_M, 1.0)))
        starts = formulas.start_frames(count, apart)
        ends = formulas.ends_by_distance(starts, length_m, metres)
        is_short = (ends < count) & (ends - starts <= DISTANCES_MAX_STARTS * apart)
        if not is_short.any():
            continue
        sub_trajectories = placed.sub_trajectories(starts[is_short], ends[is_short])
        for kind in error_figures(has_height=placed.truth.has_height):
            if not kind.is_of_all_readings:
                yield error_row(kind, None, distance_part(metres), sub_trajectories)


def confidence_rows(condition: str, errors: FloatArray, overlap: float) -> Iterator[Figure]:
    """Yield the confidence of mean + 3 sigma of position errors, and the shape and normality of their distribution."""
    sample = Sample(errors, len(errors) / max(overlap, 1.0))
    known = moments(sample)
    counts: dict[str, Any] = {"n": len(errors), "independent": sample.independent}
    for prob in FRACTIONS:
        value = None if known is None else confidence_of(3.0, sample.independent, known.shape, prob)
        yield figure_row("confidence", condition, f"{100.0 * prob:g} % of position errors", value=value, **counts)
    shape = () if known is None else known.shape
    for axis, name in enumerate(("second", "third"), 1):
        ratio = shape[axis] / shape[0] if len(shape) > axis and shape[0] > 0.0 else None
        yield figure_row("shape", condition, f"{name} principal axis", value=ratio, **counts)
    yield figure_row("normality", condition, value=None if known is None else known.significance, **counts)
