"""Pictures that cannot give a map are refused by name; those that give a poor one are named in warnings."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.filters import box_mean
from sfr_loc_map.mapping.rectification_correction import Alignment
from sfr_loc_map.mapping.semi_global_matching import match

LEAST_CONTRAST = 2.0
"""Standard deviation of a picture's grey levels below which there is nothing to match."""
LEAST_TEXTURED = 0.02
"""Share of the picture that must have texture for its matches to be judged."""
REFUSED_SHARE = 0.3
"""Share of the textured pixels that must find their partner."""
POOR_SHARE = 0.6
ROWS_WARNING_PX = 0.3
GAIN_WARNING = 1.15
COARSE = 2


def check_images(pair: StereoPair) -> None:
    """Refuse pictures without content.

    Raises:
        MappingError: If one is black, white or flat, or both are the same.
    """
    for name, image in (("left", pair.left), ("right", pair.right)):
        deviation = float(cv2.meanStdDev(image)[1][0, 0])
        if deviation < LEAST_CONTRAST:
            raise MappingError(
                f"{name} picture of stamp {pair.stamp_ns} is flat (mean {image.mean():.0f}, spread {deviation:.1f} "
                f"grey levels): a spread of {LEAST_CONTRAST} is needed; check the camera, its cap and its exposure"
            )
    if np.array_equal(pair.left, pair.right):
        raise MappingError(
            f"left and right pictures of stamp {pair.stamp_ns} are the same: give the picture of the other camera"
        )


def matched_share(left: FloatImage, usable: Mask) -> float:
    """Return the share of the left picture's textured pixels that have a disparity; NaN if there are too few.

    Texture is a local spread of twice the noise; noise is measured by a mask that cancels smooth structure
    (Immerkaer 1996).
    """
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], np.float32)
    noise = 1.4826 * float(np.median(np.abs(np.asarray(cv2.filter2D(left, -1, mask))[::2, ::2]))) / 6.0
    variance = box_mean(np.square(left), 7) - np.square(box_mean(left, 7))
    textured = variance > max(2.0 * noise, 1.0) ** 2
    if textured.mean() < LEAST_TEXTURED:
        return float("nan")
    return float(usable[textured].mean())


def check_matches(pair: StereoPair, share: float, alignment: Alignment, count: int) -> tuple[str, ...]:
    """Return what is suspicious about a pair, one line each.

    Args:
        pair: The pictures.
        share: As `matched_share` gives it.
        alignment: How the right picture had to be set right.
        count: Disparities that were searched.

    Raises:
        MappingError: If so little matches that what does would be chance.
    """
    if share < REFUSED_SHARE:
        raise MappingError(
            f"pictures of stamp {pair.stamp_ns} do not match: {100 * share:.0f} % of the textured pixels found a "
            f"partner, {100 * REFUSED_SHARE:.0f} % are needed; {_likely_cause(pair, count)}"
        )
    warnings = []
    if share < POOR_SHARE:
        warnings.append(f"only {100 * share:.0f} % of the textured pixels found a partner")
    if alignment.largest_rows_px > ROWS_WARNING_PX:
        warnings.append(
            f"rows are off by up to {alignment.largest_rows_px:.2f} px between left and right (made up for): "
            "check the rectification"
        )
    if not 1.0 / GAIN_WARNING < alignment.gain < GAIN_WARNING:
        warnings.append(f"the right picture has {alignment.gain:.2f} times the contrast of the left (made up for)")
    return tuple(warnings)


def _likely_cause(pair: StereoPair, count: int) -> str:
    """Tell what is wrong by matching at half the size, as given and the other way round."""
    left, right = (_small(image) for image in (pair.left, pair.right))
    coarse = 16 * max(1, -(-count // (16 * COARSE)))
    as_given, swapped = (float(np.isfinite(match(a, b, coarse)).mean()) for a, b in ((left, right), (right, left)))
    if swapped > max(1.5 * as_given, 0.5):
        return "left and right seem swapped: exchange them"
    return "check that they are rectified, of the same moment and of this rig"


def _small(image: GreyImage) -> GreyImage:
    size = (image.shape[1] // COARSE, image.shape[0] // COARSE)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
