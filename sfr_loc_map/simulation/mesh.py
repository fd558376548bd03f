"""The ground as triangles, fine near the rover's path and coarse far away, without cracks.

Square tiles of a quadtree; the edge of a tile beside a coarser one follows the coarser one's straight edges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.simulation.terrain import Terrain

CELLS = 32
"""Cells along the edge of a tile; a power of two."""
ROOT_M = 1024.0
"""Edge of the ground; a power of two keeps every vertex exact in binary."""
FINEST_M = ROOT_M / CELLS / 2**11
"""Smallest cell: 15.6 mm."""
CELL_PER_DISTANCE = 0.014
"""Edge of a cell over its distance from the path, about five pixels of the localisation cameras."""
FULL_DETAIL_POINTS = 40
"""Points of a path (some 0.3 m apart) up to which the cells are as small as above."""


class Mesh(NamedTuple):
    """Triangles with smooth normals.

    Attributes:
        vertices: `(V, 3)` float32, metres, DS.
        normals: `(V, 3)` float32, unit, outwards.
        triangles: `(T, 3)` int32, indices of vertices.
        objects: `(T,)` int32, -1 for the ground, else the number of the rock.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    objects: NDArray[np.int32]

    @staticmethod
    def join(parts: list[Mesh]) -> Mesh:
        """Return one mesh with the triangles of all."""
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        return Mesh(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.triangles + np.int32(s) for part, s in zip(parts, starts, strict=True)]),
            np.concatenate([part.objects for part in parts]),
        )


def ground_mesh(terrain: Terrain, path: FloatArray) -> Mesh:
    """Return the ground around a path.

    Args:
        terrain: The ground.
        path: `(P, 2)` metres, DS, positions of the rover.
    """
    corner = np.floor(0.5 * (path.min(axis=0) + path.max(axis=0))) - 0.5 * ROOT_M
    leaves = _leaves(terrain, corner, path)
    return _tiles(terrain, corner, leaves, path)


@jit
def path_distance(x: FloatArray, y: FloatArray, path: FloatArray) -> FloatArray:
    """Return the distance of positions `(N,)` from the nearest point of a path `(P, 2)`, metres."""
    out = np.empty(len(x))
    for i in range(len(x)):
        best = 1e30
        for k in range(len(path)):
            dx, dy = x[i] - path[k, 0], y[i] - path[k, 1]
            best = min(best, dx * dx + dy * dy)
        out[i] = np.sqrt(best)
    return out


def cell_size(terrain: Terrain, distance_m: FloatArray, path: FloatArray) -> FloatArray:
    """Return the largest cell allowed at distances from a path, metres."""
    return np.asarray(coarseness(terrain, path) * np.maximum(FINEST_M, CELL_PER_DISTANCE * distance_m))


def coarseness(terrain: Terrain, path: FloatArray) -> float:
    """Return how much coarser everything is: as configured, and along a long path, to bound memory."""
    return terrain.coarseness * float(max(1.0, (len(path) / FULL_DETAIL_POINTS) ** 0.5))


def _leaves(terrain: Terrain, corner: FloatArray, path: FloatArray) -> list[tuple[int, int, int]]:
    """Return the tiles `(level, i, j)` whose cells are small enough for their distance from the path."""
    done: list[tuple[int, int, int]] = []
    level, todo = 0, np.zeros((1, 2), np.int64)
    while len(todo):
        size = ROOT_M / 2**level
        low = corner + todo * size
        gap = np.maximum(np.maximum(low[:, None] - path[None], path[None] - low[:, None] - size), 0.0)
        distance = np.sqrt(np.square(gap).sum(axis=2).min(axis=1))
        split = size / CELLS > cell_size(terrain, distance, path)
        done += [(level, int(i), int(j)) for i, j in todo[~split]]
        steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        todo = (2 * todo[split][:, None] + steps[None]).reshape(-1, 2)
        level += 1
    return done


def _tiles(terrain: Terrain, corner: FloatArray, leaves: list[tuple[int, int, int]], path: FloatArray) -> Mesh:
    known = set(leaves)
    side = np.arange(-1, CELLS + 2)
    ii, jj = np.meshgrid(side, side, indexing="ij")
    quads = _grid_triangles()
    count = (CELLS + 1) ** 2
    vertices = np.empty((len(leaves), CELLS + 1, CELLS + 1, 3), np.float32)
    normals = np.empty_like(vertices)
    for n, (level, i, j) in enumerate(leaves):
        cell = ROOT_M / 2**level / CELLS
        x = corner[0] + (i * CELLS + ii.ravel()) * cell
        y = corner[1] + (j * CELLS + jj.ravel()) * cell
        spacing = cell_size(terrain, path_distance(x, y, path), path)
        z = terrain.height(x, y, spacing).reshape(ii.shape)
        normal = np.stack(
            (
                (z[:-2, 1:-1] - z[2:, 1:-1]) / (2 * cell),
                (z[1:-1, :-2] - z[1:-1, 2:]) / (2 * cell),
                np.ones((CELLS + 1, CELLS + 1)),
            ),
            axis=-1,
        )
        normals[n] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        inner = z[1:-1, 1:-1].copy()
        _stitch(inner, known, level, i, j)
        vertices[n, ..., 0] = x.reshape(ii.shape)[1:-1, 1:-1]
        vertices[n, ..., 1] = y.reshape(ii.shape)[1:-1, 1:-1]
        vertices[n, ..., 2] = inner
    starts = np.arange(len(leaves), dtype=np.int32)[:, None, None] * np.int32(count)
    triangles = (quads[None] + starts).reshape(-1, 3)
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles, np.full(len(triangles), -1, np.int32))


def _grid_triangles() -> NDArray[np.int32]:
    index = np.arange((CELLS + 1) ** 2, dtype=np.int32).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))


def _stitch(z: FloatArray, known: set[tuple[int, int, int]], level: int, i: int, j: int) -> None:
    """Straighten the edges that a coarser tile shares."""
    edges = ((-1, 0, z[0, :]), (1, 0, z[-1, :]), (0, -1, z[:, 0]), (0, 1, z[:, -1]))
    for di, dj, edge in edges:
        up = _levels_up(known, level, i + di, j + dj)
        if up > 0:
            step = min(2**up, CELLS)
            index = np.arange(CELLS + 1)
            edge[:] = np.interp(index, index[::step], edge[::step])


def _levels_up(known: set[tuple[int, int, int]], level: int, i: int, j: int) -> int:
    """Return how many levels coarser the tile that covers `(level, i, j)` is; 0 if it is not coarser."""
    for up in range(level + 1):
        if (level - up, i >> up, j >> up) in known:
            return up
    return 0
