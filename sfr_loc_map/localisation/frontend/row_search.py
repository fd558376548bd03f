"""Initial disparities of corners: a search along the rows of the right image on a coarse pyramid level."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import MIN_POWER, Patch, cut_patches, half_width, normalise
from sfr_loc_map.localisation.frontend.pyramid import Pyramid
from sfr_loc_map.parallel import in_halves

SEARCH_LEVEL = 1
"""Pyramid level of the search. Level 1 has half as many disparities and a quarter of the pixels of level 0. The
refinement corrects the remaining error."""
SEARCH_HALF = 4
"""Half width of the patches of the search, px of the level. 9 x 9 px of the level cover 18 x 18 px of the image. In
larger patches, slopes and edges lower the correlation. Smaller patches are more ambiguous."""
MIN_SEARCH_NCC = 0.75
"""Minimum normalised cross-correlation of the search. A larger value loses landmarks on slopes. A smaller value leaves
more wrong matches to the refinement."""
MAX_AMBIGUITY = 0.85
"""Maximum ratio of the best to the second-best `1 - correlation` of the search (compare Lowe 2004, section 7.1)."""
MIN_PEAK_DISTANCE = 2
"""Distance from the best correlation, px of the level, up to which a correlation belongs to the same peak."""


@jit_fast_inline
def _fill_scores(
    image: FloatImage, template: Patch, power: np.float32, u: int, v: int, sums: Patch, scores: FloatArray
) -> None:
    """Fill the correlations of a template with the patches along a row.

    The first patch is centred at the pixel (u, v), and there is one patch for each score. Scores are in reverse order
    of the patches. The score of a textureless patch is -1. `sums` `(3, P)` is a workspace for the sums over each patch:
    values, squares, products with the template.
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

    position: float  #: Index of the maximum, refined by a parabola.
    score: float
    second: float  #: Largest score more than `MIN_PEAK_DISTANCE` away from the maximum.


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

    Patches are not warped: the left pixel (u, v) is compared with the right pixel (u - d, v + offset_v) for each whole
    disparity d from -1 to `max_disparity`. A parabola through the best correlation and its neighbours gives a fraction.

    Returns `(N, 3)`: the disparity of the best correlation, the best correlation, and the correlation of the second
    peak. All three are 0 if the patch has no texture, is at the border, or fewer than three disparities fit.
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
        # All disparities, from `last` down to -1, are compared in one pass along the row.
        _fill_scores(image, template, power, u - last, v, sums, scores[: last + 2])
        peak = _peak(scores[: last + 2])
        found[n, 0] = peak.position - 1.0
        found[n, 1] = peak.score
        found[n, 2] = peak.second
    return found


def search_corners(
    left: Pyramid, right: Pyramid, uv: FloatArray, max_disparity: float, offset_v: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners `(N, 2)` that the search finds unambiguously, and their disparities `(N,)`.

    Corners, disparities and the vertical offset are in pixels of full size.
    """
    left_level = left[SEARCH_LEVEL]
    scale = left_level.scale
    small_uv = np.round((uv + 0.5) / scale - 0.5)
    margin = SEARCH_HALF + 2
    height, width = left_level.image.shape
    inside = np.clip(small_uv, margin, [width - 1 - margin, height - 1 - margin])
    patches = cut_patches(left_level.image, inside, SEARCH_HALF)
    last = int(np.ceil(max_disparity / scale))
    rows_down = int(np.round(offset_v / scale))
    search = partial(search_row, right[SEARCH_LEVEL].image, max_disparity=last, offset_v=rows_down)
    disparity, correlation, second = in_halves(search, patches[:, 0], small_uv).T
    is_distinct = 1.0 - correlation < MAX_AMBIGUITY * (1.0 - second)
    good = (correlation > MIN_SEARCH_NCC) & is_distinct
    return uv[good], disparity[good] * scale
