"""Disparities of single corners: search along the row, then least squares with the slope of the local plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.small_linalg import solve
from sfr_loc_map.jit import jit_fast
from sfr_loc_map.localisation.frontend.image_pyramid import Pyramid
from sfr_loc_map.localisation.frontend.nearest_neighbours import nearest
from sfr_loc_map.localisation.frontend.patch import HALF, Patch, Templates, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.patch_slopes import refine_slopes
from sfr_loc_map.localisation.frontend.patch_tracking import PatchTracks, TrackingLimits, track_patches
from sfr_loc_map.localisation.frontend.row_search import RowSearch, search_row
from sfr_loc_map.localisation.parallel import in_halves

SEARCH_LEVEL = 1
SEARCH_HALF = 4
NEIGHBOURS = 9
"""Maximum number of points that a local plane is fitted to."""
MIN_NEIGHBOURS = 4
"""Minimum number of points that a local plane is fitted to."""
MAX_SLOPE = 0.7
"""Steepest plane, pixels of disparity per pixel: beyond, the right camera hardly sees it."""
MIN_SEARCH_NCC, MIN_NCC = 0.75, 0.7
"""Minimum normalised cross-correlation of the search and of the refined match."""
MAX_AMBIGUITY = 0.85
"""Maximum ratio of best to second-best `1 - correlation` of the search."""
MAX_VERTICAL_PX, MIN_DISPARITY_PX = 1.0, -0.5
"""Maximum distance of a match from its row, and minimum disparity, pixels."""
MAX_SHIFT_PX, ITERATIONS = 2.5, 12


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Corners of the left image with their positions in the right one.

    Attributes:
        uv: `(N, 2)` left pixels.
        right: `(N, 2)` right pixels.
        covariance: `(N, 3)` uu, uv, vv of the right position for a noise of one grey level, px^2.
        residual: `(N,)` RMS, grey levels.
        slope: `(N, 2)` change of the disparity per pixel, of the local plane.
        patches: Templates of the left patches.
    """

    uv: FloatArray
    right: FloatArray
    covariance: FloatArray
    residual: FloatArray
    slope: FloatArray
    patches: Templates

    @property
    def disparity(self) -> FloatArray:
        """Disparities `(N,)`, pixels."""
        return np.asarray(self.uv[:, 0] - self.right[:, 0])

    def outside(self, mask: NDArray[np.uint8] | None) -> StereoMatches:
        """Return the matches that do not fall where the right image is masked (0)."""
        if mask is None:
            return self
        column, row = np.rint(self.right).astype(int).T
        kept = mask[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)] > 0
        arrays = (self.uv[kept], self.right[kept], self.covariance[kept], self.residual[kept], self.slope[kept])
        return StereoMatches(*arrays, self.patches.subset(kept))


def match_corners(
    left: Pyramid,
    right: Pyramid,
    uv: FloatArray,
    known: FloatArray,
    max_disparity: float,
    offset_v: float,
    *,
    own_slopes: bool = False,
) -> StereoMatches:
    """Match corners of the left image in the right one.

    Args:
        left: Left pyramid.
        right: Right pyramid.
        uv: `(N, 2)` whole pixels.
        known: `(M, 3)` u, v, disparity of landmarks around, which help to find the local planes.
        max_disparity: Maximum disparity, pixels.
        offset_v: Vertical disparity of the pair, pixels, positive where the right image is lower.
        own_slopes: Whether patches tell their slopes, not their neighbours alone: where these are far.

    Returns:
        The corners that were matched, fewer than were given.
    """
    disparity, found = _search(left, right, uv, max_disparity, offset_v)
    uv, disparity = uv[found], disparity[found]
    templates, planes = templates_of(cut_patches(left.levels[0], uv, HALF)), _LocalPlanes(uv, known)
    good = np.ones(len(uv), np.bool_)
    for _ in range(2):
        slope = planes.slopes(disparity, good)
        tracks = _refine(right.levels[0], templates, uv, _homographies(uv, disparity, slope, offset_v))
        good = np.isfinite(tracks.uv[:, 0])
        disparity = np.where(good, uv[:, 0] - tracks.uv[:, 0], disparity)
    slope = planes.slopes(disparity, good)
    if own_slopes:
        patches = cut_patches(left.levels[0], uv, HALF)
        slope = in_halves(partial(refine_slopes, right.levels[0]), patches, tracks.uv, slope)
        del patches
        tracks = _refine(right.levels[0], templates, uv, _homographies(uv, disparity, slope, offset_v))
        disparity = uv[:, 0] - tracks.uv[:, 0]
    good &= (tracks.correlation > MIN_NCC) & (disparity > MIN_DISPARITY_PX)
    good &= np.abs(tracks.uv[:, 1] - uv[:, 1] - offset_v) < MAX_VERTICAL_PX
    covariance, residual = tracks.covariance[good], tracks.residual[good]
    return StereoMatches(uv[good], tracks.uv[good], covariance, residual, slope[good], templates.subset(good))


def _homographies(uv: FloatArray, disparity: FloatArray, slope: FloatArray, offset_v: float) -> FloatArray:
    """Return the homographies `(N, 3, 3)` of planes in disparity, from left to right pixels."""
    homographies = np.zeros((len(uv), 3, 3))
    homographies[:, 0, 0] = 1.0 - slope[:, 0]
    homographies[:, 0, 1] = -slope[:, 1]
    homographies[:, 0, 2] = slope[:, 0] * uv[:, 0] + slope[:, 1] * uv[:, 1] - disparity
    homographies[:, 1, 1] = homographies[:, 2, 2] = 1.0
    homographies[:, 1, 2] = offset_v
    return homographies


def _refine(right: FloatImage, templates: Templates, uv: FloatArray, homographies: FloatArray) -> PatchTracks:
    limits = TrackingLimits(MAX_SHIFT_PX, ITERATIONS, -1.0)

    def track(values: Patch, moments: FloatArray, uv: FloatArray, homographies: FloatArray) -> PatchTracks:
        return track_patches(right, Templates(values, moments), uv, homographies, limits)

    return in_halves(track, *templates, uv, homographies)


def _search(
    left: Pyramid, right: Pyramid, uv: FloatArray, max_disparity: float, offset_v: float
) -> tuple[FloatArray, Mask]:
    """Return disparities `(N,)` found on a small level, pixels of full size, and which are unambiguous."""
    (image, scale), target = left.level(SEARCH_LEVEL), right.levels[SEARCH_LEVEL]
    small = np.round((uv + 0.5) / scale - 0.5)
    patches = cut_patches(image, _inside(small, image, SEARCH_HALF + 2), SEARCH_HALF)
    last, down = int(np.ceil(max_disparity / scale)), int(np.round(offset_v / scale))

    def scan(patches: Patch, small: FloatArray) -> RowSearch:
        return search_row(target, patches, small, last, down)

    found = in_halves(scan, patches[:, 0], small)
    good = (found.correlation > MIN_SEARCH_NCC) & (1.0 - found.correlation < MAX_AMBIGUITY * (1.0 - found.second))
    return found.disparity * scale, good


def _inside(uv: FloatArray, image: FloatImage, margin: int) -> FloatArray:
    height, width = image.shape
    return np.clip(uv, margin, [width - 1 - margin, height - 1 - margin])


class _LocalPlanes:
    """The planes in disparity around points, fitted to the points near them."""

    def __init__(self, uv: FloatArray, known: FloatArray) -> None:
        """Find the neighbours of points `(N, 2)` among themselves and known ones `(M, 3)` (u, v, disparity), pixels."""
        self._uv, self._known = uv, known
        self._support = np.concatenate((uv, known[:, :2]))
        count = min(NEIGHBOURS, len(self._support))
        self._enough = count >= MIN_NEIGHBOURS and len(uv) > 0
        if self._enough:
            self._distance, self._index = nearest(uv, self._support, count)

    def slopes(self, disparity: FloatArray, good: Mask) -> FloatArray:
        """Return the change `(N, 2)` of the disparity `(N,)` along u and v; only good `(N,)` points are fitted to."""
        if not self._enough:
            return np.zeros((len(self._uv), 2))
        support = np.column_stack((self._support, np.concatenate((disparity, self._known[:, 2]))))
        usable = np.concatenate((good, np.ones(len(self._known), np.bool_)))

        def fit(uv: FloatArray, disparity: FloatArray, index: NDArray[np.intp], distance: FloatArray) -> FloatArray:
            return _fit_slopes(uv, disparity, index, distance, support, usable)

        return in_halves(fit, self._uv, disparity, self._index, self._distance)


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
    row, h, g, plane = np.ones(3), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for n in range(len(uv)):
        reach = max(distance[n, -1], 1.0)
        plane[:] = 0.0
        for _ in range(4):
            # a weak prior for zero slope regularises isolated points
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
