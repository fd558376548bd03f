"""Planes fitted to the heights around each cell: slope and roughness of the ground under the rover."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit_rows

MIN_PLANE_FRACTION = 0.5
"""Minimum fraction of the disc with heights for a plane. At the edge of the mapped ground, half of the disc has
heights, so that the plane is interpolated and not extrapolated."""
MIN_DETERMINANT = 1e-6
"""Minimum determinant of the covariance of the cells' positions, in units of cell_m^4: 0 if all cells are on a line."""


class Planes(NamedTuple):
    """Least-squares planes around each cell, `(R, C)` each; NaN where a plane is missing."""

    slope_x: FloatArray  #: Rise along x, metres per metre.
    slope_y: FloatArray  #: Rise along y, metres per metre.
    residual_m: FloatArray  #: Root mean squared difference of the heights from the plane.


@jit_rows
def fit_planes(height: FloatArray, plane_disc: IntArray, cell_m: float) -> Planes:
    """Return the least-squares planes of heights `(R, C)`, NaN where unknown, around each cell.

    `plane_disc` `(K, 2)` are the rows and columns, relative to the cell, of the cells to which its plane is fitted. A
    plane requires that `MIN_PLANE_FRACTION` of the disc is known.
    """
    rows, columns = height.shape
    slope_x = np.full((rows, columns), np.nan)
    slope_y = np.full((rows, columns), np.nan)
    residual = np.full((rows, columns), np.nan)
    size = len(plane_disc)
    for row in prange(rows):
        for column in range(columns):
            own = height[row, column]
            if np.isnan(own):
                continue
            # Sums of the coordinates and of their products, relative to the cell.
            n = 0.0
            x = 0.0
            y = 0.0
            z = 0.0
            xx = 0.0
            xy = 0.0
            yy = 0.0
            xz = 0.0
            yz = 0.0
            zz = 0.0
            for k in range(size):
                i = row + plane_disc[k, 0]
                j = column + plane_disc[k, 1]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(height[i, j]):
                    dx = plane_disc[k, 1] * cell_m
                    dy = plane_disc[k, 0] * cell_m
                    dz = height[i, j] - own
                    n += 1.0
                    x += dx
                    y += dy
                    z += dz
                    xx += dx * dx
                    xy += dx * dy
                    yy += dy * dy
                    xz += dx * dz
                    yz += dy * dz
                    zz += dz * dz
            if n < MIN_PLANE_FRACTION * size:
                continue
            mean_x = x / n
            mean_y = y / n
            mean_z = z / n
            cov_xx = xx / n - mean_x * mean_x
            cov_xy = xy / n - mean_x * mean_y
            cov_yy = yy / n - mean_y * mean_y
            cov_xz = xz / n - mean_x * mean_z
            cov_yz = yz / n - mean_y * mean_z
            cov_zz = zz / n - mean_z * mean_z
            determinant = cov_xx * cov_yy - cov_xy * cov_xy
            if determinant > MIN_DETERMINANT * cell_m**4:
                a = (cov_yy * cov_xz - cov_xy * cov_yz) / determinant
                b = (cov_xx * cov_yz - cov_xy * cov_xz) / determinant
                slope_x[row, column] = a
                slope_y[row, column] = b
                residual[row, column] = np.sqrt(max(cov_zz - a * cov_xz - b * cov_yz, 0.0))
    return Planes(slope_x, slope_y, residual)
