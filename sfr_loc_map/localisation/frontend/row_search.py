"""Disparities of single patches: the best correlation along a row of the right image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import MIN_POWER, Patch, half_width, normalise


class RowSearch(NamedTuple):
    """Disparity of the best correlation, that correlation, and the best one more than two pixels away; `(N,)` each."""

    disparity: FloatArray
    correlation: FloatArray
    second: FloatArray


class _RowSums(NamedTuple):
    """Sums over a patch at many positions of a row: values, their squares, their products with the template."""

    total: Patch
    square: Patch
    dot: Patch


@jit_fast_inline
def _sum_along_row(image: FloatImage, template: Patch, u: int, v: int, sums: _RowSums) -> int:
    """Fill the sums for patches around the pixels from (u, v) on along the row; return for how many there was room."""
    half = half_width(template.size)
    total, square, dot = sums.total, sums.square, sums.dot
    places = len(total)
    total[:], square[:], dot[:] = 0.0, 0.0, 0.0
    usable = places if u + places - 1 + half < image.shape[1] else places - 1
    k = 0
    for j in range(v - half, v + half + 1):
        for i in range(-half, half + 1):
            row = image[j, u + i :]
            weight = template[k]
            k += 1
            for p in range(usable):
                value = row[p]
                total[p] += value
                square[p] += value * value
                dot[p] += value * weight
    return usable


@jit_fast_inline
def _fill_scores(sums: _RowSums, usable: int, power: np.float32, size: int, scores: FloatArray) -> None:
    """Fill the correlations of disparities from -1 on, the last position of the row first; -1 without texture."""
    total, square, dot = sums.total, sums.square, sums.dot
    places = len(total)
    scores[:places] = -1.0
    for p in range(usable):
        variance = square[p] - total[p] * total[p] / size
        if variance > MIN_POWER:
            scores[places - 1 - p] = dot[p] / np.sqrt(variance * power)


@jit_fast_inline
def _peak(scores: FloatArray, count: int) -> tuple[float, float, float]:
    """Return the position of the highest score by a parabola, that score, and the highest more than two away."""
    best, second = 0, -1.0
    for d in range(1, count):
        if scores[d] > scores[best]:
            best = d
    for d in range(count):
        if abs(d - best) > 2:
            second = max(second, scores[d])
    refined = float(best)
    if 0 < best < count - 1:
        curvature = scores[best - 1] - 2.0 * scores[best] + scores[best + 1]
        if curvature < 0.0:
            refined += 0.5 * (scores[best - 1] - scores[best + 1]) / curvature
    return refined, scores[best], second


@jit_fast
def search_row(image: FloatImage, patches: Patch, uv: FloatArray, max_disparity: int, offset_v: int) -> RowSearch:
    """Search patches `(N, S * S)` around left pixels along the rows of the right image; 0 where there is no texture."""
    count, size = patches.shape
    height, width = image.shape
    half = half_width(size)
    found = RowSearch(np.zeros(count), np.zeros(count), np.zeros(count))
    sums, scores = np.empty((3, max_disparity + 2), np.float32), np.empty(max_disparity + 2)
    for n in range(count):
        template = patches[n].copy()
        power = normalise(template)
        u, v = int(uv[n, 0]), int(uv[n, 1]) + offset_v
        last = min(max_disparity, u - half)
        if power < MIN_POWER or v < half or v >= height - half or u >= width - half or last < 2:
            continue
        # position p is the disparity last - p, from last down to -1: all of them at once, along the row
        places = last + 2
        along = _RowSums(sums[0, :places], sums[1, :places], sums[2, :places])
        usable = _sum_along_row(image, template, u - last, v, along)
        _fill_scores(along, usable, power, size, scores)
        position, correlation, second = _peak(scores, places)
        found.disparity[n], found.correlation[n], found.second[n] = position - 1.0, correlation, second
    return found
