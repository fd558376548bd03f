"""Checks of images and matches: what cannot give a map is refused by name, what gives a poor one is warned of."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.mapping.disparity.filters import mad_sigma
from sfr_loc_map.mapping.disparity.right_camera import RectificationCorrection
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching

MIN_CONTRAST = 2.0  #: Standard deviation of an image's grey levels below which there is nothing to match.
MIN_TEXTURED_SHARE = 0.02  #: Share of the image that must have texture for its matches to be judged.
MIN_MATCHED_SHARE = 0.3  #: Share of the textured pixels that must be matched.
POOR_MATCHED_SHARE = 0.6
VERTICAL_WARNING_PX = 0.3  #: Less vertical disparity than this is never warned of.
VERTICAL_FACTOR = 3.0  #: Times the typical left-over distortion from which on vertical disparity is warned of.
GAIN_WARNING = 1.15
SATURATION_WARNING = 0.1
COARSE_FACTOR = 2


def check_images(pair: StereoPair, rig: StereoRig) -> None:
    """Raise MappingError if the size is not the rig's, an image is textureless, or both are identical."""
    if pair.left.shape != (rig.height, rig.width):
        raise MappingError(
            f"images of stamp {pair.stamp_ns} are {pair.left.shape[1]} x {pair.left.shape[0]}: the rig has "
            f"{rig.width} x {rig.height}; give the rig of these images"
        )
    for name, image in (("left", pair.left), ("right", pair.right)):
        deviation = float(cv2.meanStdDev(image)[1][0, 0])
        if deviation < MIN_CONTRAST:
            raise MappingError(
                f"{name} image of stamp {pair.stamp_ns} is textureless (mean {image.mean():.0f}, spread "
                f"{deviation:.1f} grey levels): a spread of {MIN_CONTRAST} is needed; check the camera, its cap and "
                "its exposure"
            )
    if np.array_equal(pair.left, pair.right):
        raise MappingError(
            f"left and right images of stamp {pair.stamp_ns} are identical: give the image of the other camera"
        )


def matched_share(left: FloatImage, variance: FloatImage, valid: Mask) -> float:
    """Return the share of the left image's textured pixels that have a disparity; NaN if there are too few.

    Texture is a local spread of twice the noise; noise is measured by a mask that cancels smooth structure
    (Immerkaer 1996). `variance` is the `local_variance` of the left image.
    """
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], np.float32)
    noise = mad_sigma(np.asarray(cv2.filter2D(left, -1, mask), np.float32)[::2, ::2]) / 6.0
    textured = variance > max(2.0 * noise, 1.0) ** 2
    count = np.count_nonzero(textured)
    if count < MIN_TEXTURED_SHARE * textured.size:
        return float("nan")
    return float(np.count_nonzero(valid & textured) / count)


def check_matches(
    pair: StereoPair,
    share: float,
    correction: RectificationCorrection,
    saturated_share: float,
    disparities: int,
    distortion_px: float,
) -> tuple[str, ...]:
    """Return what is suspicious about a pair, one line each.

    Of the textured pixels a share is matched, of all pixels a share is saturated; so many disparities were searched;
    `distortion_px` is the typical left-over distortion.

    Raises MappingError if so little matches that the rest would be chance.
    """
    if share < MIN_MATCHED_SHARE:
        raise MappingError(
            f"images of stamp {pair.stamp_ns} do not match: {100 * share:.0f} % of the textured pixels are matched, "
            f"{100 * MIN_MATCHED_SHARE:.0f} % are needed; {_likely_cause(pair, disparities)}"
        )
    warnings = []
    if math.isnan(share):
        warnings.append("too few pixels have texture above the noise: whether the images match is not known")
    if share < POOR_MATCHED_SHARE:
        warnings.append(f"only {100 * share:.0f} % of the textured pixels are matched")
    if correction.max_vertical_px > max(VERTICAL_WARNING_PX, VERTICAL_FACTOR * distortion_px):
        warnings.append(
            f"vertical disparity of up to {correction.max_vertical_px:.2f} px between left and right (compensated): "
            "check the rectification"
        )
    if not 1.0 / GAIN_WARNING < correction.gain < GAIN_WARNING:
        warnings.append(f"the right image has {correction.gain:.2f} times the contrast of the left (compensated)")
    if saturated_share > SATURATION_WARNING:
        warnings.append(
            f"{100 * saturated_share:.0f} % of the pixels are saturated: flat ones are left out, sigma of those beside "
            "them is widened; change the exposure"
        )
    return tuple(warnings)


def _likely_cause(pair: StereoPair, disparities: int) -> str:
    """Tell what is wrong by matching at half the size, as given and with left and right swapped."""
    size = (pair.left.shape[1] // COARSE_FACTOR, pair.left.shape[0] // COARSE_FACTOR)
    halves = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (pair.left, pair.right)]
    left, right = (np.asarray(half, np.uint8) for half in halves)
    count = 16 * max(1, -(-disparities // (16 * COARSE_FACTOR)))
    as_given = float(np.isfinite(semi_global_matching(left, right, count)).mean())
    swapped = float(np.isfinite(semi_global_matching(right, left, count)).mean())
    if swapped > max(1.5 * as_given, 0.5):
        return "left and right seem swapped: exchange them"
    return "check that they are rectified, of the same moment and of this rig"
