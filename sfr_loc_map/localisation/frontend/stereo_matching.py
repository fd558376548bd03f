"""Stereo matching of single corners: a search along the row, then least squares with the slopes of the local plane.

1. `row_search` finds an initial disparity of each corner on a coarse pyramid level.
2. `neighbour_slopes` fits a local plane to the disparities of the neighbours. The patch is warped by this plane and
   tracked from the left to the right image. Fit and tracking are repeated, because better disparities give better
   planes.
3. In large images `patch_slopes` refines the slopes from the patch itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.localisation.frontend.neighbour_slopes import neighbours_of, slopes_of
from sfr_loc_map.localisation.frontend.patch import HALF, Templates, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.patch_slopes import refine_slopes
from sfr_loc_map.localisation.frontend.patch_tracking import PatchTracks, TrackingLimits, track_patches
from sfr_loc_map.localisation.frontend.pyramid import Pyramid
from sfr_loc_map.localisation.frontend.row_search import search_corners
from sfr_loc_map.parallel import in_halves

REFINEMENTS = 2
"""Number of fits of slopes that are each followed by tracking with these slopes. The first fit uses the disparities of
the search, and the second fit uses the tracked disparities. The slopes of the new landmarks are those of a last fit."""
MAX_SHIFT_PX = 2.5  #: Maximum correction of a disparity of the search, px. One step of the search is 2 px.
ITERATIONS = 12
"""Maximum number of Gauss-Newton iterations of a disparity: twice that of a track, which starts closer to the
solution."""
MIN_NCC = 0.7
"""Minimum normalised cross-correlation of a match. The value exceeds that of a track, because both images are taken at
the same time."""
MAX_VERTICAL_PX = 1.0
"""Maximum difference between the vertical disparities of a match and of the pair, px: seven times the noise of a
match."""
MIN_DISPARITY_PX = -0.5  #: Minimum disparity of a match, px. Noise can make the disparity at infinity negative.


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Corners of the left image with their positions in the right image."""

    uv: FloatArray  #: `(N, 2)` left pixels.
    right: FloatArray  #: `(N, 2)` right pixels.
    covariance: FloatArray  #: `(N, 3)` uu, uv, vv of the right position at a noise of one grey level, px^2.
    residual: FloatArray  #: `(N,)` RMS of the residual, grey levels.
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
    """Match corners of the left image, `(N, 2)` whole pixels, with the right image; return the matched corners.

    Args:
        left: Left pyramid.
        right: Right pyramid.
        uv: The corners.
        known: `(M, 3)` u, v, disparity of landmarks, which support the local planes.
        max_disparity: Maximum disparity, pixels.
        offset_v: Vertical disparity of the pair, pixels, positive where the right image is lower.
        right_mask: `(H, W)`; matches where the mask is 0 are rejected. None if nothing is masked.
        own_slopes: Whether the slopes of a patch are refined from its own pixels, because in large images its
            neighbours are too far away.
    """
    uv, disparity = search_corners(left, right, uv, max_disparity, offset_v)
    left_image = left[0].image
    right_image = right[0].image
    templates = templates_of(cut_patches(left_image, uv, HALF))
    neighbours = neighbours_of(uv, known)
    good = np.ones(len(uv), np.bool_)
    for _ in range(REFINEMENTS):
        slope = slopes_of(uv, disparity, good, known, neighbours)
        tracks = _refined(right_image, templates, uv, disparity, slope, offset_v)
        good = np.isfinite(tracks.uv[:, 0])
        disparity = np.where(good, uv[:, 0] - tracks.uv[:, 0], disparity)
    slope = slopes_of(uv, disparity, good, known, neighbours)
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


def _refined(
    right: FloatImage, templates: Templates, uv: FloatArray, disparity: FloatArray, slope: FloatArray, offset_v: float
) -> PatchTracks:
    """Track patches from the left to the right image, by the homographies of planes in disparity.

    A left pixel (u, v) is mapped to the right pixel (u - d(u, v), v + offset_v). The disparity d is a linear function
    of the pixel with the given slopes, and has the given value at the corner.
    """
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
    """Return which pixels `(N, 2)` are not masked."""
    column, row = np.rint(uv).astype(int).T
    height, width = mask.shape
    return np.asarray(mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] > 0)
