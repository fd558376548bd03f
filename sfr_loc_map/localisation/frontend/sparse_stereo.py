"""Disparities of single corners: search along the row, then least squares with the slope of the local plane."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.small_linalg import solve
from sfr_loc_map.jit import jit_fast
from sfr_loc_map.localisation.frontend.image_pyramid import Pyramid
from sfr_loc_map.localisation.frontend.nearest_neighbours import nearest
from sfr_loc_map.localisation.frontend.patch_tracking import HALF, cut_patches, normalise, track_patches
from sfr_loc_map.localisation.parallel import in_halves

SEARCH_LEVEL = 1
SEARCH_HALF = 4
NEIGHBOURS = 9
"""Points that a local plane is fitted to."""
FEWEST = 4
"""Points that a plane is fitted to at least."""
MAX_SLOPE = 0.7
"""Steepest plane, pixels of disparity a pixel: beyond, the right camera hardly sees it."""


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Corners of the left picture with their places in the right one.

    Attributes:
        uv: `(N, 2)` left pixels.
        right: `(N, 2)` right pixels.
        covariance: `(N, 3)` uu, uv, vv of the right place for a noise of one grey level, px^2.
        residual: `(N,)` RMS, grey levels.
        slope: `(N, 2)` change of the disparity a pixel of the local plane.
        patches: `(N, 3, S * S)` left patches with gradients.
    """

    uv: FloatArray
    right: FloatArray
    covariance: FloatArray
    residual: FloatArray
    slope: FloatArray
    patches: NDArray[np.float32]

    @property
    def disparity(self) -> FloatArray:
        """Disparities `(N,)`, pixels."""
        return np.asarray(self.uv[:, 0] - self.right[:, 0])

    def outside(self, mask: NDArray[np.uint8] | None) -> StereoMatches:
        """Return the matches that do not fall where the right picture is masked (0)."""
        if mask is None:
            return self
        column, row = np.rint(self.right).astype(int).T
        kept = mask[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)] > 0
        return StereoMatches(*(getattr(self, item.name)[kept] for item in fields(self)))


def match_corners(
    left: Pyramid, right: Pyramid, uv: FloatArray, known: FloatArray, max_disparity: float, offset_v: float
) -> StereoMatches:
    """Match corners of the left picture in the right one.

    Args:
        left: Left pyramid.
        right: Right pyramid.
        uv: `(N, 2)` whole pixels.
        known: `(M, 3)` u, v, disparity of landmarks around, which help to find the local planes.
        max_disparity: Largest disparity looked for, pixels.
        offset_v: Rows by which the right picture lies lower than rectified ones should, pixels.

    Returns:
        The corners that were matched, fewer than were given.
    """
    disparity, found = _search(left, right, uv, max_disparity, offset_v)
    uv, disparity = uv[found], disparity[found]
    patches = cut_patches(left.levels[0], uv, HALF)
    planes = _LocalPlanes(uv, known)
    good = np.ones(len(uv), np.bool_)
    for _ in range(2):
        slope = planes.slopes(disparity, good)
        tracked = _refine(right.levels[0], patches, uv, disparity, slope, offset_v)
        good = np.isfinite(tracked[:, 0])
        disparity = np.where(good, uv[:, 0] - tracked[:, 0], disparity)
    slope = planes.slopes(disparity, good)
    good &= (tracked[:, 6] > 0.7) & (np.abs(tracked[:, 1] - uv[:, 1] - offset_v) < 1.0) & (disparity > -0.5)
    return StereoMatches(
        uv[good],
        tracked[good, :2],
        tracked[good, 2:5],
        tracked[good, 5],
        slope[good],
        np.ascontiguousarray(patches[good]),
    )


def _refine(
    right: FloatImage, patches: NDArray[np.float32], uv: FloatArray, disparity: FloatArray, slope: FloatArray, dv: float
) -> FloatArray:
    homographies = np.zeros((len(uv), 3, 3))
    homographies[:, 0, 0] = 1.0 - slope[:, 0]
    homographies[:, 0, 1] = -slope[:, 1]
    homographies[:, 0, 2] = slope[:, 0] * uv[:, 0] + slope[:, 1] * uv[:, 1] - disparity
    homographies[:, 1, 1] = homographies[:, 2, 2] = 1.0
    homographies[:, 1, 2] = dv

    def track(patches: NDArray[np.float32], uv: FloatArray, homographies: FloatArray) -> FloatArray:
        return np.asarray(track_patches(right, patches, uv, homographies, 2.5, 12))

    return in_halves(track, patches, uv, homographies)


def _search(
    left: Pyramid, right: Pyramid, uv: FloatArray, max_disparity: float, offset_v: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    scale = 2.0**SEARCH_LEVEL
    small = np.round((uv + 0.5) / scale - 0.5)
    patches = cut_patches(
        left.levels[SEARCH_LEVEL], _inside(small, left.levels[SEARCH_LEVEL], SEARCH_HALF + 2), SEARCH_HALF
    )
    last, down = int(np.ceil(max_disparity / scale)), int(np.round(offset_v / scale))

    def scan(patches: NDArray[np.float32], small: FloatArray) -> FloatArray:
        return np.asarray(_scan(right.levels[SEARCH_LEVEL], patches, small, last, down))

    found = in_halves(scan, patches[:, 0], small)
    good = (found[:, 1] > 0.75) & (1.0 - found[:, 1] < 0.85 * (1.0 - found[:, 2]))
    return found[:, 0] * scale, good


def _inside(uv: FloatArray, image: FloatImage, margin: int) -> FloatArray:
    height, width = image.shape
    return np.clip(uv, margin, [width - 1 - margin, height - 1 - margin])


@jit_fast
def _scan(  # noqa: C901 - one loop of machine code
    image: FloatImage, patches: NDArray[np.float32], uv: FloatArray, max_disparity: int, offset_v: int
) -> FloatArray:
    count = len(patches)
    height, width = image.shape
    half = (int(np.sqrt(patches.shape[1] + 0.5)) - 1) // 2
    side = 2 * half + 1
    out = np.zeros((count, 3))
    sums, scores = np.empty((3, max_disparity + 2), np.float32), np.empty(max_disparity + 2)
    for n in range(count):
        template = patches[n].copy()
        power = normalise(template)
        u, v = int(uv[n, 0]), int(uv[n, 1]) + offset_v
        last = min(max_disparity, u - half)
        if power < 1e-3 or v < half or v >= height - half or u >= width - half or last < 2:
            continue
        # place p is the disparity last - p: all of them at once, along the row
        places = last + 2
        total, square, dot = sums[0, :places], sums[1, :places], sums[2, :places]
        sums[:, :places] = 0.0
        usable = places if u + 1 + half < width else places - 1
        k = 0
        for j in range(v - half, v + half + 1):
            for i in range(-half, half + 1):
                row = image[j, u - last + i :]
                weight = template[k]
                k += 1
                for p in range(usable):
                    value = row[p]
                    total[p] += value
                    square[p] += value * value
                    dot[p] += value * weight
        scores[:places] = -1.0
        for p in range(usable):
            variance = square[p] - total[p] * total[p] / (side * side)
            if variance > 1e-3:
                scores[last + 1 - p] = dot[p] / np.sqrt(variance * power)
        best, second = 0, -1.0
        for d in range(1, last + 2):
            if scores[d] > scores[best]:
                best = d
        for d in range(last + 2):
            if abs(d - best) > 2:
                second = max(second, scores[d])
        refined = float(best)
        if 0 < best < last + 1:
            curvature = scores[best - 1] - 2.0 * scores[best] + scores[best + 1]
            if curvature < 0.0:
                refined += 0.5 * (scores[best - 1] - scores[best + 1]) / curvature
        out[n, 0], out[n, 1], out[n, 2] = refined - 1.0, scores[best], second
    return out


class _LocalPlanes:
    """The planes in disparity around points, fitted to the points near them."""

    def __init__(self, uv: FloatArray, known: FloatArray) -> None:
        """Find the neighbours of points `(N, 2)` among themselves and known ones `(M, 3)` (u, v, disparity), pixels."""
        self._uv, self._known = uv, known
        self._support = np.concatenate((uv, known[:, :2]))
        count = min(NEIGHBOURS, len(self._support))
        self._enough = count >= FEWEST and len(uv) > 0
        if self._enough:
            self._distance, self._index = nearest(uv, self._support, count)

    def slopes(self, disparity: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
        """Return the change `(N, 2)` of the disparity `(N,)` along u and v; only good `(N,)` points are fitted to."""
        if not self._enough:
            return np.zeros((len(self._uv), 2))
        support = np.column_stack((self._support, np.concatenate((disparity, self._known[:, 2]))))
        usable = np.concatenate((good, np.ones(len(self._known), np.bool_)))

        def fit(uv: FloatArray, disparity: FloatArray, index: NDArray[np.intp], distance: FloatArray) -> FloatArray:
            return np.asarray(_fit_slopes(uv, disparity, index, distance, support, usable))

        return in_halves(fit, self._uv, disparity, self._index, self._distance)


@jit_fast
def _fit_slopes(
    uv: FloatArray,
    disparity: FloatArray,
    index: NDArray[np.int64],
    distance: FloatArray,
    support: FloatArray,
    usable: NDArray[np.bool_],
) -> FloatArray:
    out = np.zeros((len(uv), 2))
    row, h, g, plane = np.ones(3), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for n in range(len(uv)):
        reach = max(distance[n, -1], 1.0)
        plane[:] = 0.0
        for _ in range(4):
            # a weak wish for a level patch keeps lonely points sane
            h[:], g[:] = 0.0, 0.0
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
