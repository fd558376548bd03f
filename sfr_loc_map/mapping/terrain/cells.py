"""Square cells in x and y of LM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray32, Mask
from sfr_loc_map.mapping.cloud_checks import check_points

MAX_CELLS = 2_500_000  #: Maximum number of cells: 300 MB at up to 120 bytes per cell while a grid is computed.


class Square(NamedTuple):
    """A square in x and y of LM."""

    x_m: float  #: Centre.
    y_m: float  #: Centre.
    half_side_m: float

    def contains(self, xyz: FloatArray32) -> Mask:
        """Return the mask `(N,)` of the points `(N, 3)` in LM that are in the square, including its sides."""
        x_offset = np.abs(xyz[:, 0].astype(np.float64) - self.x_m)
        y_offset = np.abs(xyz[:, 1].astype(np.float64) - self.y_m)
        return np.asarray(np.maximum(x_offset, y_offset) <= self.half_side_m)


@dataclass(frozen=True, slots=True)
class CellGrid:
    """A grid of square cells whose sides are at multiples of the cell size in x and y of LM.

    Grids of the same cell size therefore have the same cells for any cloud.
    """

    first_column: int  #: Column of cell (0, 0), counted from the cell at the origin of LM.
    first_row: int  #: Row of cell (0, 0), counted from the cell at the origin of LM.
    rows: int  #: Cells along y.
    columns: int  #: Cells along x.
    cell_m: float  #: Side of a cell.

    @property
    def origin_m(self) -> tuple[float, float]:
        """The smallest x and y of cell (0, 0)."""
        return self.first_column * self.cell_m, self.first_row * self.cell_m

    @classmethod
    def over(cls, xyz: FloatArray32, cell_m: float, within: Square | None = None) -> CellGrid:
        """Return the grid that covers the points `(N, 3)` in LM that are in the square `within`.

        The grid consists of complete cells and may extend beyond the square by less than one cell. `Square.contains`
        returns the points that are in the square itself.

        Raises MappingError if the cell size is not positive, the cloud is empty, a coordinate is not finite, all points
        are beyond the same edge of the square, or the grid would have too many cells.
        """
        if not cell_m > 0.0:
            raise MappingError(f"the cell size is {cell_m} m: a positive number is required")
        if len(xyz) == 0:
            raise MappingError("the cloud has no points: an elevation model requires at least one")
        check_points(xyz)
        low = np.array([float(xyz[:, axis].min()) for axis in (0, 1)])
        high = np.array([float(xyz[:, axis].max()) for axis in (0, 1)])
        if within is not None:
            centre = np.array((within.x_m, within.y_m))
            low = np.maximum(low, centre - within.half_side_m)
            high = np.minimum(high, centre + within.half_side_m)
            if (low > high).any():
                raise MappingError(
                    f"the cloud has no points within {within.half_side_m} m of ({within.x_m:.4g}, {within.y_m:.4g}) "
                    "along x and y: increase the range (terrain.range_m)"
                )
        first = np.floor(low / cell_m)
        columns, rows = np.floor(high / cell_m) - first + 1
        if rows * columns > MAX_CELLS:
            x, y = high - low
            raise MappingError(
                f"the grid of {x:.4g} x {y:.4g} m has {rows * columns / 1e6:.3g} million cells of {cell_m} m: at most "
                f"{MAX_CELLS / 1e6} million are allowed; use larger cells or a smaller range (terrain.cell_m, "
                "terrain.range_m)"
            )
        return cls(int(first[0]), int(first[1]), int(rows), int(columns), cell_m)

    def cell_of(self, xyz: FloatArray32) -> NDArray[np.int32]:
        """Return the cell index `(N,)` of each point, `row * columns + column`; -1 outside the grid."""
        column = np.floor(xyz[:, 0].astype(np.float64) / self.cell_m) - self.first_column
        row = np.floor(xyz[:, 1].astype(np.float64) / self.cell_m) - self.first_row
        inside = (column >= 0.0) & (column < self.columns) & (row >= 0.0) & (row < self.rows)
        return np.where(inside, row * self.columns + column, -1.0).astype(np.int32)
