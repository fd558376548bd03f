"""Errors at the frames at which no judged sub-trajectory starts or ends. They must not far exceed the judged errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.metrics.completeness.expected_items import share_of
from sfr_loc_map.metrics.completeness.shortfall_kinds import BEYOND, BEYOND_MOST
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND, FigureKind
from sfr_loc_map.metrics.figures.row_part import OTHER_FRAMES
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.placement import PlacedFrames
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.trajectory.trajectory_errors import all_error_figures, error_figures, error_row, errors_of

LEAST_ERROR = 1e-9  #: Errors up to this size, in the unit of the figure, are attributed to rounding.
NAMED_FRAMES = 5  #: Maximum number of ranges of frames that a message names.


def rows_of_other_frames(
    condition: str, judged: SubTrajectories, others: SubTrajectories, placed: PlacedFrames
) -> Iterator[Figure]:
    """Yield the errors at the other frames, and the fraction of frames whose error far exceeds the judged errors.

    There are no rows without a judged sub-trajectory. `others` are those of `to_other_frames`.
    """
    if not len(judged.starts):
        return
    frames = len(placed.frames.stamps_ns)
    for kind in error_figures(has_height=placed.truth.has_height):
        yield error_row(kind, condition, OTHER_FRAMES, others)
        beyond = int(np.count_nonzero(beyond_the_judged(kind, others, judged)))
        yield figure_row(ERRORS_BEYOND, condition, kind.name, n=frames, value=share_of(beyond, frames))


def to_other_frames(judged: SubTrajectories, placed: PlacedFrames) -> SubTrajectories:
    """Return sub-trajectories that end at the other frames, each from the nearest frame of a judged sub-trajectory.

    The start is a frame at which a judged sub-trajectory starts or ends, because an error that neighbouring frames
    share would cancel between them. The result is empty without a judged sub-trajectory.
    """
    if not len(judged.starts):
        return judged
    known = np.union1d(judged.starts, judged.ends)
    ends = np.setdiff1d(np.arange(len(placed.frames.stamps_ns)), known)
    after = np.minimum(np.searchsorted(known, ends), len(known) - 1)
    before = np.maximum(after - 1, 0)
    is_after_nearer = np.abs(known[after] - ends) < np.abs(ends - known[before])
    starts = np.where(is_after_nearer, known[after], known[before])
    return placed.sub_trajectories(starts, ends)


def beyond_the_judged(kind: FigureKind, others: SubTrajectories, judged: SubTrajectories) -> Mask:
    """Return which sub-trajectories have a known error above `BEYOND` times the largest usual judged error.

    Errors of at most `LEAST_ERROR` are ignored.
    """
    least = max(BEYOND * largest_usual(error_sizes(kind, judged)), LEAST_ERROR)
    return np.asarray(error_sizes(kind, others) > least)


def largest_usual(sizes: FloatArray) -> float:
    """Return the error that at most the fraction `BEYOND_MOST` of the judged errors exceeds; 0 without a known error.

    The largest error could be a single outlier, which no other error would far exceed.
    """
    known = sizes[np.isfinite(sizes)]
    return float(np.quantile(known, 1.0 - BEYOND_MOST, method="higher")) if len(known) else 0.0


def error_sizes(kind: FigureKind, sub_trajectories: SubTrajectories) -> FloatArray:
    """Return the sizes of the errors of a figure: norms of vectors, or absolute values."""
    errors = errors_of(kind, sub_trajectories)
    return np.asarray(np.linalg.norm(np.atleast_2d(errors.T), axis=0))


def unjudged_frames(
    condition: str, judged: SubTrajectories, others: SubTrajectories, frames: int, rows: Sequence[Figure]
) -> Iterator[str]:
    """Yield a warning that names the other frames with a far larger error, if their fraction exceeds `BEYOND_MOST`."""
    many = {row.part for row in rows if row.figure == ERRORS_BEYOND and (row.value or 0.0) > BEYOND_MOST}
    kinds = [kind for kind in all_error_figures() if kind.name in many]
    if not kinds:
        return
    found = others.ends[np.logical_or.reduce([beyond_the_judged(kind, others, judged) for kind in kinds])]
    breaks = np.flatnonzero(np.diff(found) > 1) + 1
    parts = [f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in np.split(found, breaks)]
    more = " ..." if len(parts) > NAMED_FRAMES else ""
    yield (
        f"{len(found)} of {frames} frames are neither the start nor the end of a judged "
        f"sub-trajectory over {label_of(condition)}, and their errors are far above the judged errors: frames "
        f"{', '.join(parts[:NAMED_FRAMES])}{more}, counted from 0"
    )
