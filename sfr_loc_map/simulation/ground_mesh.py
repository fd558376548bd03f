"""The triangle mesh of the ground, which is finer near the path of the rover."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.terrain import Terrain

CELLS = 32  #: Number of cells along the edge of a tile; a power of two.
ROOT_M = 1024.0  #: Edge of the ground, m; a power of two, so that every vertex is exact in binary.
FINEST_M = ROOT_M / CELLS / 2**11  #: Smallest cell: 15.6 mm.
CELL_PER_DISTANCE = 0.014
"""Ratio of the edge of a cell to its distance from the path: an edge is about 5 px long in the localisation cameras."""
FULL_DETAIL_POINTS = 40  #: Maximum number of path points, 0.3 m apart, at full detail; longer paths have larger cells.


class Mesh(NamedTuple):
    """Triangles with smooth normals."""

    vertices: NDArray[np.float32]  #: `(V, 3)` float32, metres, DS.
    normals: NDArray[np.float32]  #: `(V, 3)` float32, unit vectors, outwards.
    triangles: NDArray[np.int32]  #: `(T, 3)` int32, vertex indices.
    objects: NDArray[np.int32]  #: `(T,)` int32, -1 for the ground, else the number of the rock.

    @staticmethod
    def join(parts: list[Mesh]) -> Mesh:
        """Return one mesh with the triangles of all parts."""
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        return Mesh(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.triangles + np.int32(s) for part, s in zip(parts, starts, strict=True)]),
            np.concatenate([part.objects for part in parts]),
        )


def path_distance(xy: FloatArray, path: FloatArray) -> FloatArray:
    """Return the distances of positions `(N, 2)` from the nearest point of a path `(P, 2)`, metres."""
    return np.asarray(KDTree(path).query(xy)[0])


def cell_size(terrain: Terrain, distance_m: FloatArray, path: FloatArray) -> FloatArray:
    """Return the largest allowed cell size at distances from a path, metres."""
    return np.asarray(coarseness(terrain, path) * np.maximum(FINEST_M, CELL_PER_DISTANCE * distance_m))


def coarseness(terrain: Terrain, path: FloatArray) -> float:
    """Return the factor on all cell sizes: the configured factor, increased for long paths to bound memory."""
    return terrain.coarseness * float(max(1.0, (len(path) / FULL_DETAIL_POINTS) ** 0.5))


def ground_mesh(terrain: Terrain, path: FloatArray) -> Mesh:
    """Return the mesh of the ground around rover positions `(P, 2)`, metres, DS.

    The ground is a quadtree of square tiles with `CELLS` x `CELLS` cells each, whose cells are smaller near the path.
    """
    corner = np.floor(0.5 * (path.min(axis=0) + path.max(axis=0))) - 0.5 * ROOT_M
    tiles = _tiles(terrain, path, corner)
    known = set(tiles)
    side = np.arange(-1, CELLS + 2)  # the vertices of a tile, and one more on either side for the normals
    columns, rows = np.meshgrid(side, side, indexing="ij")
    vertices = np.empty((len(tiles), CELLS + 1, CELLS + 1, 3), np.float32)
    normals = np.empty_like(vertices)
    for n, (level, i, j) in enumerate(tiles):
        cell = ROOT_M / 2**level / CELLS
        x = corner[0] + (i * CELLS + columns.ravel()) * cell
        y = corner[1] + (j * CELLS + rows.ravel()) * cell
        spacing = cell_size(terrain, path_distance(np.column_stack((x, y)), path), path)
        z = terrain.height(x, y, spacing).reshape(columns.shape)
        normals[n] = _normals(z, cell)
        inner = z[1:-1, 1:-1].copy()
        _stitch(inner, known, level, i, j)
        vertices[n, ..., 0] = x.reshape(columns.shape)[1:-1, 1:-1]
        vertices[n, ..., 1] = y.reshape(columns.shape)[1:-1, 1:-1]
        vertices[n, ..., 2] = inner
    per_tile = np.int32((CELLS + 1) ** 2)
    starts = np.arange(len(tiles), dtype=np.int32)[:, None, None] * per_tile
    triangles = (_triangles_of_tile()[None] + starts).reshape(-1, 3)
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles, np.full(len(triangles), -1, np.int32))


def _tiles(terrain: Terrain, path: FloatArray, corner: FloatArray) -> list[tuple[int, int, int]]:
    """Return the tiles `(level, i, j)` whose cells are small enough for their distance from the path.

    A tile of a level is the tile i along x and j along y, counted from the corner `(2,)` of the ground, metres, DS.
    """
    tiles: list[tuple[int, int, int]] = []
    level = 0
    todo = np.zeros((1, 2), np.int64)
    quarters = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    while len(todo):
        size = ROOT_M / 2**level
        low = corner + todo * size
        gap = np.maximum(np.maximum(low[:, None] - path[None], path[None] - low[:, None] - size), 0.0)
        distance = np.sqrt(np.square(gap).sum(axis=2).min(axis=1))
        is_split = size / CELLS > cell_size(terrain, distance, path)
        tiles += [(level, int(i), int(j)) for i, j in todo[~is_split]]
        todo = (2 * todo[is_split][:, None] + quarters[None]).reshape(-1, 2)
        level += 1
    return tiles


def _normals(z: FloatArray, cell_m: float) -> FloatArray:
    """Return the unit normals `(CELLS + 1, CELLS + 1, 3)` of heights with one more vertex on either side."""
    normal = np.stack(
        (
            (z[:-2, 1:-1] - z[2:, 1:-1]) / (2 * cell_m),
            (z[1:-1, :-2] - z[1:-1, 2:]) / (2 * cell_m),
            np.ones((CELLS + 1, CELLS + 1)),
        ),
        axis=-1,
    )
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def _triangles_of_tile() -> NDArray[np.int32]:
    """Return the triangles of a tile `(T, 3)` as indices of its vertices, two for each cell."""
    index = np.arange((CELLS + 1) ** 2, dtype=np.int32).reshape(CELLS + 1, CELLS + 1)
    a = index[:-1, :-1].ravel()
    b = index[1:, :-1].ravel()
    c = index[1:, 1:].ravel()
    d = index[:-1, 1:].ravel()
    return np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))


def _stitch(z: FloatArray, known: set[tuple[int, int, int]], level: int, i: int, j: int) -> None:
    """Interpolate the edge vertices linearly where the neighbouring tile is coarser, so that no gaps remain."""
    for di, dj, edge in ((-1, 0, z[0, :]), (1, 0, z[-1, :]), (0, -1, z[:, 0]), (0, 1, z[:, -1])):
        beside = ((level - up, (i + di) >> up, (j + dj) >> up) for up in range(level + 1))
        step = min(2 ** next((up for up, tile in enumerate(beside) if tile in known), 0), CELLS)
        index = np.arange(CELLS + 1)
        edge[:] = np.interp(index, index[::step], edge[::step])
