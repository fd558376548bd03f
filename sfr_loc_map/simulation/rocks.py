"""Size distribution, shapes and positions of rocks.

Lengths are in metres, positions in DS. The page docs/simulation.md states the source of each number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.config import RockConfig
from sfr_loc_map.simulation.ground_mesh import Mesh, cell_size, coarseness, path_distance
from sfr_loc_map.simulation.noise import Stream
from sfr_loc_map.simulation.terrain import Terrain

CLASS_RATIO = 1.35  #: Ratio of the largest to the smallest diameter of a size class.
RANGE_PER_DIAMETER = 180.0
"""Rocks are placed up to this many diameters from the path; farther rocks would be smaller than about 4 px."""
FARTHEST_M = 350.0  #: Largest distance of a rock from the path, m; the ground extends 512 m from its centre.
SHAPES = 24  #: Number of rock shapes per level of detail; all rocks are scaled and rotated copies.
LEVEL_PIXELS = (14.0, 48.0, 200.0)
"""Apparent sizes at which the next finer shape begins, px at a focal length of `LENS_PX`."""
ICOSAHEDRON = (
    (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
    (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11),
    (6, 2, 10), (8, 6, 7), (9, 8, 1),
)  # fmt: skip
"""Faces of an icosahedron as indices of the points of `_sphere`, counter-clockwise from outside."""
LENS_PX = 800.0  #: Focal length for apparent sizes, px; about that of the mapping cameras.


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Placed rocks."""

    centres: FloatArray  #: `(N, 3)` float64, metres, DS; z is the height of the ground.
    diameters: FloatArray  #: `(N,)` float64, metres.
    #: `(N,)` float64, apparent size from the nearest point of the path, px; determines the level of detail.
    pixels: FloatArray


def rocks_per_area(diameter_m: FloatArray, cover: float) -> FloatArray:
    """Return the number of rocks per square metre that have at least the given diameters.

    The cumulative fractional area is `F(D) = k exp(-q D)` with `q = 1.79 + 0.152 / k`, where k is the total rock
    abundance (Golombek and Rapp 1997). The number follows from `dN = -dF / (pi D^2 / 4)`, integrated up to 5 m by
    quadrature.
    """
    q = 1.79 + 0.152 / cover
    grid = np.geomspace(0.005, 5.0, 4000)
    density = cover * q * np.exp(-q * grid) / (0.25 * np.pi * grid**2)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(grid)
    above = np.concatenate((np.cumsum(steps[::-1])[::-1], [0.0]))
    return np.asarray(np.interp(diameter_m, grid, above))


def place_rocks(seed: int, config: RockConfig, terrain: Terrain, path: FloatArray, half_width_m: float) -> Rocks:
    """Place rocks around a path, up to the distance at which rocks of their size are visible."""
    rng = np.random.default_rng([seed, Stream.ROCK_PLACES])
    parts = [np.zeros((0, 3))]
    low = config.smallest_m
    while low < config.largest_m and config.cover > 0:
        high = min(low * CLASS_RATIO, config.largest_m)
        parts.append(_scatter_rocks(rng, config, path, low, high))
        low *= CLASS_RATIO
    found = np.concatenate(parts)
    distances = path_distance(found[:, :2], path)
    free = (found[:, 2] < config.clear_m) | (distances > half_width_m + 0.6 * found[:, 2])
    (x, y, diameters), distances = np.ascontiguousarray(found[free].T), distances[free]
    z = terrain.height(x, y, cell_size(terrain, distances, path))
    pixels = LENS_PX / coarseness(terrain, path) * diameters / np.maximum(distances, 0.8)
    return Rocks(np.column_stack((x, y, z)), diameters, pixels)


def rock_meshes(seed: int, config: RockConfig, rocks: Rocks) -> list[Mesh]:
    """Return the meshes of placed rocks, one mesh for each shape and level of detail.

    The width of a rock is 60 to 100 % and the height 40 to 85 % of the length. This covers the axis ratios of impact
    fragments (Capaccioni et al. 1984: 1 to 0.7 to 0.5 on average).
    """
    rng = np.random.default_rng([seed, Stream.ROCK_POSES])
    count = len(rocks.diameters)
    # any heading; tilts of 15 deg (1 sigma), because rocks rest on flat sides
    heading = rng.uniform(0, 2 * np.pi, count)
    tilt = rng.normal(0, 0.26, (count, 2))
    about = np.tile(np.eye(3), (3, count, 1, 1))
    for axis, angle in enumerate((*tilt.T, heading)):
        p, q = (axis + 1) % 3, (axis + 2) % 3
        about[axis, :, p, p] = about[axis, :, q, q] = np.cos(angle)
        about[axis, :, q, p] = np.sin(angle)
        about[axis, :, p, q] = -about[axis, :, q, p]
    rotations = about[0] @ about[1] @ about[2]
    shapes = rng.integers(0, SHAPES, count)
    axes = np.column_stack((np.ones(count), rng.uniform(0.6, 1.0, count), rng.uniform(0.4, 0.85, count)))
    sunk = np.clip(rng.normal(config.buried, 0.15, count), 0.05, 0.85)
    levels = 1 + np.searchsorted(LEVEL_PIXELS, rocks.pixels)
    parts = []
    for level in np.unique(levels).tolist():
        library = _library(seed, config.angular, level)
        for shape in range(SHAPES):
            which = np.flatnonzero((levels == level) & (shapes == shape))
            if not len(which):
                continue
            points, normals, triangles = library[shape]
            half, buried = 0.5 * rocks.diameters[which], sunk[which]
            rotated = np.einsum("nij,nvj->nvi", rotations[which], points[None] * axes[which][:, None])
            tilted = np.einsum("nij,nvj->nvi", rotations[which], normals[None] / axes[which][:, None])
            tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
            top, bottom = rotated[..., 2].max(axis=1), rotated[..., 2].min(axis=1)
            vertices = rotated * half[:, None, None] + rocks.centres[which][:, None]
            vertices[..., 2] += (half * -(bottom * (1 - buried) + top * buried))[:, None]
            starts = (np.arange(len(which), dtype=np.int32) * len(points))[:, None, None]
            part = Mesh(
                vertices.reshape(-1, 3).astype(np.float32),
                tilted.reshape(-1, 3).astype(np.float32),
                (triangles[None] + starts).reshape(-1, 3).astype(np.int32),
                np.repeat(which.astype(np.int32), len(triangles)),
            )
            parts.append(part)
    return parts


def _scatter_rocks(
    rng: np.random.Generator, config: RockConfig, path: FloatArray, low: float, high: float
) -> FloatArray:
    """Return x, y and diameter of the rocks of a size class, `(N, 3)`; their density decreases with the distance."""
    reach = min(RANGE_PER_DIAMETER * low, FARTHEST_M)
    corner, size = path.min(axis=0) - reach, np.ptp(path, axis=0) + 2 * reach
    numbers = rocks_per_area(np.array([low, high]), config.cover)
    count = rng.poisson((numbers[0] - numbers[1]) * size[0] * size[1])
    position = corner + rng.random((count, 2)) * size
    diameter = 1.0 / (1.0 / low - rng.random(count) * (1.0 / low - 1.0 / high))
    kept = path_distance(position, path) < reach * (0.6 + 0.4 * rng.random(count))
    return np.asarray(np.column_stack((position, diameter))[kept])


def _library(seed: int, angular: float, level: int) -> list[tuple[FloatArray, FloatArray, NDArray[np.int32]]]:
    """Return the shapes as points, normals and triangles; every level has the same shapes.

    A shape is a ball that is cut by 7 to 13 planes, with bumps in three octaves. The numbers were chosen by comparison
    with images of Mars rovers.
    """
    directions, triangles = _sphere(level)
    shapes = []
    for number in range(SHAPES):
        rng = np.random.default_rng([seed, Stream.ROCK_SHAPES, number])
        planes = int(rng.integers(7, 14))
        sides = rng.normal(size=(planes, 3))
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        depth = rng.uniform(0.45, 0.9, planes)
        cut = depth / np.maximum(directions @ sides.T, 1e-3)
        sharpness = 4.0 + 26.0 * angular
        radius = np.concatenate((cut, np.full((len(directions), 1), 1.0)), axis=1)
        radius = np.power(np.power(radius, -sharpness).sum(axis=1), -1.0 / sharpness)
        for scale, height in ((1.7, 0.10), (3.9, 0.05), (8.3, 0.025)):
            waves, shift = rng.normal(scale=scale, size=(6, 3)), rng.uniform(0, 2 * np.pi, 6)
            radius = radius * (1.0 + height * np.sin(directions @ waves.T + shift).mean(axis=1) * 2.0)
        points = directions * radius[:, None]
        points /= np.linalg.norm(points, axis=1).max()
        corners = points[triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(points)
        for k in range(3):
            np.add.at(normals, triangles[:, k], face)
        shapes.append((points, normals / np.linalg.norm(normals, axis=1, keepdims=True), triangles))
    return shapes


def _sphere(level: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return points and triangles of a unit icosahedron after `level` subdivisions of each triangle into four."""
    g = (1 + 5**0.5) / 2
    points: list[tuple[float, float, float]] = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    points += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    vertices = np.array(points, dtype=np.float64)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    triangles = np.array(ICOSAHEDRON, dtype=np.int32)
    for _ in range(level):
        edges = np.sort(np.concatenate((triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]])), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (inverse.reshape(3, -1) + len(vertices)).astype(np.int32)
        a, b, c = triangles.T
        parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
        vertices = np.concatenate((vertices, middle))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return vertices, triangles
