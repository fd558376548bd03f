"""Disparities of single corners: a search along the row, then least squares with the slopes of the local plane.

A slope is the derivative of the disparity by the left pixel u or v. The slopes at a corner are those of a plane that is
fitted to the disparities of its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.jit import jit, jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import (
    HALF,
    MIN_POWER,
    ImageLevel,
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
from sfr_loc_map.localisation.frontend.patch_tracking import (
    MIN_TEXTURE_RATIO,
    PatchTracks,
    TrackingLimits,
    track_patches,
)
from sfr_loc_map.localisation.parallel import in_halves
from sfr_loc_map.localisation.small_linalg import copy_row, fill_inverse_4, solve


class Neighbours(NamedTuple):
    """Nearest points of N points, k for each of them, nearest first."""

    distance: FloatArray  #: `(N, k)` pixels.
    numbers: NDArray[np.intp]  #: `(N, k)`.


@jit
def nearest(points: FloatArray, begin: NDArray[np.intp], support: FloatArray, count: int) -> Neighbours:
    """Return the nearest support points of each point.

    The search goes from the place of a point in the order of u to both sides. It ends where the distance along u alone
    exceeds that of the last of the nearest.

    Args:
        points: `(N, 2)`.
        begin: `(N,)` places of the points in the support, as by `np.searchsorted`.
        support: `(M, 2)` in the order of u; M is at least `count`.
        count: Number of nearest points.
    """
    index = np.zeros((len(points), count), np.intp)
    distance = np.full((len(points), count), np.inf)
    for n in range(len(points)):
        u, v = points[n, 0], points[n, 1]
        nearest_squares = distance[n]  # squared until all are found
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


# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
MIN_PEAK_DISTANCE = 2  #: Positions beside the best correlation that do not count as a second peak.


@jit_fast_inline
def _fill_scores(
    image: FloatImage, template: Patch, power: np.float32, u: int, v: int, sums: Patch, scores: FloatArray
) -> None:
    """Fill the correlations of a template with the patches along a row, the last patch first.

    The first patch is centred at the pixel (u, v), and their number is that of the scores. A score is -1 without
    texture. `sums` `(3, P)` is a workspace for the sums over each patch: values, squares, products with the template.
    """
    places = len(scores)
    size = template.size
    half = half_width(size)
    total = sums[0, :places]
    square = sums[1, :places]
    product = sums[2, :places]
    for p in range(places):
        total[p] = 0.0
        square[p] = 0.0
        product[p] = 0.0
        scores[p] = -1.0
    is_last_inside = u + places - 1 + half < image.shape[1]
    usable = places if is_last_inside else places - 1
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
                product[p] += value * weight
    for p in range(usable):
        power_of_patch = square[p] - total[p] * total[p] / size
        if power_of_patch > MIN_POWER:
            scores[places - 1 - p] = product[p] / np.sqrt(power_of_patch * power)


class _Peak(NamedTuple):
    """Maximum of the correlations along a row."""

    position: float  #: Refined by a parabola.
    score: float
    second: float  #: Largest score that is more than `MIN_PEAK_DISTANCE` away.


@jit_fast_inline
def _peak(scores: FloatArray) -> _Peak:
    """Return the maximum of scores."""
    count = len(scores)
    best = 0
    for d in range(1, count):
        if scores[d] > scores[best]:
            best = d
    second = -1.0
    for d in range(count):
        if abs(d - best) > MIN_PEAK_DISTANCE:
            second = max(second, scores[d])
    position = float(best)
    if 0 < best < count - 1:
        curvature = scores[best - 1] - 2.0 * scores[best] + scores[best + 1]
        if curvature < 0.0:
            position += 0.5 * (scores[best - 1] - scores[best + 1]) / curvature
    return _Peak(position, scores[best], second)


@jit_fast
def search_row(image: FloatImage, patches: Patch, uv: FloatArray, max_disparity: int, offset_v: int) -> FloatArray:
    """Search patches `(N, S * S)` around left pixels `(N, 2)` along the rows of the right image.

    Returns `(N, 3)`: the disparity of the best correlation, that correlation, and the second-best one. A row is 0 if
    the patch has no texture or lies at the border.
    """
    count, size = patches.shape
    height, width = image.shape
    half = half_width(size)
    found = np.zeros((count, 3))
    sums = np.empty((3, max_disparity + 2), np.float32)
    scores = np.empty(max_disparity + 2)
    for n in range(count):
        template = patches[n].copy()
        power = normalise(template)
        u = int(uv[n, 0])
        v = int(uv[n, 1]) + offset_v
        last = min(max_disparity, u - half)
        if power < MIN_POWER or v < half or v >= height - half or u >= width - half or last < 2:
            continue
        # All disparities, from `last` down to -1, are compared at once along the row.
        _fill_scores(image, template, power, u - last, v, sums, scores[: last + 2])
        peak = _peak(scores[: last + 2])
        found[n, 0] = peak.position - 1.0
        found[n, 1] = peak.score
        found[n, 2] = peak.second
    return found


# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
PRIOR_SIGMA = 0.05  #: Standard deviation of the slopes of the neighbours' plane, pixels of disparity per pixel.
MIN_SQUARE = 1.0  #: Minimum mean squared residual, grey levels squared: images are quantised to whole grey levels.
SLOPE_ITERATIONS = 5  #: Maximum number of iterations.
MAX_SLOPE_SHIFT_PX = 1.0  #: Maximum shift of a patch, pixels; a patch that moves farther keeps its slopes.
MAX_SLOPE = 0.7  #: Maximum slope, pixels of disparity per pixel; a patch that becomes steeper keeps its slopes.
FINISHED_PX = 0.01  #: Movement of a pixel of the patch, pixels, below which no further iteration follows.


class _Workspace(NamedTuple):
    """Arrays for one patch after the other. A plane is `(4,)`: centre of the patch in the right image, px, and slopes.

    The four unknowns are those of a plane.
    """

    pixels: PatchPixels  #: Pixels of the left patch.
    start: FloatArray  #: Plane of the neighbours.
    plane: FloatArray  #: Plane of the patch.
    columns: Patch  #: `(5, S * S)` grey levels, and their derivatives by the unknowns.
    normal: FloatArray  #: `(4, 4)` normal matrix of the derivatives.
    regularised: FloatArray  #: `(4, 4)` normal matrix with the prior.
    inverse: FloatArray  #: `(4, 4)` inverse of the regularised matrix.
    products: FloatArray  #: `(4,)` products of the derivatives with the right image.


@jit_fast_inline
def _fill_columns(patch: Patch, work: _Workspace) -> float:
    """Fill grey levels and derivatives; return the power of the grey levels.

    The derivatives have no mean and are orthogonal to the grey levels, because a change of contrast explains the
    parallel part.
    """
    columns = work.columns
    pixels = work.pixels
    size = pixels.columns.size
    scale_u = np.float32(1.0 - work.start[2])
    slope_v = np.float32(work.start[3])
    for k in range(size):
        by_x = patch[1, k] / scale_u
        columns[0, k] = patch[0, k]
        columns[1, k] = by_x
        columns[2, k] = patch[2, k] + slope_v * by_x
        columns[3, k] = -pixels.columns[k] * by_x
        columns[4, k] = -pixels.rows[k] * by_x
    power = normalise(columns[0])
    if power < MIN_POWER:
        return float(power)
    for c in range(1, 5):
        normalise(columns[c])
        parallel = np.float32(0.0)
        for k in range(size):
            parallel += columns[0, k] * columns[c, k]
        parallel /= power
        for k in range(size):
            columns[c, k] -= parallel * columns[0, k]
    return float(power)


@jit_fast_inline
def _fill_normal(work: _Workspace) -> bool:
    """Fill the normal matrix; tell whether the patch has texture in two directions."""
    columns = work.columns
    normal = work.normal
    for a in range(4):
        for b in range(a, 4):
            total = np.float32(0.0)
            for k in range(columns.shape[1]):
                total += columns[1 + a, k] * columns[1 + b, k]
            normal[a, b] = normal[b, a] = total
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[0, 1]
    return bool(determinant > MIN_TEXTURE_RATIO * (normal[0, 0] + normal[1, 1]) ** 2)


@jit_fast_inline
def _compare(image: FloatImage, plane: tuple[float, float, float, float], power: float, work: _Workspace) -> float:
    """Fill the products; return the mean squared residual, grey levels squared.

    The residual is NaN if the patch leaves the image or the image has no texture there.
    """
    columns = work.columns
    pixels = work.pixels
    products = work.products
    centre_x, centre_y, slope_u, slope_v = plane
    size = pixels.columns.size
    half = half_width(pixels.columns.size)
    reach = half * (abs(1.0 - slope_u) + abs(slope_v))
    height, width = image.shape
    if centre_x < reach or centre_x + reach >= width - 1.001 or centre_y < half or centre_y + half >= height - 1.001:
        return np.nan
    x = np.float32(centre_x)
    y = np.float32(centre_y)
    along_u = np.float32(1.0 - slope_u)
    along_v = np.float32(slope_v)
    level = sample(image, x, y)
    total = np.float32(0.0)
    squares = np.float32(0.0)
    with_grey = np.float32(0.0)
    p0 = np.float32(0.0)
    p1 = np.float32(0.0)
    p2 = np.float32(0.0)
    p3 = np.float32(0.0)
    for k in range(size):
        i = pixels.columns[k]
        j = pixels.rows[k]
        value = sample(image, x + along_u * i - along_v * j, y + j) - level
        total += value
        squares += value * value
        with_grey += columns[0, k] * value
        p0 += columns[1, k] * value
        p1 += columns[2, k] * value
        p2 += columns[3, k] * value
        p3 += columns[4, k] * value
    power_of_samples = squares - total * total / np.float32(size)
    if power_of_samples < MIN_POWER:
        return np.nan
    gain = np.sqrt(power / power_of_samples)
    products[0] = gain * p0
    products[1] = gain * p1
    products[2] = gain * p2
    products[3] = gain * p3
    return float(max(2.0 * (power - gain * with_grey), 0.0) / size)


@jit_fast_inline
def _fit(image: FloatImage, power: float, work: _Workspace) -> bool:
    """Fit the plane of a patch, with that of its neighbours as prior; tell whether the plane is plausible."""
    start = work.start
    plane = work.plane
    rhs = work.products
    regularised = work.regularised
    inverse = work.inverse
    half = half_width(work.pixels.columns.size)
    copy_row(start, plane)
    for _ in range(SLOPE_ITERATIONS):
        square = _compare(image, (plane[0], plane[1], plane[2], plane[3]), power, work)
        if np.isnan(square):
            return False
        prior = max(square, MIN_SQUARE) / PRIOR_SIGMA**2
        for a in range(4):
            copy_row(work.normal[a], regularised[a])
        for a in range(2, 4):
            regularised[a, a] += prior
            rhs[a] += prior * (plane[a] - start[a])
        fill_inverse_4(regularised, inverse)
        moved_px = 0.0
        for a in range(4):
            step = inverse[a, 0] * rhs[0] + inverse[a, 1] * rhs[1] + inverse[a, 2] * rhs[2] + inverse[a, 3] * rhs[3]
            plane[a] -= step
            moved_px = max(moved_px, abs(step) * (1 if a < 2 else half))
        shift_px = max(abs(plane[0] - start[0]), abs(plane[1] - start[1]))
        slope = max(abs(plane[2]), abs(plane[3]))
        if not (shift_px <= MAX_SLOPE_SHIFT_PX and slope <= MAX_SLOPE):  # also NaN
            return False
        if moved_px < FINISHED_PX:
            break
    return True


@jit_fast
def refine_slopes(image: FloatImage, patches: Patch, right: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the slopes `(N, 2)` that single patches show; a patch that shows none keeps its slopes.

    Args:
        image: Right image.
        patches: `(N, 3, S * S)` of the left image, as from `cut_patches`.
        right: `(N, 2)` centres of the patches in the right image; NaN if unknown.
        slope: `(N, 2)` slopes of the planes of their neighbours.
    """
    refined = slope.copy()
    size = patches.shape[2]
    matrices = np.zeros((3, 4, 4))
    vectors = np.zeros((3, 4))
    columns = np.empty((5, size), np.float32)
    normal, regularised, inverse = matrices
    start, plane, products = vectors
    work = _Workspace(patch_pixels(size), start, plane, columns, normal, regularised, inverse, products)
    for n in range(len(patches)):
        start[0] = right[n, 0]
        start[1] = right[n, 1]
        start[2] = slope[n, 0]
        start[3] = slope[n, 1]
        if np.isnan(start[0]):
            continue
        power = _fill_columns(patches[n], work)
        if power >= MIN_POWER and _fill_normal(work) and _fit(image, power, work):
            refined[n, 0] = plane[2]
            refined[n, 1] = plane[3]
    return refined


# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
SEARCH_LEVEL = 1  #: Pyramid level of the search.
SEARCH_HALF = 4  #: Half width of the patches of the search, pixels of that level.
MIN_SEARCH_NCC = 0.75  #: Minimum normalised cross-correlation of the search.
MAX_AMBIGUITY = 0.85  #: Maximum ratio of best to second-best `1 - correlation` of the search.
NEIGHBOURS = 9  #: Maximum number of points that a local plane is fitted to.
MIN_NEIGHBOURS = 4  #: Minimum number of points that a local plane is fitted to.
PLANE_ITERATIONS = 4  #: Iterations of reweighted least squares of a local plane.
PLANE_NOISE_PX = 0.3  #: Scale of the Cauchy weight of a disparity against the local plane, pixels.
SLOPE_INFORMATION = 0.02  #: Information of the prior of zero slope, times the squared distance of the neighbours.
REFINEMENTS = 2  #: Alternations of slopes from disparities and disparities with these slopes.
MAX_SHIFT_PX = 2.5  #: Maximum correction of a disparity of the search, pixels.
ITERATIONS = 12  #: Maximum number of Gauss-Newton iterations of a disparity.
MIN_NCC = 0.7  #: Minimum normalised cross-correlation of a match.
MAX_VERTICAL_PX = 1.0  #: Maximum distance of a match from its row, pixels.
MIN_DISPARITY_PX = -0.5  #: Minimum disparity of a match, pixels: noise makes that of a point at infinity negative.


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Corners of the left image with their positions in the right one."""

    uv: FloatArray  #: `(N, 2)` left pixels.
    right: FloatArray  #: `(N, 2)` right pixels.
    covariance: FloatArray  #: `(N, 3)` uu, uv, vv of the right position at a noise of one grey level, px^2.
    residual: FloatArray  #: `(N,)` RMS, grey levels.
    slope: FloatArray  #: `(N, 2)` slopes of the local planes.
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
        known: `(M, 3)` u, v, disparity of landmarks, which support the local planes.
        max_disparity: Maximum disparity, pixels.
        offset_v: Vertical disparity of the pair, pixels, positive where the right image is lower.
        right_mask: `(H, W)`; matches where the mask is 0 are rejected. None if nothing is masked.
        own_slopes: Whether slopes are refined by the patch itself, because its neighbours are far in large images.
    """
    uv, disparity = _searched(left[SEARCH_LEVEL], right[SEARCH_LEVEL], uv, max_disparity, offset_v)
    left_image = left[0].image
    right_image = right[0].image
    templates = templates_of(cut_patches(left_image, uv, HALF))
    neighbours = _neighbours(uv, known)
    good = np.ones(len(uv), np.bool_)
    for _ in range(REFINEMENTS):
        slope = _slopes(uv, disparity, good, known, neighbours)
        tracks = _refined(right_image, templates, uv, disparity, slope, offset_v)
        good = np.isfinite(tracks.uv[:, 0])
        disparity = np.where(good, uv[:, 0] - tracks.uv[:, 0], disparity)
    slope = _slopes(uv, disparity, good, known, neighbours)
    if own_slopes:
        slope = in_halves(partial(refine_slopes, right_image), cut_patches(left_image, uv, HALF), tracks.uv, slope)
        tracks = _refined(right_image, templates, uv, disparity, slope, offset_v)
        disparity = uv[:, 0] - tracks.uv[:, 0]
    vertical = tracks.uv[:, 1] - uv[:, 1] - offset_v
    good &= (tracks.correlation > MIN_NCC) & (disparity > MIN_DISPARITY_PX) & (np.abs(vertical) < MAX_VERTICAL_PX)
    if right_mask is not None:
        good &= _is_free(right_mask, np.where(good[:, None], tracks.uv, 0.0))
    matched = Templates(templates.values[good], templates.moments[good])
    covariance = tracks.covariance[good]
    return StereoMatches(uv[good], tracks.uv[good], covariance, tracks.residual[good], slope[good], matched)


def _searched(
    left: ImageLevel, right: ImageLevel, uv: FloatArray, max_disparity: float, offset_v: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners `(N, 2)` that a search on a small level finds unambiguously, and their disparities `(N,)`.

    Corners, disparities and the vertical offset are in pixels of full size.
    """
    scale = left.scale
    small_uv = np.round((uv + 0.5) / scale - 0.5)
    margin = SEARCH_HALF + 2
    height, width = left.image.shape
    inside = np.clip(small_uv, margin, [width - 1 - margin, height - 1 - margin])
    patches = cut_patches(left.image, inside, SEARCH_HALF)
    last = int(np.ceil(max_disparity / scale))
    rows_down = int(np.round(offset_v / scale))
    search = partial(search_row, right.image, max_disparity=last, offset_v=rows_down)
    disparity, correlation, second = in_halves(search, patches[:, 0], small_uv).T
    is_distinct = 1.0 - correlation < MAX_AMBIGUITY * (1.0 - second)
    good = (correlation > MIN_SEARCH_NCC) & is_distinct
    return uv[good], disparity[good] * scale


def _neighbours(uv: FloatArray, known: FloatArray) -> Neighbours | None:
    """Return the neighbours of corners `(N, 2)` among these and known points `(M, 3)`, which follow the corners.

    None if there are too few points.
    """
    support = np.concatenate((uv, known[:, :2]))
    if not len(uv) or len(support) < MIN_NEIGHBOURS:
        return None
    order = np.argsort(support[:, 0], kind="stable")
    begin = np.searchsorted(support[order, 0], uv[:, 0])
    search = partial(nearest, support=np.ascontiguousarray(support[order]), count=min(NEIGHBOURS, len(support)))
    found = in_halves(search, uv, begin)
    return Neighbours(found.distance, order[found.numbers])


def _refined(
    right: FloatImage, templates: Templates, uv: FloatArray, disparity: FloatArray, slope: FloatArray, offset_v: float
) -> PatchTracks:
    """Track patches from the left to the right image, by the homographies of planes in disparity."""
    homographies = np.zeros((len(uv), 3, 3))
    homographies[:, 0, 0] = 1.0 - slope[:, 0]
    homographies[:, 0, 1] = -slope[:, 1]
    homographies[:, 0, 2] = slope[:, 0] * uv[:, 0] + slope[:, 1] * uv[:, 1] - disparity
    homographies[:, 1, 1] = 1.0
    homographies[:, 1, 2] = offset_v
    homographies[:, 2, 2] = 1.0
    limits = TrackingLimits(MAX_SHIFT_PX, ITERATIONS, -1.0)
    return in_halves(partial(track_patches, right, limits=limits), templates, uv, homographies)


def _is_free(mask: NDArray[np.uint8], uv: FloatArray) -> Mask:
    """Tell which pixels `(N, 2)` a mask leaves free."""
    column, row = np.rint(uv).astype(int).T
    height, width = mask.shape
    return np.asarray(mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] > 0)


def _slopes(
    uv: FloatArray, disparity: FloatArray, good: Mask, known: FloatArray, neighbours: Neighbours | None
) -> FloatArray:
    """Return the slopes `(N, 2)` of the planes through corners and their neighbours; 0 without neighbours.

    Of the corners, the good ones `(N,)` count as neighbours. The known points are `(M, 3)` u, v, disparity.
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

    The weight of a neighbour falls with its distance (Gaussian) and with its residual (Cauchy).
    """
    slopes = np.zeros((len(uv), 2))
    row = np.ones(3)  # derivative of the disparity by the unknowns: disparity at the corner, slopes
    nearness = np.empty(index.shape[1])
    for n in range(len(uv)):
        reach = max(distance[n, -1], 1.0)
        for k in range(index.shape[1]):
            nearness[k] = np.exp(-2.0 * (distance[n, k] / reach) ** 2)
        plane = np.zeros(3)
        for _ in range(PLANE_ITERATIONS):
            information = np.zeros((3, 3))
            rhs = np.zeros(3)
            # A weak prior of zero slope regularises isolated points.
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
                residual = (level - plane[0] - row[1] * plane[1] - row[2] * plane[2]) / PLANE_NOISE_PX
                weight = nearness[k] / (1.0 + residual * residual)
                for i in range(3):
                    rhs[i] += weight * row[i] * level
                    for j in range(3):
                        information[i, j] += weight * row[i] * row[j]
            plane = solve(information, rhs)
        for i in range(2):
            slopes[n, i] = min(max(plane[1 + i], -MAX_SLOPE), MAX_SLOPE)
    return slopes
