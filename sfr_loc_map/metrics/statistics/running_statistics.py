"""Statistics of endless series in bounded memory, the same whether values come one by one or all at once."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.records.score_details import Column, Integers
from sfr_loc_map.metrics.score import SampleStatistic


class Moments:
    """Mean and sample standard deviation of each column, in constant memory.

    Welford's recurrence (1962), in the order of the values: exact to rounding however large the mean is.
    """

    def __init__(self, columns: int) -> None:
        self.count = 0
        self.mean = np.zeros(columns)
        self._squares = np.zeros(columns)

    def push(self, values: FloatArray) -> None:
        """Add rows `(M, columns)` float64."""
        self.count = int(_push_moments(self.count, self.mean, self._squares, values))

    @property
    def sigma(self) -> FloatArray | None:
        """Standard deviation of each column with Bessel's correction [4.1.3]; None for fewer than two rows."""
        return np.sqrt(self._squares / (self.count - 1)) if self.count > 1 else None


@jit
def _push_moments(count: int, mean: FloatArray, squares: FloatArray, values: FloatArray) -> int:
    for i in range(len(values)):
        count += 1
        for k in range(len(mean)):
            before = values[i, k] - mean[k]
            mean[k] += before / count
            squares[k] += before * (values[i, k] - mean[k])
    return count


class Decimated:
    """Every n-th row of an endless series, n the smallest power of two that keeps their number at or under a limit."""

    def __init__(self, columns: int, limit: int, dtype: type[np.generic] = np.float64) -> None:
        self._limit = limit
        self.count = 0
        self.step = 1
        self.rows: NDArray[Any] = np.empty((0, columns), dtype)

    def push(self, values: NDArray[Any]) -> None:
        """Add rows `(M, columns)`."""
        first = -self.count % self.step
        if first < len(values):
            self.rows = np.concatenate((self.rows, values[first :: self.step]))
        self.count += len(values)
        while len(self.rows) > self._limit:
            self.rows = self.rows[::2].copy()
            self.step *= 2


class RowQueue:
    """Columns of rows that are added at the end and dropped at the front, at constant amortised cost."""

    def __init__(self) -> None:
        self._arrays: dict[str, NDArray[Any]] = {}
        self._first = 0
        self._end = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._end - self._first

    @property
    def names(self) -> Iterable[str]:
        """Names of the columns."""
        return self._arrays

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one column as a view that holds until the next change."""
        return self._arrays[name][self._first : self._end]

    def append(self, **columns: NDArray[Any]) -> None:
        """Add rows; the first rows give names, types and shapes of the columns, which are the same from then on."""
        if not self._arrays:
            self._arrays = {name: np.empty((64, *array.shape[1:]), array.dtype) for name, array in columns.items()}
        added = len(next(iter(columns.values())))
        size = len(next(iter(self._arrays.values())))
        if self._end + added > size:
            self._move(size if 2 * (len(self) + added) <= size else 2 * (len(self) + added))
        for name, array in columns.items():
            self._arrays[name][self._end : self._end + added] = array
        self._end += added

    def drop(self, count: int) -> None:
        """Take away the oldest rows."""
        self._first += count

    def _move(self, size: int) -> None:
        count = len(self)
        for name, array in self._arrays.items():
            moved = np.empty((size, *array.shape[1:]), array.dtype)
            moved[:count] = array[self._first : self._end]
            self._arrays[name] = moved
        self._first, self._end = 0, count


def norm(values: FloatArray) -> float:
    """Return the Cartesian norm of a short vector, always summed in the same order."""
    total = 0.0
    for value in values.tolist():
        total += value * value
    return float(np.sqrt(total))


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


def integers(values: NDArray[np.integer]) -> Integers:
    """Return whole numbers for figures."""
    return tuple(values.tolist())
