"""Check that the table of figures follows from the raw values in the same score.

A score contains the errors of sub-trajectories, a sample of the map points, and the times of calls, for plots and for
tolerance bounds. If the score contains all values, the statistics are recomputed. If the score contains every n-th
value, the statistics must be consistent with this sample. A count and its fraction must agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness
from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS, ShortfallKind
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.errors.trajectory_errors import overlap_of
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS, statistics
from sfr_loc_map.metrics.score.limits import LimitSection
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import interval95
from sfr_loc_map.metrics.table.catalogue import ERRORS_BEYOND, JUDGED, KINDS, STANDING, Subject
from sfr_loc_map.metrics.table.details import CallPlots, Details, SubTrajectoryRows
from sfr_loc_map.metrics.table.row_part import (
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
from sfr_loc_map.metrics.table.rows import Figure, figure_row

ROUNDING_M = 1e-9  #: Largest error by rounding of errors that are differences of coordinates.
EXACT = 1e-9  #: Relative tolerance of a recomputed statistic.
RESAMPLED = 1e-6  #: Relative tolerance of a bound of an interval, which is a sum over many resampled series.
DIGITS_M, POINT_DIGITS_M = 1e-8, 5e-5
"""Rounding of the errors of sub-trajectories and of map points in the data of the plots, m."""
SIGMAS = 5.0  #: A quantile contradicts the sample if a sampled fraction deviates by more standard deviations than this.
CORRELATED = 10.0  #: Number of correlated values that are equivalent to one independent value.
WITHOUT_RESULT: dict[str, tuple[str, Subject]] = {
    Scope.DRIVE: ("missing", Subject.TRAJECTORY),
    Scope.MAP: ("pairs_without_cloud", Subject.MAP),
}
"""The only figure of completeness of a part without estimate or cloud, and the subject that such a part lacks."""


def fault_of_raw_values(score: Score) -> str | None:
    """Return the first contradiction between the figures and the raw values of a score; None if there is none."""
    return next((problem for check in CHECKS for problem in check(score)), None)


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
    """Yield that rows of completeness are absent, and the contradictions between these rows and `judged`."""
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
            yield f"'{row.label}' is {_text(row.value)}, but the missing items give {_text(1.0 - sum(absent))}"


def _required_shortfalls(score: Score, part: RowPart) -> list[ShortfallKind]:
    """Return the shortfalls whose rows a part of a score always has."""
    of_part = [kind for kind in SHORTFALLS if kind.scope == part.what and kind.of_node is None]
    only, subject = WITHOUT_RESULT.get(part.what, ("", Subject.COMPLETENESS))
    if not score.has(subject):
        return [kind for kind in of_part if kind.figure == only]
    return [kind for kind in of_part if kind.figure != ERRORS_BEYOND]


def _of_answers(score: Score) -> Iterator[str]:
    """Yield the contradictions between the rows about the answers of an external node and its record."""
    for row in () if score.external is None else answers_completeness(score.external):
        stored = score.figure(row.figure, subject=row.subject, part=row.part)
        if stored is None or (stored.n, stored.value) != (row.n, row.value):
            value = "absent" if stored is None else f"{_text(stored.value)} of {stored.n}"
            yield f"'{row.label}' is {value}, but the answers of the node give {_text(row.value)} of {row.n}"


def _of_sub_trajectories(score: Score) -> Iterator[str]:
    """Yield the contradictions between the judged rows of sub-trajectories and their errors, or the sample of these."""
    details = None if score.details is None else score.details.trajectory
    pieces = () if details is None else details.sub_trajectories
    thinned = {rows.condition: rows for rows in pieces if rows.every > 1}
    complete = {rows.condition: rows for rows in pieces if rows.every == 1}
    exact = {(item.figure, item.condition) for item in score.errors}
    for row in score.figures:
        if row.condition is None or row.part != score.reading:
            continue
        errors = score.all_errors(row.figure, row.condition)
        if errors is not None:
            rounding_m = 0.0 if (row.figure, row.condition) in exact else DIGITS_M
            yield from _computed_again(row, errors, rounding_m)
            yield from _of_independent(row, errors, complete.get(row.condition), score, rounding_m)
        elif (rows := thinned.get(row.condition)) is not None:
            yield from _of_thinned(row, rows)


def _of_axes(score: Score) -> Iterator[str]:
    """Yield the contradictions between the judged position errors and those of their axes, which a suite pools."""
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


def _of_thinned(row: Figure, rows: SubTrajectoryRows) -> Iterator[str]:
    """Yield the contradictions between a row and the data of the plots, which have every n-th of its errors."""
    columns = rows.error_columns(row.figure)
    if not columns or any(None in column for column in columns):
        return
    kept = np.stack([np.array(values, np.float64) for values in columns], axis=1)
    if row.n is not None and not (len(kept) - 1) * rows.every < row.n <= len(kept) * rows.every:
        low, high = (len(kept) - 1) * rows.every + 1, len(kept) * rows.every
        yield (
            f"'n' of '{row.label}' is {row.n}, but the file has {len(kept)} errors, one of {rows.every}: "
            f"{low} to {high} are possible"
        )
    yield from _as_the_sample(row, np.linalg.norm(kept, axis=1), DIGITS_M)


def _computed_again(row: Figure, errors: FloatArray, rounding: float) -> Iterator[str]:
    """Yield the contradictions between the statistics of a row and those of all its errors `(n, d)`.

    A statistic that the row does not have is not compared, so that older scores without the statistic can be read.
    """
    again = statistics(errors if errors.shape[1] > 1 else errors[:, 0])
    for name in ("n", "unknown", *STATISTICS):
        stored, derived = getattr(row, name), getattr(again, name)
        if stored == derived or (stored is None and name in STATISTICS):
            continue
        if stored is None or derived is None or abs(stored - derived) > 4.0 * rounding + EXACT * abs(derived):
            yield f"'{name}' of '{row.label}' is {_text(stored)}, but its errors give {_text(derived)}"


def _of_independent(
    row: Figure, errors: FloatArray, rows: SubTrajectoryRows | None, score: Score, rounding: float
) -> Iterator[str]:
    """Yield the contradictions between the number of independent errors, the 95 % interval and all errors of a row.

    The overlap follows from the frames of all sub-trajectories (`rows`). If they are unknown, the stored number of
    independent errors gives the overlap, and only the interval is compared.
    """
    if rows is not None and score.association is not None and len(rows.start_frame):
        starts, ends = np.array(rows.start_frame), np.array(rows.end_frame)
        overlap = overlap_of(starts, ends, score.association.spacing_frames)
        independent = len(errors) / overlap
        if row.independent is None or abs(row.independent - independent) > EXACT * independent:
            given = _text(row.independent)
            yield f"'independent' of '{row.label}' is {given}, but the frames of its errors give {independent:.9g}"
            return
    if not row.independent:
        return
    values = errors if errors.shape[1] > 1 else errors[:, 0]
    interval = interval95(values, len(errors) / row.independent, unsigned=KINDS[row.figure].is_unsigned)
    for name, stored, derived in zip(
        ("low95", "high95"), (row.low95, row.high95), interval or (None, None), strict=True
    ):
        if stored == derived:
            continue
        if stored is None or derived is None or abs(stored - derived) > 100.0 * rounding + RESAMPLED * abs(derived):
            yield f"'{name}' of '{row.label}' is {_text(stored)}, but its errors give {_text(derived)}"


def _as_the_sample(row: Figure, sizes: FloatArray, rounding: float) -> Iterator[str]:
    """Yield the contradictions between the statistics of a row and the sizes of a sample of its errors."""
    if row.n is None or not len(sizes):
        return
    if row.max is not None and sizes.max() > row.max + rounding:
        yield f"'max' of '{row.label}' is {row.max:.9g}, but one of its errors is {sizes.max():.9g}"
    if row.rmse is not None and np.sum(np.square(sizes)) > row.n * (row.rmse + rounding) ** 2:
        yield f"'rmse' of '{row.label}' is {row.rmse:.9g}, which is less than the rmse of its errors"
    for name, percent in QUANTILES.items():
        share = 1.0 - percent / 100.0
        value = getattr(row, name)
        beyond = 0.0 if value is None else float(np.mean(sizes > value + rounding))
        deviation = SIGMAS * np.sqrt(CORRELATED * share * (1.0 - share) / len(sizes))
        if beyond > share + deviation:
            yield f"'{name}' of '{row.label}' is {value:.9g}, but {100.0 * beyond:.3g} % of its errors are larger"


def _of_points(score: Score) -> Iterator[str]:
    """Yield the contradictions between the point error and the map points in the data of the plots."""
    details = None if score.details is None else score.details.map
    row = score.figure("point_error", part=None)
    if details is None or row is None or None in details.cloud.error_m:
        return
    sizes = np.array(details.cloud.error_m, np.float64)
    if len(sizes) == row.n:
        yield from _computed_again(row, sizes[:, None], POINT_DIGITS_M)
    else:
        yield from _as_the_sample(row, sizes, POINT_DIGITS_M)


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
        scale = max(value, derived["rmse"]) if name == "mean" else value  # a mean may cancel
        if stored is not None and abs(stored - value) > EXACT * abs(scale):
            yield f"'{name}' of '{row.label}' is {stored:.9g}, but its parts give {value:.9g}"


def _of_calls(score: Score) -> Iterator[str]:
    """Yield the contradictions between time and memory of calls and the data of the plots."""
    for kind, plots in () if score.details is None else score.details.calls.items():
        is_stated = score.external is not None and kind == score.external.task  # its other row has latencies
        row = score.figure(kind, part=RowPart(place=Place.STATED) if is_stated else None)
        if row is not None:
            yield from _of_times(row, plots)
        yield from _of_memory(score, kind, plots)


def _of_memory(score: Score, kind: str, plots: CallPlots) -> Iterator[str]:
    """Yield a contradiction between the peak memory and the calls in the data of the plots (all or the slowest)."""
    row = score.figure("peak", part=kind)
    peaks = [value for value in plots.series.peak_rss_bytes if value is not None and value > 0.0]
    if row is None or row.value is None or not peaks or score.external is not None:
        return
    is_of_all, largest = plots.series.slowest_of == 1, int(max(peaks))  # the row has whole bytes
    if largest > row.value or (is_of_all and largest < row.value):
        yield f"'{row.label}' is {row.value:.9g}, but the largest value of its calls is {largest}"


def _of_times(row: Figure, plots: CallPlots) -> Iterator[str]:
    """Yield contradictions between the statistics of times and the slowest calls of each block, or the histogram."""
    times = [value for value in plots.series.processing_time_s if value is not None]
    if times and row.max is not None and max(times) != row.max:
        yield f"'max' of '{row.label}' is {row.max:.9g}, but its calls give {max(times):.9g}"
    if plots.series.slowest_of == 1 and len(times) == len(plots.series.processing_time_s) and times:
        yield from _computed_again(row, np.array(times)[:, None], 0.0)
        return
    counts, edges = np.array(plots.histogram.counts), np.array(plots.histogram.edges_s)
    if row.n is None or not len(counts) or counts.sum() != row.n:
        return
    bounds_s = np.sum(counts * edges[:-1]) / row.n, np.sum(counts * edges[1:]) / row.n
    if row.mean is not None and not bounds_s[0] * (1.0 - EXACT) <= row.mean <= bounds_s[1] * (1.0 + EXACT):
        low_s, high_s = bounds_s
        yield f"'mean' of '{row.label}' is {row.mean:.9g}, but the histogram gives {low_s:.9g} to {high_s:.9g}"
    reached = np.cumsum(counts)
    for name, percent in QUANTILES.items():
        rank = percent / 100.0 * (row.n - 1)  # among the sorted times, between two of them
        low, high = (edges[np.searchsorted(reached, int(each), "right")] for each in (np.floor(rank), np.ceil(rank)))
        high *= edges[1] / edges[0]  # all bins have this ratio of their edges
        value = getattr(row, name)
        if value is not None and not low * (1.0 - 1e-6) <= value <= high * (1.0 + 1e-6):
            yield f"'{name}' of '{row.label}' is {value:.9g}, but the histogram gives {low:.9g} to {high:.9g}"


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
            stated = f"{_text(share.value)} of {share.n}"
            yield f"'{share.label}' is {stated}, but there are {given} errors of a moving rover"


def _of_association(score: Score) -> Iterator[str]:
    """Yield the contradictions between the counts of poses and those of the association."""
    drive = score.association
    if drive is None:
        return
    for name in ("lost", "degraded"):
        row = score.figure(name, part=COUNT)
        if row is not None and row.value not in (None, getattr(drive, name)):
            yield f"'{name}' is {_text(row.value)}, but {getattr(drive, name)} frames are {name}"
    doubled = score.figure("doubled", part=COUNT)
    if doubled is not None and doubled.value != drive.estimate_duplicates:
        yield f"'doubled' is {_text(doubled.value)}, but {drive.estimate_duplicates} estimates have a repeated stamp"


def _text(value: float | None) -> str:
    return "null" if value is None else f"{value:.9g}"


CHECKS: tuple[Callable[[Score], Iterator[str]], ...] = (
    # against the errors, the points and the calls that the score contains
    _required,
    _of_sub_trajectories,
    _of_points,
    _of_calls,
    # against other rows and records of the score
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
