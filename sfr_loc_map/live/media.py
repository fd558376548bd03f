"""Reduce images, clouds and top-view maps for a screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.geometry.arrays import FloatArray32, PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.latest import Latest
from sfr_loc_map.live.updates import ElevationSample, ImageSample
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.topics import ELEVATION

IMAGE_WIDTH = 640  #: Maximum width of a displayed image, px.
JPEG_QUALITY = 75  #: JPEG quality, 0 to 100. Artefacts are not visible at this quality and width.
CELL_M = 0.1  #: Cell size of a grid made from a cloud, m; the mapper's default.
MAX_SIDE = 512
"""Maximum number of cells along an axis of a grid made from a cloud. If an area requires more cells, its cells are
enlarged."""
MAX_CELLS = 30_000  #: Maximum number of displayed cells.
MAX_TRUE_PAIRS = 2 * MAX_PAIRS
"""Number of pairs whose true points are kept: those of a map, and as many that arrive before its cloud."""
WORST = frozenset({"hazard", "step"})  #: Layers in which a thinned cell has the maximum of the original cells.


def image_sample(
    topic: str,
    stamp_ns: int,
    image: NDArray[np.uint8],
    published_s: float,
    full_shape: tuple[int, ...] | None = None,
    track_count: int = 0,
) -> ImageSample:
    """Return an image, `(H, W)` grey or `(H, W, 3)` blue, green, red, reduced for the screen.

    `full_shape` is the original shape if the image was reduced already.
    """
    shown = image
    height, width = image.shape[:2]
    if width > IMAGE_WIDTH:
        size = (IMAGE_WIDTH, max(round(height * IMAGE_WIDTH / width), 1))
        shown = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    jpeg = bytes(cv2.imencode(".jpg", np.ascontiguousarray(shown), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])
    full_height, full_width = (full_shape or image.shape)[:2]
    size = (shown.shape[1], shown.shape[0])
    return ImageSample(topic, stamp_ns, jpeg, size, (full_width, full_height), published_s, track_count)


class CloudTruth:
    """Keeps the true points of the last pairs by stamp, and compares points with the true points at their pixels."""

    def __init__(self) -> None:
        self._truths = Latest[int, PointImage](MAX_TRUE_PAIRS)

    def add(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points of a pair, `(H, W, 3)` in LM, m."""
        self._truths[stamp_ns] = points

    def errors(self, cloud: PointCloud, pair_stamps_ns: Sequence[int]) -> FloatArray32 | None:
        """Return the distances `(N,)` to the truth, m, NaN for points without truth; None if no point has truth.

        `pair_stamps_ns` are the stamps of the cloud's pairs; a point's `pair` is an index into them.
        """
        error = np.full(len(cloud), np.nan, np.float32)
        for number, stamp_ns in enumerate(pair_stamps_ns):
            truth = self._truths.get(stamp_ns)
            if truth is None:
                continue
            rows = np.flatnonzero(cloud.pair == number)
            u, v = cloud.u[rows].astype(np.intp), cloud.v[rows].astype(np.intp)
            inside = (v < truth.shape[0]) & (u < truth.shape[1])
            rows, u, v = rows[inside], u[inside], v[inside]
            error[rows] = np.linalg.norm(cloud.xyz[rows] - truth[v, u], axis=1)
        return error if np.isfinite(error).any() else None


def grid_of_cloud(
    stamp_ns: int, xyz: ArrayLike, sigma: ArrayLike | None, published_s: float, error: ArrayLike | None = None
) -> ElevationSample | None:
    """Return a top-view map with the mean values of the points `(N, 3)` in each cell; None for an empty cloud.

    Points that are not finite are ignored. `sigma` and `error`, the distance to the truth, are `(N,)` in m, NaN or None
    if unknown.
    """
    points = np.asarray(xyz, np.float32).reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    points = points[known]
    if not len(points):
        return None
    nowhere = np.full(len(points), np.nan, np.float32)
    deviation, distance = (nowhere if a is None else np.asarray(a, np.float32)[known] for a in (sigma, error))
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    origin = (float(low[0]), float(low[1]))
    cell_m = max(CELL_M, float((high - low).max()) / (MAX_SIDE - 1))
    width, height = (int(size) for size in np.floor((high - low) / cell_m) + 1)
    cell = cells_of(points, origin, cell_m, (height, width))
    count = np.bincount(cell, minlength=height * width).astype(np.float64)
    means = [means_of(cell, values, height * width) for values in (points[:, 2], deviation, distance)]
    layers = np.stack([*means, np.where(count > 0, count, np.nan)], axis=-1).astype(np.float32)
    names = ("height", "sigma", "error", "count")
    grid = ElevationSample(ELEVATION, stamp_ns, origin, cell_m, names, layers.reshape(height, width, -1), published_s)
    return thinned(grid)


def cells_of(
    points: FloatArray32, origin_m: tuple[float, float], cell_m: float, shape: tuple[int, int]
) -> NDArray[np.intp]:
    """Return the row-major index of the cell of each point `(N, >= 2)`; -1 outside the grid."""
    at = np.floor((points[:, :2] - np.asarray(origin_m, np.float32)) / cell_m).astype(np.intp)
    rows, columns = shape
    inside = (at >= 0).all(axis=1) & (at[:, 0] < columns) & (at[:, 1] < rows)
    return np.where(inside, at[:, 1] * columns + at[:, 0], -1)


def means_of(cell: NDArray[np.intp], values: FloatArray32, size: int) -> NDArray[np.float64]:
    """Return the mean of the finite values of each cell; NaN for a cell without values."""
    known = np.isfinite(values) & (cell >= 0)
    count = np.bincount(cell[known], minlength=size)
    total = np.bincount(cell[known], values[known].astype(np.float64), minlength=size)
    return np.asarray(np.divide(total, count, out=np.full(size, np.nan), where=count > 0))


def with_layer(sample: ElevationSample, name: str, values: NDArray[np.floating]) -> ElevationSample:
    """Return a grid with a layer `(rows, columns)` added or replaced."""
    names = tuple(known for known in sample.names if known != name)
    kept = sample.layers[..., [sample.names.index(known) for known in names]]
    layers = np.concatenate([kept, np.asarray(values, np.float32)[..., None]], axis=-1)
    return replace(sample, names=(*names, name), layers=layers)


def thinned(sample: ElevationSample) -> ElevationSample:
    """Return a grid of about `MAX_CELLS` cells at most.

    A cell has the mean of the original cells; for hazard and step it has the maximum, and for counts the sum.
    """
    rows, columns, layers = sample.layers.shape
    every = max(int(np.ceil(np.sqrt(rows * columns / MAX_CELLS))), 1)
    if every == 1:
        return sample
    padding = ((0, -rows % every), (0, -columns % every), (0, 0))
    cells = np.pad(sample.layers, padding, constant_values=np.nan)
    tall, wide = cells.shape[0] // every, cells.shape[1] // every
    blocks = cells.reshape(tall, every, wide, every, layers).swapaxes(1, 2).reshape(tall, wide, -1, layers)
    counts, sums = np.isfinite(blocks).sum(axis=2), np.nansum(blocks, axis=2)
    made = np.divide(sums, counts, out=np.full(sums.shape, np.nan, np.float32), where=counts > 0)
    for index, name in enumerate(sample.names):
        if name in WORST:
            made[..., index] = np.fmax.reduce(blocks[..., index], axis=2)
        elif name == "count":
            made[..., index] = np.where(counts[..., index] > 0, sums[..., index], np.nan)
    return replace(sample, layers=made.astype(np.float32), cell_m=sample.cell_m * every, every=every)
