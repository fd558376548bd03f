"""Size distribution, shapes and positions of rocks.

Lengths are in metres, positions in DS. The page docs/simulation.md states the source of each number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
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
NEAREST_M = 0.8  #: Lower bound of the distance for apparent sizes, m: about the height of the cameras.
CLEAR_DIAMETERS = 0.6  #: Distance of the centre of a rock from the path, diameters: half a diameter and a margin.
TILT_RAD = 0.26  #: Standard deviation of the tilt about x and about y, rad: 15 deg, because rocks rest on flat sides.
WIDTHS = (0.6, 1.0)  #: Smallest and largest ratio of the width of a rock to its length.
HEIGHTS = (0.4, 0.85)  #: Smallest and largest ratio of the height of a rock to its length.
BURIED_SPREAD = 0.15  #: Standard deviation of the buried fraction of a rock's height.
BURIED_LIMITS = (0.05, 0.85)  #: Smallest and largest buried fraction: rocks neither float nor vanish.
LARGEST_DIAMETER_M = 5.0  #: Upper limit of the integral over diameters, m.
SMALLEST_DIAMETER_M = 0.005  #: Lower limit of the diameters of the integral, m.
QUADRATURE_POINTS = 4000  #: Number of diameters of the quadrature.
BLENDED_CUTS = (4.0, 30.0)
"""Exponents that blend the cuts of a rounded and of an angular rock. A larger exponent gives sharper edges."""
LUMPS = ((1.7, 0.10), (3.9, 0.05), (8.3, 0.025))
"""Octaves of the lumps on a rock: standard deviation of the wave numbers, 1 / radius, and height, radii."""
LUMP_WAVES = 6  #: Number of waves of an octave of the lumps.


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Placed rocks."""

    centres: FloatArray  #: `(N, 3)` float64, metres, DS; z is the height of the ground.
    diameters: FloatArray  #: `(N,)` float64, metres.
    #: `(N,)` float64, apparent size from the nearest point of the path, px; determines the level of detail.
    pixels: FloatArray


class RockShape(NamedTuple):
    """The shape of a rock: triangles of a ball of radius 1 with cuts and lumps."""

    points: FloatArray  #: `(V, 3)` float64, radii.
    normals: FloatArray  #: `(V, 3)` float64, unit vectors, outwards.
    triangles: NDArray[np.int32]  #: `(T, 3)`, vertex indices.


def rocks_per_area(diameter_m: FloatArray, cover: float) -> FloatArray:
    """Return the number of rocks per square metre that have at least the given diameters.

    The cumulative fractional area is `F(D) = k exp(-q D)` with `q = 1.79 + 0.152 / k`, where k is the total rock
    abundance (Golombek and Rapp 1997). The number follows from `dN = -dF / (pi D^2 / 4)`, integrated up to
    `LARGEST_DIAMETER_M` by quadrature.
    """
    q = 1.79 + 0.152 / cover
    grid = np.geomspace(SMALLEST_DIAMETER_M, LARGEST_DIAMETER_M, QUADRATURE_POINTS)
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
    is_small = found[:, 2] < config.clear_m
    is_beside_path = distances > half_width_m + CLEAR_DIAMETERS * found[:, 2]
    kept = is_small | is_beside_path
    x, y, diameters = np.ascontiguousarray(found[kept].T)
    distances = distances[kept]
    z = terrain.height(x, y, cell_size(terrain, distances, path))
    pixels = LENS_PX / coarseness(terrain, path) * diameters / np.maximum(distances, NEAREST_M)
    return Rocks(np.column_stack((x, y, z)), diameters, pixels)


def rock_meshes(seed: int, config: RockConfig, rocks: Rocks) -> list[Mesh]:
    """Return the meshes of placed rocks, one mesh for each shape and level of detail.

    `WIDTHS` and `HEIGHTS` span the axis ratios of impact fragments (Capaccioni et al. 1984: 1 to 0.7 to 0.5 on
    average). A rock has any heading.
    """
    rng = np.random.default_rng([seed, Stream.ROCK_POSES])
    count = len(rocks.diameters)
    heading = rng.uniform(0, 2 * np.pi, count)
    tilt = rng.normal(0, TILT_RAD, (count, 2))
    about = np.tile(np.eye(3), (3, count, 1, 1))
    for axis, angle in enumerate((*tilt.T, heading)):
        p = (axis + 1) % 3
        q = (axis + 2) % 3
        about[axis, :, p, p] = np.cos(angle)
        about[axis, :, q, q] = np.cos(angle)
        about[axis, :, q, p] = np.sin(angle)
        about[axis, :, p, q] = -about[axis, :, q, p]
    rotations = about[0] @ about[1] @ about[2]
    shapes = rng.integers(0, SHAPES, count)
    axes = np.column_stack((np.ones(count), rng.uniform(*WIDTHS, count), rng.uniform(*HEIGHTS, count)))
    buried = np.clip(rng.normal(config.buried, BURIED_SPREAD, count), *BURIED_LIMITS)
    levels = 1 + np.searchsorted(LEVEL_PIXELS, rocks.pixels)
    parts = []
    for level in np.unique(levels).tolist():
        library = _library(seed, config.angular, level)
        for number, shape in enumerate(library):
            which = np.flatnonzero((levels == level) & (shapes == number))
            if len(which):
                parts.append(_copies(shape, rocks, which, rotations[which], axes[which], buried[which]))
    return parts


def _copies(
    shape: RockShape, rocks: Rocks, which: IntArray, rotations: FloatArray, axes: FloatArray, buried: FloatArray
) -> Mesh:
    """Return the mesh of the rocks `which` `(N,)` with one shape.

    The shape is scaled along its axes `(N, 3)` and to the diameter of the rock, rotated `(N, 3, 3)`, and lowered so
    that the buried fraction `(N,)` of its height is below the ground at its centre.
    """
    half = 0.5 * rocks.diameters[which]
    points = np.einsum("nij,nvj->nvi", rotations, shape.points[None] * axes[:, None])
    normals = np.einsum("nij,nvj->nvi", rotations, shape.normals[None] / axes[:, None])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    top = points[..., 2].max(axis=1)
    bottom = points[..., 2].min(axis=1)
    vertices = points * half[:, None, None] + rocks.centres[which][:, None]
    vertices[..., 2] += (half * -(bottom * (1 - buried) + top * buried))[:, None]
    starts = (np.arange(len(which), dtype=np.int32) * len(shape.points))[:, None, None]
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        normals.reshape(-1, 3).astype(np.float32),
        (shape.triangles[None] + starts).reshape(-1, 3).astype(np.int32),
        np.repeat(which.astype(np.int32), len(shape.triangles)),
    )


def _scatter_rocks(
    rng: np.random.Generator, config: RockConfig, path: FloatArray, low: float, high: float
) -> FloatArray:
    """Return x, y and diameter of the rocks of a size class, `(N, 3)`; their density decreases with the distance."""
    reach = min(RANGE_PER_DIAMETER * low, FARTHEST_M)
    corner = path.min(axis=0) - reach
    size = np.ptp(path, axis=0) + 2 * reach
    numbers = rocks_per_area(np.array([low, high]), config.cover)
    count = rng.poisson((numbers[0] - numbers[1]) * size[0] * size[1])
    position = corner + rng.random((count, 2)) * size
    diameter = 1.0 / (1.0 / low - rng.random(count) * (1.0 / low - 1.0 / high))
    kept = path_distance(position, path) < reach * (0.6 + 0.4 * rng.random(count))
    return np.asarray(np.column_stack((position, diameter))[kept])


def _library(seed: int, angular: float, level: int) -> list[RockShape]:
    """Return the shapes of a level of detail; every level has the same shapes.

    A shape is a ball that is cut by 7 to 13 planes, with lumps in three octaves. The numbers were chosen by comparison
    with images of Mars rovers.
    """
    directions, triangles = _sphere(level)
    rounded, sharp = BLENDED_CUTS
    exponent = rounded + (sharp - rounded) * angular
    shapes = []
    for number in range(SHAPES):
        rng = np.random.default_rng([seed, Stream.ROCK_SHAPES, number])
        planes = int(rng.integers(7, 14))
        sides = rng.normal(size=(planes, 3))
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        depth = rng.uniform(0.45, 0.9, planes)
        cut = depth / np.maximum(directions @ sides.T, 1e-3)
        radius = np.concatenate((cut, np.full((len(directions), 1), 1.0)), axis=1)
        radius = np.power(np.power(radius, -exponent).sum(axis=1), -1.0 / exponent)
        for scale, height in LUMPS:
            waves = rng.normal(scale=scale, size=(LUMP_WAVES, 3))
            shift = rng.uniform(0, 2 * np.pi, LUMP_WAVES)
            radius = radius * (1.0 + height * np.sin(directions @ waves.T + shift).mean(axis=1) * 2.0)
        points = directions * radius[:, None]
        points /= np.linalg.norm(points, axis=1).max()
        shapes.append(RockShape(points, _vertex_normals(points, triangles), triangles))
    return shapes


def _vertex_normals(points: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Return the unit normals `(V, 3)` of vertices: means of the normals of their triangles, weighted by area."""
    corners = points[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


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
