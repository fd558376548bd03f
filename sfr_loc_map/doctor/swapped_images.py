"""Detection of swapped left and right cameras from a few image pairs."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage

StampedImage = tuple[int, GreyImage]
CORNERS = 80  #: Maximum number of patches of an image.
QUALITY = 0.02  #: Minimum quality of a corner, relative to the best corner.
PATCH_PX = 6  #: Half the side of a patch, px.
MIN_NCC = 0.85  #: Minimum normalised cross-correlation of a match.
MIN_MATCHES = 10  #: Minimum number of matches on the wrong side.
MIN_RATIO = 4.0  #: Minimum ratio of matches on the wrong side to correct matches.


def are_swapped(lefts: Sequence[StampedImage], rights: Sequence[StampedImage]) -> bool:
    """Return whether patches of the left images match further to the right in the right images of the nearest stamp.

    A point at depth Z in front of parallel cameras with focal length f has the disparity
    u_left - u_right = f baseline / Z > 0.
    """
    if lefts[0][1].shape != rights[0][1].shape:
        return False
    wrong = correct = 0
    for stamp_ns, left in lefts:
        _, right = min(rights, key=lambda item: abs(item[0] - stamp_ns))
        corners = cv2.goodFeaturesToTrack(left, CORNERS, QUALITY, 2.0 * PATCH_PX)
        for u, v in np.rint(np.empty((0, 2)) if corners is None else corners[:, 0]).astype(int):
            top, first = max(v - PATCH_PX, 0), max(u - PATCH_PX, 0)
            patch = left[top : v + PATCH_PX + 1, first : u + PATCH_PX + 1]
            scores = cv2.matchTemplate(right[top : v + PATCH_PX + 1], patch, cv2.TM_CCOEFF_NORMED)[0]
            best = int(np.argmax(scores))
            if scores[best] > MIN_NCC:
                wrong += best > first
                correct += best < first
    return wrong >= MIN_MATCHES and wrong > MIN_RATIO * correct
