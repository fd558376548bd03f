"""Points in the cells of a grid: where they lie, what is summed and ranked."""

import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.mapping.terrain.cells import TAIL, CellGrid, HeightErrors, height_sums, outer_heights, sorted_by_cell


def points(*xy: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in xy], np.float32)


def test_grids_of_one_cell_size_share_their_cells() -> None:
    one = CellGrid.over(points((0.05, 0.05), (0.95, 0.45)), 0.1)
    other = CellGrid.over(points((-0.35, 0.25), (0.55, 0.26)), 0.1)
    assert (one.first, one.rows, one.columns) == ((0, 0), 5, 10)
    assert (other.first, other.rows, other.columns) == ((-4, 2), 1, 10)
    assert other.origin_m == pytest.approx((-0.4, 0.2))
    assert one.cell_of(points((0.55, 0.25), (-0.01, 0.0), (1.01, 0.0), (0.0, 0.51))).tolist() == [25, -1, -1, -1]


def test_points_beyond_the_reach_do_not_count() -> None:
    grid = CellGrid.over(points((0.05, 0.05), (90.0, 0.0), (1.02, -1.02)), 0.1, (0.0, 0.0, 2.0))
    assert (grid.first, grid.rows, grid.columns) == ((0, -11), 12, 21)
    with pytest.raises(MappingError, match=r"no points within 2\.0 m of the cameras: raise terrain\.range_m"):
        CellGrid.over(points((90.0, 0.0)), 0.1, (0.0, 0.0, 2.0))


def test_sums_are_those_of_each_cell() -> None:
    rng = np.random.default_rng(3)
    cell = rng.integers(-1, 7, 500).astype(np.int32)
    height, share = rng.normal(size=500).astype(np.float32), rng.uniform(0.1, 1.0, 500)
    random = rng.uniform(0.01, 0.1, 500).astype(np.float32)
    sigma = (random * rng.uniform(1.0, 2.0, 500)).astype(np.float32)
    sums = height_sums(cell, 8, height, HeightErrors(share, sigma, random))
    for at in range(7):
        inside = cell == at
        weight = 1.0 / (share * random.astype(float) ** 2)[inside]
        mean = np.average(height[inside].astype(float), weights=weight)
        assert sums.points[at] == inside.sum()
        assert sums.weight[at] == pytest.approx(weight.sum())
        assert sums.mean[at] == pytest.approx(mean)
        assert sums.spread[at] == pytest.approx((weight * (height[inside] - mean) ** 2).sum())
        common = share * (sigma.astype(float) ** 2 - random.astype(float) ** 2)
        assert sums.common[at] == pytest.approx((weight * common[inside]).sum())
    assert np.isnan(sums.mean[7])


def test_outer_heights_are_those_of_the_sorted_heights() -> None:
    rng = np.random.default_rng(4)
    cell = rng.integers(-1, 30, 900).astype(np.int32)
    height = rng.integers(0, 12, 900).astype(np.float32)  # with many equal ones
    count = np.bincount(cell[cell >= 0], minlength=31)
    low, high = outer_heights(*sorted_by_cell(cell, count, height), 3)
    for at in range(30):
        ranked = np.sort(height[cell == at])
        assert low[at] == ranked[round(TAIL * (len(ranked) - 1))]
        assert high[at] == ranked[round((1.0 - TAIL) * (len(ranked) - 1))]
    assert np.isnan(low[30])
