"""Check that the table of figures follows from the raw values in the same score.

A score contains the errors of sub-trajectories, a sample of the map points, and the times of calls, for plots and for
tolerance bounds. If the score contains all values, the statistics are recomputed. If the score contains only every
n-th value, the statistics must be consistent with this sample.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.errors.trajectory_errors import overlap_of
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.details import CallPlots, SubTrajectoryRows
from sfr_loc_map.metrics.figures.row_part import Place, RowPart
from sfr_loc_map.metrics.figures.rows import Figure, number_text
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS, statistics
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import interval95

EXACT = 1e-9  #: Relative tolerance of a recomputed statistic.
RESAMPLED = 1e-6  #: Relative tolerance of a bound of an interval, which is a sum over many resampled series.
DIGITS_M, POINT_DIGITS_M = 1e-8, 5e-5
"""Rounding of the errors of sub-trajectories and of map points in the data of the plots, m."""
SIGMAS = 5.0  #: A quantile contradicts the sample if a sampled fraction deviates by more standard deviations than this.
CORRELATED = 10.0  #: Number of correlated values that are equivalent to one independent value.


def fault_of_raw_values(score: Score) -> str | None:
    """Return the first contradiction between the figures and the raw values of a score; None if there is none."""
    checks = (_of_sub_trajectories, _of_points, _of_calls)
    return next((problem for check in checks for problem in check(score)), None)


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
            yield f"'{name}' of '{row.label}' is {number_text(stored)}, but its errors give {number_text(derived)}"


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
            given = number_text(row.independent)
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
            yield f"'{name}' of '{row.label}' is {number_text(stored)}, but its errors give {number_text(derived)}"


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


def _of_calls(score: Score) -> Iterator[str]:
    """Yield the contradictions between time and memory of calls and the data of the plots."""
    for kind, plots in () if score.details is None else score.details.calls.items():
        is_stated = score.external is not None and kind == score.external.task  # the row of the host has latencies
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
        high *= edges[1] / edges[0]  # the ratio of upper to lower edge is the same for all bins
        value = getattr(row, name)
        if value is not None and not low * (1.0 - 1e-6) <= value <= high * (1.0 + 1e-6):
            yield f"'{name}' of '{row.label}' is {value:.9g}, but the histogram gives {low:.9g} to {high:.9g}"
