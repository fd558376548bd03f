"""Figures of series of values, and the 95 % interval of mean + 3 sigma from sub-trajectories that overlap.

Sub-trajectories that share frames share errors: n of them, each overlapping L starts, are worth about m = n / L. So
blocks of at least L consecutive ones are drawn (circular block bootstrap, Politis and Romano 1992). What blocks cannot
show is corrected by what is known of overlapping sums, whose correlation falls off in a straight line over L:

- A block of length l shows a variance that is too small by the factor r = sum (1 - |h|/l)(1 - |h|/L) / sum (1 - |h|/L)
  over |h| < L; m blocks, by (m - 1) / m.
- The sample variance is itself too small, by (1 - 1/m) / (1 - 1/n), and the norm of a mean vector too large, by the
  scatter of the mean. The interval is laid around the figure without these two.
- The scatter of the resampled figures is scaled by Student's t on a logarithmic scale, since the figure is positive.
  Its degrees of freedom, (m - 1) times the root of the number of directions that the errors have, at least 1.5, and a
  widening by a tenth (unsigned errors: a quarter, for they are skewed) are set by experiment.

test/metrics/interval_coverage.py measures how often the interval holds the true value. SciPy's special functions are
imported when the first figure needs them: nodes must start quickly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.score import Column, Interval, SampleStatistic, Statistic

MAX_BLOCKS = 512  #: Sums are taken over at most so many stretches of consecutive values; a stretch grows by doubling.
RESAMPLES = 1000
WIDENING, WIDENING_UNSIGNED = 1.1, 1.25
"""Resampled figures scatter that much less than the true ones; the second of errors that are never negative."""
MIN_FREEDOM = 1.5
MIN_INDEPENDENT = 2.0  #: With fewer independent sub-trajectories there is no interval.


# ---- mean and scatter


@jit
def add_moments(values: FloatArray, count: int, mean: FloatArray, squares: FloatArray) -> None:
    """Add values `(N, K)` to the means and sums of squared differences `(K,)` of `count` ones (Welford 1962)."""
    for i in range(len(values)):
        for k in range(len(mean)):
            before = values[i, k] - mean[k]
            mean[k] += before / (count + i + 1)
            squares[k] += before * (values[i, k] - mean[k])


def statistic(count: int, mean: FloatArray, squares: FloatArray) -> Statistic:
    """Return the statistic of a vector from the moments of its columns [4.1.3, 4.2.3]; of one with its sign."""
    if not count or not np.isfinite(mean).all():  # attitudes are not known
        return Statistic(mean=None, sigma=None, mean_plus_3sigma=None)
    middle, sigma = float(mean[0]), float(np.sqrt(squares[0] / max(count - 1, 1)))
    if len(mean) > 1:  # summed one after the other, so that the last digit is always the same
        sums = np.cumsum(np.square((mean, np.sqrt(squares / max(count - 1, 1)))), axis=1)[:, -1]
        middle, sigma = np.sqrt(sums).tolist()
    if count < 2:
        return Statistic(mean=middle, sigma=None, mean_plus_3sigma=None)
    return Statistic(mean=middle, sigma=sigma, mean_plus_3sigma=abs(middle) + 3.0 * sigma)


def sample_statistic(values: NDArray[np.floating]) -> SampleStatistic:
    """Return the statistic of all values; None where undefined."""
    data = np.asarray(values, dtype=np.float64)
    count = len(data)
    mean = float(np.mean(data)) if count else None
    sigma = float(np.std(data, ddof=1)) if count > 1 else None
    p50, p95 = (float(p) for p in np.percentile(data, (50.0, 95.0))) if count else (None, None)
    total = mean + 3.0 * sigma if mean is not None and sigma is not None else None
    return SampleStatistic(count=count, mean=mean, sigma=sigma, mean_plus_3sigma=total, p50=p50, p95=p95)


def column(values: FloatArray, digits: int | None = 9) -> Column:
    """Return numbers for figures, rounded (the score itself is not) unless digits is None; None where not finite."""
    exact = values.tolist()
    rounded = exact if digits is None else [round(value, digits) for value in exact]
    return tuple(value if math.isfinite(value) else None for value in rounded)


# ---- distributions, as scipy.stats computes them, without its slow import


def chi2_interval95(freedom: float, count: int) -> Interval:
    """Return the 2.5 % and 97.5 % points of a chi-squared variable, over a count."""
    return chi2_quantile(0.025, freedom) / count, chi2_quantile(0.975, freedom) / count


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the value that a chi-squared variable stays below with this probability (Abramowitz, Stegun 26.4.19)."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def student_quantile(share: float, freedom: float) -> float:
    """Return the value that a Student t variable stays below with this probability."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Return probabilities corrected for their number (Holm 1979); None stays and does not count."""
    known = sorted((value, index) for index, value in enumerate(probabilities) if value is not None)
    corrected: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[index] = largest
    return corrected


# ---- the interval


@jit
def add_to_blocks(values: FloatArray, rows: FloatArray) -> None:
    """Add the next values `(N, K)` of a series to `rows` `(MAX_BLOCKS, 1 + 2 K)`, which begin as zeros.

    Each is of one stretch of consecutive values: count, sums, sums of squares. All stretches are as long as the first;
    the last may be shorter.
    """
    columns, used, size = values.shape[1], 0, max(int(rows[0, 0]), 1)
    while used < len(rows) and rows[used, 0] > 0:
        used += 1
    for i in range(len(values)):
        if used == 0 or rows[used - 1, 0] >= size:
            if used == len(rows):
                for k in range(len(rows) // 2):
                    for c in range(rows.shape[1]):
                        rows[k, c] = rows[2 * k, c] + rows[2 * k + 1, c]
                for k in range(len(rows) // 2, len(rows)):
                    for c in range(rows.shape[1]):
                        rows[k, c] = 0.0
                used = len(rows) // 2
                size *= 2
            used += 1
        row = used - 1
        rows[row, 0] += 1.0
        for k in range(columns):
            rows[row, 1 + k] += values[i, k]
            rows[row, 1 + columns + k] += values[i, k] * values[i, k]


def interval95(stretches: FloatArray, columns: slice, overlap: float, *, unsigned: bool) -> Interval | None:
    """Return the 95 % interval of norm(mean) + 3 norm(sigma) of some columns, None of too few independent values.

    `stretches` are those of `add_to_blocks`. `overlap` starts lie within one sub-trajectory on average; unsigned values
    are never negative.
    """
    rows, width = stretches[stretches[:, 0] > 0], (stretches.shape[1] - 1) // 2
    counts, sums, squares = rows[:, 0], rows[:, 1 : 1 + width][:, columns], rows[:, 1 + width :][:, columns]
    count = float(counts.sum())
    independent = count / max(overlap, 1.0)
    if count < 2 or independent < MIN_INDEPENDENT or not np.isfinite(sums).all():
        return None
    mean = sums.sum(axis=0) / count
    centred = np.column_stack(
        (counts, sums - counts[:, None] * mean, squares - 2.0 * mean * sums + counts[:, None] * mean * mean)
    )
    variances = np.maximum(centred[:, 1 + len(mean) :].sum(axis=0), 0.0) / (count - 1.0)
    size = float(np.sqrt(np.square(mean).sum()))
    if not variances.any():
        return size, size
    means, figures, share = resampled(centred, mean, overlap, int(counts[0]))
    share *= 1.0 - 1.0 / independent
    scatter = float(np.square(means - mean).sum(axis=1).mean()) / share
    true_size = max(size - scatter / size, 0.0) if size > 0.0 else 0.0
    true_sigma = np.sqrt(variances.sum() * (1.0 - 1.0 / count) / (1.0 - 1.0 / independent))
    centre, error = float(true_size + 3.0 * true_sigma), float(np.std(figures) / np.sqrt(share))
    directions = float(variances.sum() ** 2 / np.square(variances).sum())
    freedom = max((independent - 1.0) * np.sqrt(directions), MIN_FREEDOM)
    widening = WIDENING_UNSIGNED if unsigned else WIDENING
    factor = float(np.exp(widening * student_quantile(0.975, freedom) * error / centre))
    return centre / factor, centre * factor


def resampled(
    centred: FloatArray, mean: FloatArray, overlap: float, size: int = 1
) -> tuple[FloatArray, FloatArray, float]:
    """Return mean vectors `(B, d)` and figures `(B,)` of resampled series, and the share of the variance they show.

    Rows `(N, 1 + 2 d)` are count, sums and sums of squares of offsets of `size` values, drawn alike for one length.
    """
    block = min(max(1, int(np.ceil(overlap / size))), len(centred))
    twice = np.concatenate((centred, centred[:block]))
    until = np.concatenate((np.zeros((1, centred.shape[1])), np.cumsum(twice, axis=0)))
    blocks = until[block : block + len(centred)] - until[: len(centred)]
    draws = -(-len(centred) // block)
    drawn = np.random.default_rng(20240229).integers(0, len(centred), (RESAMPLES, draws), dtype=np.int32)
    total = np.zeros((RESAMPLES, centred.shape[1]))
    for rows in drawn.T:  # one after the other, as is every sum here: the last digit is always the same
        total += blocks[rows]
    counts, sums, squares = total[:, :1], total[:, 1 : 1 + len(mean)], total[:, 1 + len(mean) :]
    offsets = sums / counts
    means = mean + offsets
    variances = np.maximum(squares - counts * offsets * offsets, 0.0) / np.maximum(counts - 1.0, 1.0)
    sizes, scatters = (np.sqrt(np.cumsum(part, axis=1)[:, -1]) for part in (np.square(means), variances))
    lags = np.arange(1.0, np.ceil(overlap))
    fall = 1.0 - lags / overlap
    shown = np.maximum(1.0 - lags / float(block * size), 0.0)
    share = float((1.0 + 2.0 * np.sum(fall * shown)) / (1.0 + 2.0 * np.sum(fall)))
    return means, sizes + 3.0 * scatters, share
