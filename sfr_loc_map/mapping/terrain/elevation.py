"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.mapping.terrain.cells import CellGrid, HeightErrors, height_sums

SLOPE = 0.1
"""Typical slope of ground: a point displaced along its ray lies over ground that is as much higher or lower."""


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows go along y and columns along x of LM.

    Attributes:
        height_m: `(R, C)` float32, z of LM, NaN in cells without a point.
        sigma_m: `(R, C)` float32, standard deviation of the height, NaN likewise.
        count: `(R, C)` int32, points in the cell.
        origin_m: x and y of the outer corner of cell (0, 0), which has the least x and y.
        cell_m: Side of a cell.
    """

    height_m: NDArray[np.float32]
    sigma_m: NDArray[np.float32]
    count: NDArray[np.int32]
    origin_m: tuple[float, float]
    cell_m: float


def elevation_from_cloud(
    cloud: PointCloud,
    T_lm_left: Sequence[Transform] | None,
    cell_m: float,
    random_sigma: NDArray[np.float32] | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud.

    An error `e` of a point along its ray is an error of its height of the ray's z component times `e`, and of what the
    ground rises over the horizontal displacement. Heights of a cell are averaged by the inverse of that variance.
    Errors of neighbouring points are correlated, so the variance of a cell's mean is that of its points; to it comes
    that of the mean over heights that differ within the cell, and what the points' sigma has beyond its random part: an
    error that they share has no say in their weights, and no mean removes it.

    Args:
        cloud: Points in LM.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`; None where they are not
            known: rays are then taken for vertical, which overstates the sigma of a height.
        cell_m: Side of a cell.
        random_sigma: `(N,)`, metres, the part of sigma that differs from point to point; None for all of it.

    Raises:
        MappingError: If the cell is not positive, the cloud is empty, or there would be too many cells.
    """
    grid = CellGrid.over(cloud.xyz, cell_m)
    return elevation_of_cells(cloud, T_lm_left, grid, grid.cell_of(cloud.xyz), random_sigma)


def elevation_of_cells(
    cloud: PointCloud,
    T_lm_left: Sequence[Transform] | None,
    grid: CellGrid,
    cell: NDArray[np.int32],
    random_sigma: NDArray[np.float32] | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud over a grid; `cell` `(N,)` is each point's cell, -1 for none.

    The other arguments are those of `elevation_from_cloud`.
    """
    errors = HeightErrors(
        _height_shares(cloud, T_lm_left), cloud.sigma, cloud.sigma if random_sigma is None else random_sigma
    )
    sums = height_sums(cell, grid.rows * grid.columns, np.ascontiguousarray(cloud.xyz[:, 2]), errors)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = sums.points / sums.weight + sums.spread / sums.weight / sums.points + sums.common / sums.weight
    shape = (grid.rows, grid.columns)
    return ElevationModel(
        sums.mean.astype(np.float32).reshape(shape),
        np.sqrt(variance).astype(np.float32).reshape(shape),
        sums.points.astype(np.int32).reshape(shape),
        grid.origin_m,
        grid.cell_m,
    )


def _height_shares(cloud: PointCloud, T_lm_left: Sequence[Transform] | None) -> FloatArray:
    """Return which share of each point's variance along its ray is that of its height `(N,)`.

    Raises:
        MappingError: If a point is of a pair without a pose.
    """
    if T_lm_left is None:
        return np.full(len(cloud), 1.0 + SLOPE**2)
    if len(cloud) and int(cloud.pair.max()) >= len(T_lm_left):
        raise MappingError(
            f"the cloud has points of pair {int(cloud.pair.max())}, poses of {len(T_lm_left)} pairs are given: "
            f"give that of each pair"
        )
    return _vertical_shares(cloud.xyz, cloud.pair, np.stack([pose.translation for pose in T_lm_left]))


@jit
def _vertical_shares(xyz: NDArray[np.float32], pair: NDArray[np.uint8], centres: FloatArray) -> FloatArray:
    share = np.empty(len(xyz))
    for i in range(len(xyz)):
        x = np.float64(xyz[i, 0]) - centres[pair[i], 0]
        y = np.float64(xyz[i, 1]) - centres[pair[i], 1]
        z = np.float64(xyz[i, 2]) - centres[pair[i], 2]
        share[i] = z * z / (x * x + y * y + z * z) + SLOPE**2
    return share


def rays(cloud: PointCloud, T_lm_left: Sequence[Transform]) -> FloatArray:
    """Return the unit vectors `(N, 3)` in LM along which each point is seen by its pair's left camera."""
    centres = np.stack([pose.translation for pose in T_lm_left])
    ray = cloud.xyz - centres[cloud.pair]
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    return np.asarray(ray)


def point_covariances(cloud: PointCloud, T_lm_left: Sequence[Transform], focal_px: float) -> NDArray[np.float32]:
    """Return the covariance of each point in LM `(N, 3, 3)`, square metres.

    Along the ray it is the point's variance. Across, a point represents its whole pixel: a uniform distribution over a
    square of side `Z / f`, whose variance is `(Z / f)^2 / 12`.

    Args:
        cloud: Points in LM.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`.
        focal_px: Focal length, pixels.
    """
    ray = rays(cloud, T_lm_left)
    axes = np.stack([pose.rotation[:, 2] for pose in T_lm_left])[cloud.pair]
    centres = np.stack([pose.translation for pose in T_lm_left])[cloud.pair]
    depth = np.einsum("ij,ij->i", cloud.xyz - centres, axes)
    across = np.square(depth / focal_px) / 12.0
    along = np.square(cloud.sigma.astype(np.float64))
    outer = np.einsum("n,ni,nj->nij", along - across, ray, ray)
    outer[:, [0, 1, 2], [0, 1, 2]] += across[:, None]
    return np.asarray(outer, np.float32)
