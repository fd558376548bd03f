"""The map from above: cells with one layer for each quantity, from the mapper's own grid or made of a cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.live.updates import ElevationSample

TOPIC = "mapping/elevation"
CELL_M = 0.1
MAX_SIDE = 512
"""Cells along each axis of a grid that is made of a cloud; beyond them they are larger."""
MAX_CELLS = 30_000
"""Most cells that are shown."""
CLOUD_LAYERS = ("height", "sigma", "error", "count")
HAZARD, ERROR, COUNT = "hazard", "error", "count"
WORST = frozenset({HAZARD, "step"})
"""Layers of which the worst of several cells is shown."""


def grid_of_cloud(
    stamp_ns: int, xyz: ArrayLike, sigma: ArrayLike | None, published_s: float, error: ArrayLike | None = None
) -> ElevationSample | None:
    """Return the means over the points of each cell, thinned for the screen; None of an empty cloud.

    Args:
        stamp_ns: Stamp of the cloud.
        xyz: `(N, 3)` metres, LM.
        sigma: `(N,)` metres, None where it is not known.
        published_s: When it was published, seconds of the host's clock.
        error: `(N,)` distance to the truth, metres, None where it is not known.
    """
    points = np.asarray(xyz, np.float32).reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    points = points[known]
    if not len(points):
        return None
    nowhere = np.full(len(points), np.nan, np.float32)
    deviation, distance = (nowhere if a is None else np.asarray(a, np.float32)[known] for a in (sigma, error))
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    cell_m = max(CELL_M, float((high - low).max()) / (MAX_SIDE - 1))
    columns, rows = (int(size) for size in np.floor((high - low) / cell_m) + 1)
    cell = cells_of(points, (float(low[0]), float(low[1])), cell_m, (rows, columns))
    count = np.bincount(cell, minlength=rows * columns).astype(np.float64)
    means = [means_of(cell, values, rows * columns) for values in (points[:, 2], deviation, distance)]
    layers = np.stack([*means, np.where(count > 0, count, np.nan)], axis=-1).astype(np.float32)
    origin = (float(low[0]), float(low[1]))
    shaped = layers.reshape(rows, columns, len(CLOUD_LAYERS))
    return thinned(ElevationSample(TOPIC, stamp_ns, origin, cell_m, CLOUD_LAYERS, shaped, published_s))


def cells_of(
    points: FloatArray32, origin_m: tuple[float, float], cell_m: float, shape: tuple[int, int]
) -> NDArray[np.intp]:
    """Return the cell of each point `(N, >= 2)`, counted along the rows; -1 outside the grid."""
    at = np.floor((points[:, :2] - np.asarray(origin_m, np.float32)) / cell_m).astype(np.intp)
    rows, columns = shape
    inside = (at >= 0).all(axis=1) & (at[:, 0] < columns) & (at[:, 1] < rows)
    return np.where(inside, at[:, 1] * columns + at[:, 0], -1)


def means_of(cell: NDArray[np.intp], values: FloatArray32, size: int) -> NDArray[np.float64]:
    """Return the mean of the values in each cell, NaN without."""
    known = np.isfinite(values) & (cell >= 0)
    count = np.bincount(cell[known], minlength=size)
    total = np.bincount(cell[known], values[known].astype(np.float64), minlength=size)
    return np.asarray(np.divide(total, count, out=np.full(size, np.nan), where=count > 0))


def with_layer(sample: ElevationSample, name: str, values: NDArray[np.floating]) -> ElevationSample:
    """Return a grid with one more layer `(rows, columns)`, or with another one of that name."""
    names = tuple(known for known in sample.names if known != name)
    kept = sample.layers[..., [sample.names.index(known) for known in names]]
    layers = np.concatenate([kept, np.asarray(values, np.float32)[..., None]], axis=-1)
    return replace(sample, names=(*names, name), layers=layers)


def thinned(sample: ElevationSample) -> ElevationSample:
    """Return larger cells where there are more than a screen shows: means, worst hazard and step, sums of counts."""
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
        elif name == COUNT:
            made[..., index] = np.where(counts[..., index] > 0, sums[..., index], np.nan)
    return replace(sample, layers=made.astype(np.float32), cell_m=sample.cell_m * every, every=every)
