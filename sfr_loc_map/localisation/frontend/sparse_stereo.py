"""Disparities of single corners: search along the row, then least squares with the slope of the local plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.small_linalg import copy_row, fill_inverse_4, solve
from sfr_loc_map.jit import jit, jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import (
    HALF,
    MIN_POWER,
    Patch,
    PatchPixels,
    Pyramid,
    Templates,
    cut_patches,
    half_width,
    normalise,
    patch_pixels,
    sample,
    templates_of,
)
from sfr_loc_map.localisation.frontend.patch_tracking import PatchTracks, TrackingLimits, track_patches
from sfr_loc_map.localisation.parallel import in_halves


@jit
def nearest(
    points: FloatArray, support: FloatArray, begin: NDArray[np.intp], count: int
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the distances and the numbers, `(N, count)` each, of the support points nearest to others, nearest first.

    It walks from each point's place to both sides, until what lies there is too far along u alone. Points `(N, 2)`
    begin at their places `(N,)` in the support `(M, 2)`, which is in the order of u and has at least `count`.
    """
    index, distance = np.zeros((len(points), count), np.intp), np.full((len(points), count), np.inf)
    for n in range(len(points)):
        u, v, best, who = points[n, 0], points[n, 1], distance[n], index[n]  # squared until all are found
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
            found = along + (support[at, 1] - v) ** 2
            if found < best[count - 1]:
                place = count - 1
                while place > 0 and best[place - 1] > found:
                    best[place], who[place] = best[place - 1], who[place - 1]
                    place -= 1
                best[place], who[place] = found, at
        for k in range(count):
            best[k] = np.sqrt(best[k])
    return distance, index


@jit_fast_inline
def _fill_scores(
    image: FloatImage, template: Patch, power: np.float32, u: int, v: int, sums: Patch, scores: FloatArray
) -> None:
    """Fill the correlations of a template with patches from the pixel (u, v) on along the row, the last one first.

    They are -1 without texture. The sums `(3, P)` are over each patch: values, squares, products with the template.
    """
    places, half, size = len(scores), half_width(template.size), template.size
    total, square, dot = sums[0, :places], sums[1, :places], sums[2, :places]
    for p in range(places):
        total[p], square[p], dot[p], scores[p] = 0.0, 0.0, 0.0, -1.0
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
    for p in range(usable):
        variance = square[p] - total[p] * total[p] / size
        if variance > MIN_POWER:
            scores[places - 1 - p] = dot[p] / np.sqrt(variance * power)


@jit_fast_inline
def _peak(scores: FloatArray) -> tuple[float, float, float]:
    """Return the position of the highest score by a parabola, that score, and the highest more than two away."""
    best, second, count = 0, -1.0, len(scores)
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
def search_row(image: FloatImage, patches: Patch, uv: FloatArray, max_disparity: int, offset_v: int) -> FloatArray:
    """Search patches `(N, S * S)` around left pixels along the rows of the right image.

    Returns `(N, 3)` the disparity of the best correlation, that correlation, and the best one more than two pixels
    away; 0 where there is no texture.
    """
    count, size = patches.shape
    height, width = image.shape
    half = half_width(size)
    found = np.zeros((count, 3))
    sums, scores = np.empty((3, max_disparity + 2), np.float32), np.empty(max_disparity + 2)
    for n in range(count):
        template = patches[n].copy()
        power = normalise(template)
        u, v = int(uv[n, 0]), int(uv[n, 1]) + offset_v
        last = min(max_disparity, u - half)
        if power < MIN_POWER or v < half or v >= height - half or u >= width - half or last < 2:
            continue
        # position p is the disparity last - p, from last down to -1: all of them at once, along the row
        _fill_scores(image, template, power, u - last, v, sums, scores[: last + 2])
        position, correlation, second = _peak(scores[: last + 2])
        found[n, 0], found[n, 1], found[n, 2] = position - 1.0, correlation, second
    return found


PRIOR_SIGMA = 0.05  #: Standard deviation of a slope as the neighbours give it, pixels of disparity per pixel.
MIN_SQUARE = 1.0  #: Smallest mean squared residual that counts, grey levels squared: pixels are whole grey levels.
SLOPE_ITERATIONS = 5
MAX_SLOPE_SHIFT_PX, MAX_SLOPE = 1.0, 0.7  #: A patch that moves farther, or becomes steeper, keeps its slopes.
FINISHED_PX = 0.01  #: Largest movement of a pixel of the patch below which no further iteration follows.


class _Workspace(NamedTuple):
    """Arrays that all patches share. A plane is `(4,)`: centre of the patch in the right image, pixels, its slopes."""

    pixels: PatchPixels  #: Pixels of the left patch.
    start: FloatArray  #: Plane as the neighbours give it.
    at: FloatArray  #: Plane as it is found.
    columns: Patch  #: `(5, S * S)` grey levels and derivatives by the four unknowns.
    normal: FloatArray  #: `(4, 4)` normal matrix of the derivatives.
    damped: FloatArray  #: `(4, 4)` the same with the prior.
    inverse: FloatArray  #: `(4, 4)` its inverse.
    products: FloatArray  #: `(4,)` products of the derivatives with the right image.


@jit_fast_inline
def _fill_columns(patch: Patch, work: _Workspace) -> float:
    """Fill grey levels and derivatives; return the power of the grey levels.

    Derivatives are left without their mean and without what a change of contrast explains.
    """
    columns, pixels, size = work.columns, work.pixels, work.pixels.columns.size
    along_u, along_v = np.float32(1.0 - work.start[2]), np.float32(work.start[3])
    for k in range(size):
        by_x = patch[1, k] / along_u
        columns[0, k], columns[1, k], columns[2, k] = patch[0, k], by_x, patch[2, k] + along_v * by_x
        columns[3, k], columns[4, k] = -pixels.columns[k] * by_x, -pixels.rows[k] * by_x
    power = normalise(columns[0])
    if power < MIN_POWER:
        return float(power)
    for c in range(1, 5):
        normalise(columns[c])
        share = np.float32(0.0)
        for k in range(size):
            share += columns[0, k] * columns[c, k]
        share /= power
        for k in range(size):
            columns[c, k] -= share * columns[0, k]
    return float(power)


@jit_fast_inline
def _fill_normal(work: _Workspace) -> bool:
    """Fill the normal matrix; tell whether it gives a position."""
    columns, normal = work.columns, work.normal
    for a in range(4):
        for b in range(a, 4):
            total = np.float32(0.0)
            for k in range(columns.shape[1]):
                total += columns[1 + a, k] * columns[1 + b, k]
            normal[a, b] = normal[b, a] = total
    det = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[0, 1]
    return bool(det > 1e-6 * (normal[0, 0] + normal[1, 1]) ** 2)


@jit_fast_inline
def _compare(image: FloatImage, plane: tuple[float, float, float, float], power: float, work: _Workspace) -> float:
    """Fill the products; return the mean squared residual, grey levels squared, NaN where there is nothing."""
    columns, pixels, products = work.columns, work.pixels, work.products
    (at_x, at_y, slope_u, slope_v), size, half = plane, pixels.columns.size, half_width(pixels.columns.size)
    reach, (height, width) = half * (abs(1.0 - slope_u) + abs(slope_v)), image.shape
    if at_x < reach or at_x + reach >= width - 1.001 or at_y < half or at_y + half >= height - 1.001:
        return np.nan
    x, y, along_u, along_v = np.float32(at_x), np.float32(at_y), np.float32(1.0 - slope_u), np.float32(slope_v)
    level = sample(image, x, y)
    total, squares, grey = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    p0, p1, p2, p3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(size):
        i, j = pixels.columns[k], pixels.rows[k]
        value = sample(image, x + along_u * i - along_v * j, y + j) - level
        total += value
        squares += value * value
        grey += columns[0, k] * value
        p0 += columns[1, k] * value
        p1 += columns[2, k] * value
        p2 += columns[3, k] * value
        p3 += columns[4, k] * value
    own = squares - total * total / np.float32(size)
    if own < MIN_POWER:
        return np.nan
    gain = np.sqrt(power / own)
    products[0], products[1], products[2], products[3] = gain * p0, gain * p1, gain * p2, gain * p3
    return float(max(2.0 * (power - gain * grey), 0.0) / size)


@jit_fast_inline
def _fit(image: FloatImage, power: float, work: _Workspace) -> bool:
    """Find the plane of a patch from that of its neighbours; tell whether it gives a plausible one."""
    half, start, at, p = half_width(work.pixels.columns.size), work.start, work.at, work.products
    damped, inverse = work.damped, work.inverse
    copy_row(start, at)
    for _ in range(SLOPE_ITERATIONS):
        square = _compare(image, (at[0], at[1], at[2], at[3]), power, work)
        if np.isnan(square):
            return False
        weight = max(square, MIN_SQUARE) / PRIOR_SIGMA**2
        for a in range(4):
            copy_row(work.normal[a], damped[a])
        for a in range(2, 4):
            damped[a, a] += weight
            p[a] += weight * (at[a] - start[a])
        fill_inverse_4(damped, inverse)
        moved = 0.0
        for a in range(4):
            step = inverse[a, 0] * p[0] + inverse[a, 1] * p[1] + inverse[a, 2] * p[2] + inverse[a, 3] * p[3]
            at[a] -= step
            moved = max(moved, abs(step) * (1 if a < 2 else half))
        shift, slope = max(abs(at[0] - start[0]), abs(at[1] - start[1])), max(abs(at[2]), abs(at[3]))
        if not (shift <= MAX_SLOPE_SHIFT_PX and slope <= MAX_SLOPE):  # nor if they are NaN
            return False
        if moved < FINISHED_PX:
            break
    return True


@jit_fast
def refine_slopes(image: FloatImage, patches: Patch, right: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the slopes `(N, 2)` of the planes of single patches; those of their neighbours where a patch gives none.

    The patches `(N, 3, S * S)` are cut out of the left image; their centres in the right one `(N, 2)` are NaN where not
    known. A slope is the change of the disparity per pixel along u and v.
    """
    refined, size = slope.copy(), patches.shape[2]
    matrices, vectors, columns = np.zeros((3, 4, 4)), np.zeros((3, 4)), np.empty((5, size), np.float32)
    normal, damped, inverse = matrices
    start, at, products = vectors
    work = _Workspace(patch_pixels(size), start, at, columns, normal, damped, inverse, products)
    for n in range(len(patches)):
        start[0], start[1], start[2], start[3] = right[n, 0], right[n, 1], slope[n, 0], slope[n, 1]
        if np.isnan(start[0]):
            continue
        power = _fill_columns(patches[n], work)
        if power >= MIN_POWER and _fill_normal(work) and _fit(image, power, work):
            refined[n, 0], refined[n, 1] = at[2], at[3]
    return refined


SEARCH_LEVEL = 1
SEARCH_HALF = 4
NEIGHBOURS = 9  #: Maximum number of points that a local plane is fitted to.
MIN_NEIGHBOURS = 4  #: Minimum number of points that a local plane is fitted to.
MIN_SEARCH_NCC, MIN_NCC = 0.75, 0.7  #: Minimum normalised cross-correlation of the search and of the refined match.
MAX_AMBIGUITY = 0.85  #: Maximum ratio of best to second-best `1 - correlation` of the search.
MAX_VERTICAL_PX, MIN_DISPARITY_PX = 1.0, -0.5
"""Maximum distance of a match from its row, and minimum disparity, pixels."""
MAX_SHIFT_PX, ITERATIONS = 2.5, 12


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Corners of the left image with their positions in the right one."""

    uv: FloatArray  #: `(N, 2)` left pixels.
    right: FloatArray  #: `(N, 2)` right pixels.
    covariance: FloatArray  #: `(N, 3)` uu, uv, vv of the right position for a noise of one grey level, px^2.
    residual: FloatArray  #: `(N,)` RMS, grey levels.
    slope: FloatArray  #: `(N, 2)` change of the disparity per pixel, of the local plane.
    patches: Templates  #: Templates of the left patches.


def match_corners(
    left: Pyramid,
    right: Pyramid,
    uv: FloatArray,
    known: FloatArray,
    max_disparity: float,
    offset_v: float,
    right_mask: NDArray[np.uint8] | None = None,
    *,
    own_slopes: bool = False,
) -> StereoMatches:
    """Match corners of the left image, `(N, 2)` whole pixels, in the right one; return those that were matched.

    Args:
        left: Left pyramid.
        right: Right pyramid.
        uv: The corners.
        known: `(M, 3)` u, v, disparity of landmarks around, which help to find the local planes.
        max_disparity: Maximum disparity, pixels.
        offset_v: Vertical disparity of the pair, pixels, positive where the right image is lower.
        right_mask: `(H, W)`, 0 where the right image is masked: what matches there is left out; None for nowhere.
        own_slopes: Whether patches tell their slopes, not their neighbours alone: where these are far.
    """
    # disparities on a small level, pixels of full size
    (image, scale), target = left[SEARCH_LEVEL], right[SEARCH_LEVEL].image
    small = np.round((uv + 0.5) / scale - 0.5)
    margin, (height, width) = SEARCH_HALF + 2, image.shape
    patches = cut_patches(image, np.clip(small, margin, [width - 1 - margin, height - 1 - margin]), SEARCH_HALF)
    last, down = int(np.ceil(max_disparity / scale)), int(np.round(offset_v / scale))
    search = partial(search_row, target, max_disparity=last, offset_v=down)
    disparity, correlation, second = in_halves(search, patches[:, 0], small).T
    good = (correlation > MIN_SEARCH_NCC) & (1.0 - correlation < MAX_AMBIGUITY * (1.0 - second))
    uv, disparity = uv[good], disparity[good] * scale
    # refined by least squares, with the slopes of the planes through the neighbours
    templates = templates_of(cut_patches(left[0].image, uv, HALF))
    support = np.concatenate((uv, known[:, :2]))
    around = None
    if len(uv) and len(support) >= MIN_NEIGHBOURS:
        order = np.argsort(support[:, 0], kind="stable")
        begin = np.searchsorted(support[order, 0], uv[:, 0])
        distance, index = nearest(uv, np.ascontiguousarray(support[order]), begin, min(NEIGHBOURS, len(support)))
        around = distance, order[index]
    good = np.ones(len(uv), np.bool_)
    for _ in range(2):
        slope = _slopes(uv, disparity, good, known, around)
        tracks = _refine(right[0].image, templates, uv, disparity, slope, offset_v)
        good = np.isfinite(tracks.uv[:, 0])
        disparity = np.where(good, uv[:, 0] - tracks.uv[:, 0], disparity)
    slope = _slopes(uv, disparity, good, known, around)
    if own_slopes:
        slope = in_halves(
            partial(refine_slopes, right[0].image), cut_patches(left[0].image, uv, HALF), tracks.uv, slope
        )
        tracks = _refine(right[0].image, templates, uv, disparity, slope, offset_v)
        disparity = uv[:, 0] - tracks.uv[:, 0]
    good &= (tracks.correlation > MIN_NCC) & (disparity > MIN_DISPARITY_PX)
    good &= np.abs(tracks.uv[:, 1] - uv[:, 1] - offset_v) < MAX_VERTICAL_PX
    if right_mask is not None:
        column, line = np.rint(np.where(good[:, None], tracks.uv, 0.0)).astype(int).T
        good &= right_mask[np.clip(line, 0, len(right_mask) - 1), np.clip(column, 0, right_mask.shape[1] - 1)] > 0
    matched = Templates(*(array[good] for array in templates))
    return StereoMatches(
        uv[good], tracks.uv[good], tracks.covariance[good], tracks.residual[good], slope[good], matched
    )


def _refine(
    right: FloatImage, templates: Templates, uv: FloatArray, disparity: FloatArray, slope: FloatArray, offset_v: float
) -> PatchTracks:
    """Track patches by the homographies of planes in disparity, from left to right pixels."""
    homographies = np.zeros((len(uv), 3, 3))
    homographies[:, 0, 0] = 1.0 - slope[:, 0]
    homographies[:, 0, 1] = -slope[:, 1]
    homographies[:, 0, 2] = slope[:, 0] * uv[:, 0] + slope[:, 1] * uv[:, 1] - disparity
    homographies[:, 1, 1] = homographies[:, 2, 2] = 1.0
    homographies[:, 1, 2] = offset_v
    limits = TrackingLimits(MAX_SHIFT_PX, ITERATIONS, -1.0)
    return in_halves(partial(track_patches, right, limits=limits), templates, uv, homographies)


def _slopes(
    uv: FloatArray,
    disparity: FloatArray,
    good: Mask,
    known: FloatArray,
    around: tuple[FloatArray, NDArray[np.intp]] | None,
) -> FloatArray:
    """Return the slopes `(N, 2)` of the planes through points and those around them, of which good `(N,)` ones count.

    The points known beside them are `(M, 3)` (u, v, disparity), and follow them in the numbers of those around.
    """
    if around is None:
        return np.zeros((len(uv), 2))
    support = np.concatenate((np.column_stack((uv, disparity)), known))
    usable = np.concatenate((good, np.ones(len(known), np.bool_)))
    distance, index = around
    return in_halves(partial(_fit_slopes, support=support, usable=usable), uv, disparity, index, distance)


@jit_fast
def _fit_slopes(
    uv: FloatArray,
    disparity: FloatArray,
    index: NDArray[np.int64],
    distance: FloatArray,
    support: FloatArray,
    usable: Mask,
) -> FloatArray:
    """Return the slopes `(N, 2)` of planes fitted to neighbours `(N, NEIGHBOURS)`, nearer and agreeing ones first."""
    out = np.zeros((len(uv), 2))
    row = np.ones(3)
    for n in range(len(uv)):
        reach, plane = max(distance[n, -1], 1.0), np.zeros(3)
        for _ in range(4):
            h, g = np.zeros((3, 3)), np.zeros(3)
            # a weak prior for zero slope regularises isolated points
            h[0, 0], h[1, 1], h[2, 2] = 1.0, 0.02 * reach * reach, 0.02 * reach * reach
            for k in range(index.shape[1]):
                m = index[n, k]
                if not usable[m]:
                    continue
                row[1], row[2] = support[m, 0] - uv[n, 0], support[m, 1] - uv[n, 1]
                level = support[m, 2] - disparity[n]
                residual = (level - plane[0] - row[1] * plane[1] - row[2] * plane[2]) / 0.3
                weight = np.exp(-2.0 * (distance[n, k] / reach) ** 2) / (1.0 + residual * residual)
                for i in range(3):
                    g[i] += weight * row[i] * level
                    for j in range(3):
                        h[i, j] += weight * row[i] * row[j]
            plane = solve(h, g)
        for i in range(2):
            out[n, i] = min(max(plane[1 + i], -MAX_SLOPE), MAX_SLOPE)
    return out
