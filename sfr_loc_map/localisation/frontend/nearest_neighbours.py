"""Nearest points in the plane, without a library whose import takes longer than the rest of a node's start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit


def nearest(points: FloatArray, support: FloatArray, count: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the distances and the numbers, `(N, count)` each, of the nearest of some points, nearest first.

    Args:
        points: `(N, 2)`.
        support: `(M, 2)`, M at least `count`; among these is searched.
        count: How many.
    """
    order = np.argsort(support[:, 0], kind="stable")
    ordered = np.ascontiguousarray(support[order])
    begin = np.searchsorted(ordered[:, 0], points[:, 0])
    distance, index = _nearest(np.ascontiguousarray(points), ordered, begin, count)
    return distance, order[index]


@jit
def _nearest(
    points: FloatArray, support: FloatArray, begin: NDArray[np.intp], count: int
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Walk from each point's place to both sides, until what lies there is too far along u alone."""
    index, distance = np.empty((len(points), count), np.intp), np.empty((len(points), count))
    for n in range(len(points)):
        u, v = points[n]
        best, who = np.full(count, np.inf), np.zeros(count, np.intp)
        low, high = begin[n] - 1, begin[n]
        while True:
            near_low = (u - support[low, 0]) ** 2 if low >= 0 else np.inf
            near_high = (support[high, 0] - u) ** 2 if high < len(support) else np.inf
            if not min(near_low, near_high) <= best[count - 1]:
                break
            if near_low < near_high:
                at, along = low, near_low
                low -= 1
            else:
                at, along = high, near_high
                high += 1
            if along == np.inf:
                break
            square = along + (support[at, 1] - v) ** 2
            if square < best[count - 1]:
                place = count - 1
                while place > 0 and best[place - 1] > square:
                    best[place], who[place] = best[place - 1], who[place - 1]
                    place -= 1
                best[place], who[place] = square, at
        for place in range(count):
            index[n, place], distance[n, place] = who[place], np.sqrt(best[place])
    return distance, index
