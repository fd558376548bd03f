"""95 % interval of mean + 3 sigma from sub-trajectories that overlap.

Sub-trajectories that share frames share errors: n of them, each overlapping `overlap` starts, are worth about
m = n / overlap independent ones. So blocks of at least `overlap` consecutive sub-trajectories are drawn (circular block
bootstrap, Politis and Romano 1992), which keeps the dependence within a block. What blocks cannot show is corrected by
what is known of overlapping sums, whose correlation falls off in a straight line over the overlap:

- A block of length l shows a variance that is too small by the factor r = sum (1 - |h|/l)(1 - |h|/L) / sum (1 - |h|/L)
  over |h| < L, L the overlap; m blocks, by (m - 1) / m.
- The sample variance is itself too small, by (1 - 1/m) / (1 - 1/n), and the norm of a mean vector too large, by the
  scatter of the mean. The interval is laid around the figure without these two.
- The scatter of the resampled figures is scaled by Student's t on a logarithmic scale, since the figure is positive.
  Its degrees of freedom, (m - 1) times the root of the number of directions that the errors have, at least 1.5, and a
  widening by a tenth (unsigned errors: a quarter, for they are skewed) are set by experiment.

How often the interval holds the true value is measured by test/metrics/interval_coverage.py, see docs/metrics.md.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.score import Interval
from sfr_loc_map.metrics.statistics import student_quantile

MAX_BLOCKS = 512
"""Sums are taken over at most so many stretches of consecutive values; a stretch grows by doubling."""
RESAMPLES = 1000
SEED = 20240229
WIDENING = 1.1
"""Resampled figures scatter that much less than the true ones."""
WIDENING_UNSIGNED = 1.25
"""The same of errors that are never negative: they are skewed."""
MIN_FREEDOM = 1.5
MIN_INDEPENDENT = 2.0
"""With fewer independent sub-trajectories there is no interval."""


class BlockSums(NamedTuple):
    """Sums over consecutive stretches of a series.

    Attributes:
        rows: `(G, 1 + 2 columns)` count, sums and sums of squares of the columns; the last stretch may be shorter.
        size: Values of a full stretch.
    """

    rows: FloatArray
    size: int


@jit
def block_sums(values: FloatArray) -> BlockSums:
    """Return the sums of a series `(N, columns)`."""
    columns = values.shape[1]
    rows = np.zeros((MAX_BLOCKS, 1 + 2 * columns))
    used, size = 0, 1
    for i in range(len(values)):
        if used == 0 or rows[used - 1, 0] >= size:
            if used == len(rows):
                for k in range(len(rows) // 2):
                    rows[k] = rows[2 * k] + rows[2 * k + 1]
                rows[len(rows) // 2 :] = 0.0
                used = len(rows) // 2
                size *= 2
            used += 1
        row = used - 1
        rows[row, 0] += 1.0
        for k in range(columns):
            rows[row, 1 + k] += values[i, k]
            rows[row, 1 + columns + k] += values[i, k] * values[i, k]
    return BlockSums(rows[:used], size)


def interval95(stretches: BlockSums, columns: slice, overlap: float, *, unsigned: bool) -> Interval | None:
    """Return the 95 % interval of norm(mean) + 3 norm(sigma) of some columns.

    Args:
        stretches: Sums of the series.
        columns: Columns that make one vector.
        overlap: Starts that lie within one sub-trajectory, on average, >= 1.
        unsigned: Whether the values are never negative.

    Returns:
        Lower and upper bound; None where there are too few independent values.
    """
    width = (stretches.rows.shape[1] - 1) // 2
    counts, sums, squares = (
        stretches.rows[:, 0],
        stretches.rows[:, 1 : 1 + width][:, columns],
        stretches.rows[:, 1 + width :][:, columns],
    )
    count = float(counts.sum())
    independent = count / max(overlap, 1.0)
    if count < 2 or independent < MIN_INDEPENDENT:
        return None
    mean = sums.sum(axis=0) / count
    centred = np.column_stack(
        (counts, sums - counts[:, None] * mean, squares - 2.0 * mean * sums + counts[:, None] * mean * mean)
    )
    variances = np.maximum(centred[:, 1 + len(mean) :].sum(axis=0), 0.0) / (count - 1.0)
    if not variances.any():
        size = float(np.sqrt(np.square(mean).sum()))
        return size, size
    block = min(max(1, int(np.ceil(overlap / stretches.size))), len(counts))
    means, figures = _resampled(centred, mean, block)
    share = (1.0 - 1.0 / independent) * blocks_share(overlap, float(block * stretches.size))
    scatter = float(np.square(means - mean).sum(axis=1).mean()) / share
    size = float(np.sqrt(np.square(mean).sum()))
    true_size = max(size - scatter / size, 0.0) if size > 0.0 else 0.0
    true_sigma = np.sqrt(variances.sum() * (1.0 - 1.0 / count) / (1.0 - 1.0 / independent))
    centre, error = float(true_size + 3.0 * true_sigma), float(np.std(figures) / np.sqrt(share))
    directions = float(variances.sum() ** 2 / np.square(variances).sum())
    freedom = max((independent - 1.0) * np.sqrt(directions), MIN_FREEDOM)
    widening = WIDENING_UNSIGNED if unsigned else WIDENING
    factor = float(np.exp(widening * student_quantile(0.975, freedom) * error / centre))
    return centre / factor, centre * factor


def blocks_share(overlap: float, block: float) -> float:
    """Return the share of the variance of a mean that blocks of a length show."""
    lags = np.arange(1.0, np.ceil(overlap))
    fall = 1.0 - lags / overlap
    return float((1.0 + 2.0 * np.sum(fall * np.maximum(1.0 - lags / block, 0.0))) / (1.0 + 2.0 * np.sum(fall)))


def resampled_figures(values: FloatArray, block: int) -> FloatArray:
    """Return the figure of resampled series; series of one length are drawn in the same blocks.

    Args:
        values: `(N, d)` consecutive vectors.
        block: Length of a block, at most N.

    Returns:
        `(RESAMPLES,)`.
    """
    mean = values.mean(axis=0)
    offsets = values - mean
    return _resampled(np.column_stack((np.ones(len(values)), offsets, offsets * offsets)), mean, block)[1]


def _resampled(centred: FloatArray, mean: FloatArray, block: int) -> tuple[FloatArray, FloatArray]:
    """Return mean vectors `(B, d)` and figures `(B,)` of resampled series."""
    twice = np.concatenate((centred, centred[:block]))
    until = np.concatenate((np.zeros((1, centred.shape[1])), np.cumsum(twice, axis=0)))
    blocks = until[block : block + len(centred)] - until[: len(centred)]
    return _figures_of(blocks, _drawn(len(centred), -(-len(centred) // block)), mean)


@lru_cache(maxsize=2)
def _drawn(rows: int, draws: int) -> NDArray[np.int32]:
    """Return the numbers `(RESAMPLES, draws)` of the blocks drawn, the same for the same sizes."""
    return np.random.default_rng(SEED).integers(0, rows, (RESAMPLES, draws), dtype=np.int32)


@jit
def _figures_of(blocks: FloatArray, drawn: NDArray[np.int32], mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean vectors and figures of series put together from block sums `(rows, 1 + 2 d)`."""
    width = len(mean)
    means, figures = np.empty((len(drawn), width)), np.empty(len(drawn))
    total = np.empty(blocks.shape[1])
    for b in range(len(drawn)):
        total[:] = 0.0
        for row in drawn[b]:
            for k in range(len(total)):
                total[k] += blocks[row, k]
        size, variance = 0.0, 0.0
        for k in range(width):
            offset = total[1 + k] / total[0]
            means[b, k] = mean[k] + offset
            size += means[b, k] ** 2
            variance += max(total[1 + width + k] - total[0] * offset * offset, 0.0) / max(total[0] - 1.0, 1.0)
        figures[b] = np.sqrt(size) + 3.0 * np.sqrt(variance)
    return means, figures
