"""Rocks: size distribution, shapes and positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.config import RockConfig
from sfr_loc_map.simulation.mesh import Mesh, cell_size, coarseness, path_distance
from sfr_loc_map.simulation.terrain import Terrain

CLASS_RATIO = 1.35
"""Ratio of the diameters that bound one size class."""
RANGE_PER_DIAMETER = 180.0
"""Rocks are placed as far from the path as this many of their diameters; farther ones would be under a few pixels."""
FARTHEST_M = 350.0
SHAPES = 24
LEVEL_PIXELS = (14.0, 48.0, 200.0)
"""Apparent sizes, in pixels of an 800 px lens, from which a finer shape is used."""
LENS_PX = 800.0


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Placed rocks.

    Attributes:
        centres: `(N, 3)` float64, metres, DS; the height is that of the ground.
        diameters: `(N,)` float64, metres.
        distances: `(N,)` float64, metres from the path.
        pixels: `(N,)` float64, apparent size from the nearest point of the path; decides how fine the shape is.
    """

    centres: FloatArray
    diameters: FloatArray
    distances: FloatArray
    pixels: FloatArray


def rocks_per_area(diameter_m: FloatArray, cover: float) -> FloatArray:
    """Return the number of rocks per square metre with at least a diameter.

    From the cumulative fractional area `F(D) = k exp(-q D)`, `q = 1.79 + 0.152 / k` (Golombek and Rapp 1997, equation
    for total rock abundance k): `dN = -dF / (pi D^2 / 4)`, integrated up to 5 m by quadrature.
    """
    q = 1.79 + 0.152 / cover
    grid = np.geomspace(0.005, 5.0, 4000)
    density = cover * q * np.exp(-q * grid) / (0.25 * np.pi * grid**2)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(grid)
    above = np.concatenate((np.cumsum(steps[::-1])[::-1], [0.0]))
    return np.asarray(np.interp(diameter_m, grid, above))


def place_rocks(seed: int, config: RockConfig, terrain: Terrain, path: FloatArray, half_width_m: float) -> Rocks:
    """Scatter rocks around a path, large ones as far as they can be seen.

    Args:
        seed: Seed of the data set.
        config: Numbers and sizes.
        terrain: The ground.
        path: `(P, 2)` metres, DS.
        half_width_m: Half of the width that the rover needs free of large rocks.
    """
    rng = np.random.default_rng([seed, 2])
    parts = [np.zeros((0, 3))]
    low = config.smallest_m
    while low < config.largest_m and config.cover > 0:
        high = min(low * CLASS_RATIO, config.largest_m)
        parts.append(_scatter(rng, config, path, low, high))
        low *= CLASS_RATIO
    found = np.concatenate(parts)
    x, y, diameters = np.ascontiguousarray(found[:, 0]), np.ascontiguousarray(found[:, 1]), found[:, 2]
    distances = path_distance(x, y, path)
    free = (diameters < config.clear_m) | (distances > half_width_m + 0.6 * diameters)
    x, y, diameters, distances = x[free], y[free], diameters[free], distances[free]
    z = terrain.height(x, y, cell_size(terrain, distances, path))
    pixels = LENS_PX / coarseness(terrain, path) * diameters / np.maximum(distances, 0.8)
    return Rocks(np.column_stack((x, y, z)), diameters, distances, pixels)


def rock_mesh(seed: int, config: RockConfig, rocks: Rocks) -> Mesh:
    """Return the triangles of placed rocks."""
    rng = np.random.default_rng([seed, 3])
    count = len(rocks.diameters)
    rotations = _random_rotations(rng, count)
    shapes = rng.integers(0, SHAPES, count)
    axes = np.column_stack((np.ones(count), rng.uniform(0.6, 1.0, count), rng.uniform(0.4, 0.85, count)))
    sunk = np.clip(rng.normal(config.buried, 0.15, count), 0.05, 0.85)
    levels = 1 + np.searchsorted(LEVEL_PIXELS, rocks.pixels)
    parts = []
    for level in range(1, len(LEVEL_PIXELS) + 2):
        library = _library(seed, config.angular, level)
        for shape in range(SHAPES):
            which = np.flatnonzero((levels == level) & (shapes == shape))
            if len(which):
                parts.append(_instances(library[shape], rocks, which, rotations, axes, sunk))
    empty = Mesh(
        np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros(0, np.int32)
    )
    return Mesh.join(parts) if parts else empty


def _scatter(rng: np.random.Generator, config: RockConfig, path: FloatArray, low: float, high: float) -> FloatArray:
    """Return the rocks `(N, 3)`: x, y, diameter of one size class; they thin out towards their largest distance."""
    reach = min(RANGE_PER_DIAMETER * low, FARTHEST_M)
    corner, size = path.min(axis=0) - reach, np.ptp(path, axis=0) + 2 * reach
    numbers = rocks_per_area(np.array([low, high]), config.cover)
    count = rng.poisson((numbers[0] - numbers[1]) * size[0] * size[1])
    position = corner + rng.random((count, 2)) * size
    diameter = 1.0 / (1.0 / low - rng.random(count) * (1.0 / low - 1.0 / high))
    distance = path_distance(np.ascontiguousarray(position[:, 0]), np.ascontiguousarray(position[:, 1]), path)
    kept = distance < reach * (0.6 + 0.4 * rng.random(count))
    return np.asarray(np.column_stack((position, diameter))[kept])


def _instances(
    shape: tuple[FloatArray, FloatArray, NDArray[np.int32]],
    rocks: Rocks,
    which: NDArray[np.intp],
    rotations: FloatArray,
    axes: FloatArray,
    sunk: FloatArray,
) -> Mesh:
    points, normals, triangles = shape
    half = 0.5 * rocks.diameters[which]
    scaled = points[None] * axes[which][:, None]
    rotated = np.einsum("nij,nvj->nvi", rotations[which], scaled)
    tilted = normals[None] / axes[which][:, None]
    tilted = np.einsum("nij,nvj->nvi", rotations[which], tilted)
    tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
    top, bottom = rotated[..., 2].max(axis=1), rotated[..., 2].min(axis=1)
    lift = half * -(bottom * (1 - sunk[which]) + top * sunk[which])
    vertices = rotated * half[:, None, None] + rocks.centres[which][:, None]
    vertices[..., 2] += lift[:, None]
    starts = (np.arange(len(which), dtype=np.int32) * len(points))[:, None, None]
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        tilted.reshape(-1, 3).astype(np.float32),
        (triangles[None] + starts).reshape(-1, 3).astype(np.int32),
        np.repeat(which.astype(np.int32), len(triangles)),
    )


def _random_rotations(rng: np.random.Generator, count: int) -> FloatArray:
    """Return rotations `(N, 3, 3)`: any heading, tilted by some 15 degrees, as rocks rest on flat sides."""
    heading = rng.uniform(0, 2 * np.pi, count)
    tilt = rng.normal(0, 0.26, (count, 2))
    c, s = np.cos(heading), np.sin(heading)
    zero, one = np.zeros(count), np.ones(count)
    about_z = np.stack((np.stack((c, -s, zero), -1), np.stack((s, c, zero), -1), np.stack((zero, zero, one), -1)), -2)
    cx, sx, cy, sy = np.cos(tilt[:, 0]), np.sin(tilt[:, 0]), np.cos(tilt[:, 1]), np.sin(tilt[:, 1])
    about_x = np.stack(
        (np.stack((one, zero, zero), -1), np.stack((zero, cx, -sx), -1), np.stack((zero, sx, cx), -1)), -2
    )
    about_y = np.stack(
        (np.stack((cy, zero, sy), -1), np.stack((zero, one, zero), -1), np.stack((-sy, zero, cy), -1)), -2
    )
    return np.asarray(about_x @ about_y @ about_z)


def _library(seed: int, angular: float, level: int) -> list[tuple[FloatArray, FloatArray, NDArray[np.int32]]]:
    """Return shapes as points, normals, triangles; the same shapes at every level."""
    directions, triangles = _sphere(level)
    shapes = []
    for number in range(SHAPES):
        rng = np.random.default_rng([seed, 4, number])
        points = directions * _radius(rng, directions, angular)[:, None]
        points /= np.linalg.norm(points, axis=1).max()
        corners = points[triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(points)
        for k in range(3):
            np.add.at(normals, triangles[:, k], face)
        shapes.append((points, normals / np.linalg.norm(normals, axis=1, keepdims=True), triangles))
    return shapes


def _radius(rng: np.random.Generator, directions: FloatArray, angular: float) -> FloatArray:
    """Return the radius of a rock in each direction: a ball cut by planes, with lumps."""
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
    return np.asarray(radius)


def _sphere(level: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return an icosahedron whose triangles were split in four `level` times, on the unit ball."""
    g = (1 + 5**0.5) / 2
    points: list[tuple[float, float, float]] = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    points += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = "0b5051017 07a0ab159 5b4ba2a76 718394342 326368389 49524b62a 867981"
    numbers = [int(digit, 16) for digit in faces.replace(" ", "")]
    vertices = np.array(points, dtype=np.float64)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    triangles = np.array(numbers, dtype=np.int32).reshape(-1, 3)
    for _ in range(level):
        vertices, triangles = _split(vertices, triangles)
    return vertices, triangles


def _split(vertices: FloatArray, triangles: NDArray[np.int32]) -> tuple[FloatArray, NDArray[np.int32]]:
    edges = np.sort(np.concatenate((triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]])), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (inverse.reshape(3, -1) + len(vertices)).astype(np.int32)
    a, b, c = triangles.T
    parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
    return np.concatenate((vertices, middle)), np.concatenate([np.stack(p, axis=1) for p in parts])
