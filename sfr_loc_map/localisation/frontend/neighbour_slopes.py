"""Slopes of local planes in disparity, fitted to the disparities of neighbouring corners.

A slope is the derivative of the disparity with respect to u or v of the left pixel, px of disparity per px.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.jit import jit, jit_fast
from sfr_loc_map.localisation.small_linalg import solve
from sfr_loc_map.parallel import in_halves

NEIGHBOURS = 9  #: Maximum number of points in the fit of a local plane: a corner and its eight nearest neighbours.
MIN_NEIGHBOURS = 4  #: Minimum number of points in the fit of a local plane, which has three unknowns.
PLANE_ITERATIONS = 4
"""Iterations of reweighted least squares for a local plane. With fewer iterations, outliers keep more weight; more
iterations take more time."""
PLANE_SCALE_PX = 0.3
"""Scale of the Cauchy weight of a disparity's residual from the local plane, px. The scale is ten times the noise of a
disparity (0.03 px), because the ground between corners is not flat."""
SLOPE_INFORMATION = 0.02
"""Information of the zero-slope prior, divided by the squared distance of the farthest neighbour. The value is about a
seventh of the information of the farthest neighbour, whose weight is exp(-2) = 0.14. If all neighbours lie on a line,
the prior determines the slope across that line."""
NEARNESS = -2.0  #: Exponent of the Gaussian weight at the farthest neighbour, which is at two standard deviations.
MAX_SLOPE = 0.7  #: Maximum slope, px of disparity per px. At 0.7, a patch has 0.3 of its width in the right image.


class Neighbours(NamedTuple):
    """The k nearest support points of each of N points, nearest first."""

    distance: FloatArray  #: `(N, k)` pixels.
    numbers: NDArray[np.intp]  #: `(N, k)` indices of the support points.


@jit
def nearest(points: FloatArray, begin: NDArray[np.intp], support: FloatArray, count: int) -> Neighbours:
    """Return the nearest support points of each point.

    The search proceeds in both directions along u, and ends where the distance along u alone exceeds the distance of
    all `count` points found so far.

    Args:
        points: `(N, 2)` u, v, pixels.
        begin: `(N,)` indices at which the points would be inserted into the support, as from `np.searchsorted`.
        support: `(M, 2)` u, v, pixels, sorted by u; M is at least `count`.
        count: Number of nearest points.
    """
    index = np.zeros((len(points), count), np.intp)
    distance = np.full((len(points), count), np.inf)
    for n in range(len(points)):
        u, v = points[n, 0], points[n, 1]
        nearest_squares = distance[n]  # squared distances until all are found
        nearest_index = index[n]
        low = begin[n] - 1
        high = begin[n]
        while True:
            low_square = (u - support[low, 0]) ** 2 if low >= 0 else np.inf
            high_square = (support[high, 0] - u) ** 2 if high < len(support) else np.inf
            if not min(low_square, high_square) <= nearest_squares[count - 1]:
                break
            if low_square < high_square:
                candidate = low
                along_u = low_square
                low -= 1
            else:
                candidate = high
                along_u = high_square
                high += 1
            if along_u == np.inf:
                break
            square = along_u + (support[candidate, 1] - v) ** 2
            if square < nearest_squares[count - 1]:
                place = count - 1
                while place > 0 and nearest_squares[place - 1] > square:
                    nearest_squares[place] = nearest_squares[place - 1]
                    nearest_index[place] = nearest_index[place - 1]
                    place -= 1
                nearest_squares[place] = square
                nearest_index[place] = candidate
        for k in range(count):
            nearest_squares[k] = np.sqrt(nearest_squares[k])
    return Neighbours(distance, index)


def neighbours_of(uv: FloatArray, known: FloatArray) -> Neighbours | None:
    """Return the neighbours of corners `(N, 2)` among these corners and known points `(M, 3)`.

    The indices of the known points follow those of the corners. The result is None if there are no corners, or fewer
    than `MIN_NEIGHBOURS` corners and known points together.
    """
    support = np.concatenate((uv, known[:, :2]))
    if not len(uv) or len(support) < MIN_NEIGHBOURS:
        return None
    order = np.argsort(support[:, 0], kind="stable")
    begin = np.searchsorted(support[order, 0], uv[:, 0])
    search = partial(nearest, support=np.ascontiguousarray(support[order]), count=min(NEIGHBOURS, len(support)))
    found = in_halves(search, uv, begin)
    return Neighbours(found.distance, order[found.numbers])


def slopes_of(
    uv: FloatArray, disparity: FloatArray, good: Mask, known: FloatArray, neighbours: Neighbours | None
) -> FloatArray:
    """Return the slopes `(N, 2)` of the planes through corners and their neighbours; 0 without neighbours.

    Corners are used as neighbours only if they are `good` `(N,)`. The known points are `(M, 3)` u, v, disparity.
    """
    if neighbours is None:
        return np.zeros((len(uv), 2))
    support = np.concatenate((np.column_stack((uv, disparity)), known))
    usable = np.concatenate((good, np.ones(len(known), np.bool_)))
    fit = partial(_fit_slopes, support=support, usable=usable)
    return in_halves(fit, uv, disparity, neighbours.numbers, neighbours.distance)


@jit_fast
def _fit_slopes(
    uv: FloatArray,
    disparity: FloatArray,
    index: NDArray[np.int64],
    distance: FloatArray,
    support: FloatArray,
    usable: Mask,
) -> FloatArray:
    """Return the slopes `(N, 2)` of planes fitted to neighbours `(N, k)` by reweighted least squares.

    The weight of a neighbour decreases with its distance (Gaussian) and with its residual (Cauchy).
    """
    slopes = np.zeros((len(uv), 2))
    row = np.ones(3)  # derivatives of the disparity with respect to the unknowns: disparity at the corner, slopes
    nearness = np.empty(index.shape[1])
    for n in range(len(uv)):
        reach = max(distance[n, -1], 1.0)
        for k in range(index.shape[1]):
            nearness[k] = np.exp(NEARNESS * (distance[n, k] / reach) ** 2)
        plane = np.zeros(3)
        for _ in range(PLANE_ITERATIONS):
            information = np.zeros((3, 3))
            rhs = np.zeros(3)
            # The corner's own disparity has unit weight. A weak prior of zero slope regularises isolated points.
            information[0, 0] = 1.0
            information[1, 1] = SLOPE_INFORMATION * reach * reach
            information[2, 2] = SLOPE_INFORMATION * reach * reach
            for k in range(index.shape[1]):
                m = index[n, k]
                if not usable[m]:
                    continue
                row[1] = support[m, 0] - uv[n, 0]
                row[2] = support[m, 1] - uv[n, 1]
                level = support[m, 2] - disparity[n]
                residual = (level - plane[0] - row[1] * plane[1] - row[2] * plane[2]) / PLANE_SCALE_PX
                weight = nearness[k] / (1.0 + residual * residual)
                for i in range(3):
                    rhs[i] += weight * row[i] * level
                    for j in range(3):
                        information[i, j] += weight * row[i] * row[j]
            plane = solve(information, rhs)
        for i in range(2):
            slopes[n, i] = min(max(plane[1 + i], -MAX_SLOPE), MAX_SLOPE)
    return slopes
