"""Points sorted into the cells of a grid; what is counted, averaged and ranked within each cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline, jit_rows

MAX_CELLS = 25_000_000
TAIL = 0.15
"""Share of the points of a cell that lie above its high height, and below its low one: outliers are among them."""


@dataclass(frozen=True, slots=True)
class CellGrid:
    """A grid of square cells whose sides lie at multiples of their length in x and y of LM.

    So grids of one cell size have the same cells, whatever cloud they were made of.

    Attributes:
        first: Number of the first cell along x and along y, counted from that at the origin of LM.
        rows: Cells along y.
        columns: Cells along x.
        cell_m: Side of a cell.
    """

    first: tuple[int, int]
    rows: int
    columns: int
    cell_m: float

    @property
    def origin_m(self) -> tuple[float, float]:
        """The x and y of the outer corner of cell (0, 0), which has the least x and y."""
        return self.first[0] * self.cell_m, self.first[1] * self.cell_m

    @classmethod
    def over(
        cls, xyz: NDArray[np.float32], cell_m: float, within: tuple[float, float, float] | None = None
    ) -> CellGrid:
        """Return the smallest grid that has a cell for each point.

        Args:
            xyz: `(N, 3)`, metres, LM.
            cell_m: Side of a cell.
            within: x, y and half the side of a square outside of which points do not count; None for all points.

        Raises:
            MappingError: If the cell is not positive, no point counts, or there would be too many cells.
        """
        if not cell_m > 0.0:
            raise MappingError(f"cells of {cell_m} m: the side must be more than 0")
        if len(xyz) == 0:
            raise MappingError("the cloud has no points: an elevation model needs some")
        low, high = _bounds(xyz)
        if within is not None:
            centre, reach = np.array(within[:2]), within[2]
            low, high = np.maximum(low, centre - reach), np.minimum(high, centre + reach)
            if not (low <= high).all():
                raise MappingError(f"the cloud has no points within {reach} m of the cameras: raise terrain.range_m")
        first, last = np.floor(low / cell_m).astype(np.int64), np.floor(high / cell_m).astype(np.int64)
        columns, rows = (int(size) for size in last - first + 1)
        if rows * columns > MAX_CELLS:
            raise MappingError(
                f"cells of {cell_m} m over {columns * cell_m:.0f} x {rows * cell_m:.0f} m are "
                f"{rows * columns / 1e6:.0f} million: {MAX_CELLS / 1e6:.0f} million are the limit; take larger cells "
                f"or a smaller max_range_m"
            )
        return cls((int(first[0]), int(first[1])), rows, columns, cell_m)

    def cell_of(self, xyz: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the cell `(N,)` of each point, row times columns plus column; -1 where it lies outside."""
        return _cell_of(xyz, self.first[0], self.first[1], self.rows, self.columns, self.cell_m)


class HeightSums(NamedTuple):
    """Sums over the points of each cell, all `(rows * columns,)`.

    Attributes:
        points: Their number.
        weight: Of the weights, 1 / m^2.
        mean: Weighted mean of the heights, NaN without points, metres.
        spread: Of the weighted squared differences from that mean.
        common: Of the weighted variances that points share.
    """

    points: IntArray
    weight: FloatArray
    mean: FloatArray
    spread: FloatArray
    common: FloatArray


@jit
def _cell_of(
    xyz: NDArray[np.float32], first_x: int, first_y: int, rows: int, columns: int, cell_m: float
) -> NDArray[np.int32]:
    cell = np.empty(len(xyz), np.int32)
    for i in range(len(xyz)):
        x = np.floor(np.float64(xyz[i, 0]) / cell_m) - first_x
        y = np.floor(np.float64(xyz[i, 1]) / cell_m) - first_y
        inside = 0.0 <= x < columns and 0.0 <= y < rows
        cell[i] = np.int32(y) * columns + np.int32(x) if inside else -1
    return cell


@jit
def _bounds(xyz: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest x and y."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(xyz)):
        for axis in range(2):
            value = np.float64(xyz[i, axis])
            low[axis], high[axis] = min(low[axis], value), max(high[axis], value)
    return low, high


class HeightErrors(NamedTuple):
    """What the error of each point's height is made of, all `(N,)`.

    Attributes:
        share: Variance of the height over that along the ray.
        sigma_m: Standard deviation along the ray.
        random_m: Its part that differs from point to point.
    """

    share: FloatArray
    sigma_m: NDArray[np.float32]
    random_m: NDArray[np.float32]


@jit_inline
def _random_variance(errors: HeightErrors, i: int) -> np.float64:
    random = np.float64(errors.random_m[i])
    return np.float64(errors.share[i] * (random * random))


@jit
def height_sums(cell: NDArray[np.int32], cells: int, height: NDArray[np.float32], errors: HeightErrors) -> HeightSums:
    """Return the sums of each cell, points weighted by the inverse of the random part of their variance.

    Args:
        cell: `(N,)` cell of each point, -1 for none.
        cells: Number of cells.
        height: `(N,)` metres.
        errors: Of the points.
    """
    count, weights, mean = np.zeros(cells, np.int64), np.zeros(cells), np.zeros(cells)
    spread, common = np.zeros(cells), np.zeros(cells)
    for i in range(len(cell)):
        at = cell[i]
        if at >= 0:
            sigma, random = np.float64(errors.sigma_m[i]), np.float64(errors.random_m[i])
            weight = 1.0 / _random_variance(errors, i)
            count[at] += 1
            weights[at] += weight
            mean[at] += weight * np.float64(height[i])
            common[at] += weight * (errors.share[i] * max(sigma * sigma - random * random, 0.0))
    for at in range(cells):
        mean[at] = mean[at] / weights[at] if count[at] else np.nan
    for i in range(len(cell)):
        at = cell[i]
        if at >= 0:
            difference = np.float64(height[i]) - mean[at]
            spread[at] += difference * difference / _random_variance(errors, i)
    return HeightSums(count, weights, mean, spread, common)


@jit_inline
def _ranked(values: NDArray[np.float32], low: int, high: int, rank: int) -> float:
    """Return the value of a rank among `values[low:high + 1]`, which are reordered (Hoare's selection)."""
    while low < high:
        pivot, left, right = values[(low + high) // 2], low, high
        while left <= right:
            while values[left] < pivot:
                left += 1
            while values[right] > pivot:
                right -= 1
            if left <= right:
                values[left], values[right] = values[right], values[left]
                left += 1
                right -= 1
        if rank <= right:
            high = right
        elif rank >= left:
            low = left
        else:
            break
    return np.float64(values[rank])


@jit
def sorted_by_cell(
    cell: NDArray[np.int32], count: IntArray, height: NDArray[np.float32]
) -> tuple[IntArray, NDArray[np.float32]]:
    """Return where each cell's heights begin `(cells + 1,)`, and the heights in the order of the cells."""
    begin = np.zeros(len(count) + 1, np.int64)
    for at in range(len(count)):
        begin[at + 1] = begin[at] + count[at]
    place = begin[:-1].copy()
    heights = np.empty(begin[-1], np.float32)
    for i in range(len(cell)):
        if cell[i] >= 0:
            heights[place[cell[i]]] = height[i]
            place[cell[i]] += 1
    return begin, heights


@jit_rows
def outer_heights(begin: IntArray, heights: NDArray[np.float32], min_points: int) -> FloatArray:
    """Return a low and a high one of the heights of each cell `(2, cells)`, `TAIL` from either end, by nearest rank.

    Args:
        begin: `(cells + 1,)` where each cell's heights begin.
        heights: In the order of the cells; reordered within each.
        min_points: A cell with fewer has none: NaN.
    """
    found = np.full((2, len(begin) - 1), np.nan)
    for at in numba.prange(len(begin) - 1):
        low, high = begin[at], begin[at + 1] - 1
        if high - low + 1 >= min_points:
            for which in range(2):
                rank = low + np.int64(np.rint((TAIL + (1.0 - 2.0 * TAIL) * which) * (high - low)))
                found[which, at] = _ranked(heights, low, high, rank)
    return found
