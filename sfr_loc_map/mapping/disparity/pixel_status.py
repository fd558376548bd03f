"""The status of each pixel of a disparity map: measured, filled, or the reason why its disparity is invalid."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask

StatusImage = NDArray[np.uint8]  #: `(H, W)`, the `PixelStatus` of each pixel.


class PixelStatus(IntEnum):
    """Status of a pixel. The reason for an invalid pixel is the first failed test in the order of `validity`.

    If a saturated pixel also fails an earlier test, the reason is that test. Like all saturated pixels, such a pixel is
    not filled. A filled pixel does not keep the reason for which it was invalid.

    The status is that of one pair, and the fusion does not change it. A valid pixel may therefore have no point in a
    fused cloud: `multiview.fixed_content` removes content that is fixed to the image, and `multiview.fusion` drops
    points that conflict with a point of another pair or duplicate it. `multiview.projection` compares points only with
    pixels whose neighbours are valid and on one surface.
    """

    MEASURED = 0  #: Valid: passed all tests.
    FILLED = 1  #: Valid: failed a test and was filled from the adjacent surface (`hole_filling`).
    UNMATCHED = 2  #: Rejected by the matcher: left-right check, uniqueness or speckle.
    CHANGED = 3  #: Changed too much by the refinement.
    OCCLUDED = 4  #: Occluded in the right image, or outside it.
    MISMATCHED = 5  #: Residual larger than the noise and similar to the image's contrast.
    RAMP = 6  #: On a ramp that joins two surfaces.
    NOT_A_SURFACE = 7  #: In a segment that is small or has no content in common with the right image.
    WRONG_SURFACE = 8  #: Beside a disparity jump, and probably with the disparity of the wrong side.
    SATURATED = 9  #: In a neighbourhood that is completely saturated.
    BEYOND_RANGE = 10  #: Beyond the maximum depth.


LAST_VALID = np.uint8(PixelStatus.FILLED)  #: Largest value of a valid status.


def is_valid(status: StatusImage) -> Mask:
    """Return the mask of the pixels `(H, W)` that are measured or filled."""
    valid: Mask = status <= LAST_VALID
    return valid


def with_reason(status: StatusImage, failed: Mask, reason: PixelStatus) -> StatusImage:
    """Return the status with `reason` at failed pixels that were valid."""
    newly_invalid = failed & is_valid(status)
    return np.maximum(status, newly_invalid * np.uint8(reason))  # each reason is larger than each valid status
