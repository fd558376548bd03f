"""Checks of the mapper's input: unusable input is refused, and the message names the likely cause."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.plausibility import plausible_rotations
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching

MAX_LM_M = 1e4
"""Maximum coordinate of the cameras in LM, metres. Points are float32 numbers, which are rounded by up to 0.5 mm at
this distance from the origin. Rounding errors are not part of sigma."""
MIN_CONTRAST = 2.0
"""Minimum standard deviation of an image, grey levels. Images of a covered camera with low noise are below this
threshold. Images of a covered camera with more noise pass this check, but do not match."""
MIN_MEASURED_FRACTION = 0.3
"""Minimum fraction of the textured pixels that must be measured; below this fraction, matches are due to chance. On
four data sets (rendered ground, KITTI, Middlebury, Mars) the fraction is 0.07 or less for swapped images, 0.01 or less
if one image is upside down, and 0.64 or more for correct images (measurements/mapper_trials.md)."""
COARSE_FACTOR = 2
"""Images are downsampled by this factor to find the cause of a mismatch quickly."""
SWAPPED_FACTOR = 1.5
"""Images are probably swapped if exchanging them multiplies the number of matched pixels by more than this factor.
Chosen by hand: images that match about equally well in both orders are not swapped."""
VERTICAL_FACTOR = 4
"""Images are downsampled by this factor to find a vertical offset: they then match at offsets of one row, too."""
MAX_VERTICAL_ROWS = 4  #: Largest vertical offset that is tried, rows of the downsampled images: 16 pixels.
MIN_OFFSET_FRACTION = 0.75
"""Images probably have a vertical offset only if more than this fraction of the downsampled pixels matches with the
offset. On the data sets named above the fraction is 0.79 or more for pairs with offsets of 3, 6 and 12 pixels, and 0.4
or less if one image is upside down. Swapped images, with up to 0.71, are recognised first."""
CHANCE_FRACTION = 0.6
"""Fraction of the downsampled pixels above which matches count in the estimate of the offset: at wrong offsets of two
rows and more, the fraction is mostly below."""
MIN_OFFSET_PX = 2  #: Smallest vertical offset that is reported, pixels: the estimate has an error of 2 pixels.
MIN_SWAPPED_FRACTION = 0.5
"""Images are probably swapped only if more than this fraction of the pixels matches after the exchange. On the same
data sets the fraction is 0.75 or more for swapped images, and 0.2 or less for unrelated images."""


def check_index(index: int) -> None:
    """Raise MappingError if the index of a pair is not an integer, or is out of range."""
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < MAX_PAIRS:
        raise MappingError(f"pair index is {index}: an integer from 0 to {MAX_PAIRS - 1} is required")


def check_pair(pair: StereoPair) -> None:
    """Raise MappingError if a pair is another object."""
    if not isinstance(pair, StereoPair):
        raise MappingError(f"the pair has the type {type(pair).__name__}: a StereoPair is required")


def check_items(items: Sequence[object], kind: type, required: str) -> None:
    """Raise MappingError unless the items are a sequence of objects of one type, which `required` describes."""
    if not isinstance(items, Sequence) or not all(isinstance(item, kind) for item in items):
        raise MappingError(f"a sequence of {required} is required, for example a list")


def check_pair_count(count: int) -> None:
    """Raise MappingError if a map cannot be fused from this number of pairs."""
    if not 1 <= count <= MAX_PAIRS:
        raise MappingError(f"{count} pairs given: 1 to {MAX_PAIRS} are required for a map")


def check_pose(stamp_ns: int, T_lm_navsb: Transform) -> None:
    """Raise MappingError if a pose is another object, has an invalid rotation, or is far from the origin of LM."""
    if not isinstance(T_lm_navsb, Transform):
        raise MappingError(
            f"the pose of stamp {stamp_ns} has the type {type(T_lm_navsb).__name__}: a Transform is required"
        )
    if not plausible_rotations(T_lm_navsb.rotation):
        raise MappingError(
            f"the pose of stamp {stamp_ns} has an invalid rotation: {T_lm_navsb.rotation.tolist()}: an orthonormal "
            "matrix with determinant +1 is required"
        )
    if not (np.abs(T_lm_navsb.translation) <= MAX_LM_M).all():
        raise MappingError(
            f"the pose of stamp {stamp_ns} is at {T_lm_navsb.translation.tolist()} m in LM: at most {MAX_LM_M:g} m is "
            "allowed, because points are rounded to float32; choose an origin of LM near the rover, and subtract its "
            "position from the poses of all pairs"
        )


def check_images(pair: StereoPair, rig: StereoRig) -> None:
    """Raise MappingError if the images do not have the rig's size, one is textureless, or both are identical."""
    if fault := rig.fault_of_size(pair.left):  # the right image has the size of the left image
        raise MappingError(f"image of stamp {pair.stamp_ns} {fault}")
    for name, image in (("left", pair.left), ("right", pair.right)):
        _, deviations = cv2.meanStdDev(image)
        deviation = float(deviations[0, 0])
        if deviation < MIN_CONTRAST:
            raise MappingError(
                f"{name} image of stamp {pair.stamp_ns} is textureless (mean {image.mean():.0f}, standard "
                f"deviation {deviation:.1f} grey levels): a standard deviation of {MIN_CONTRAST} is required; check "
                "the camera, its cap and its exposure"
            )
    if np.array_equal(pair.left, pair.right):
        raise MappingError(
            f"left and right images of stamp {pair.stamp_ns} are identical: use the image of the other camera"
        )


def check_matches(pair: StereoPair, disparity_map: DisparityMap, disparity_count: int) -> None:
    """Raise MappingError if so few textured pixels are measured that their matches are due to chance.

    If too few pixels are textured, the fraction is NaN and the pair passes; `findings_of_pair` then adds a warning.
    """
    fraction = disparity_map.measured_textured_fraction
    if fraction < MIN_MEASURED_FRACTION:
        raise MappingError(
            f"images of stamp {pair.stamp_ns} do not match: only {100 * fraction:.0f} % of the textured pixels "
            f"could be matched, {100 * MIN_MEASURED_FRACTION:.0f} % are required; "
            f"{_likely_cause(pair, disparity_count)}"
        )


def _likely_cause(pair: StereoPair, disparity_count: int) -> str:
    """Return the likely cause of a mismatch, from matching the downsampled images in other ways."""
    left = _downsampled(pair.left, COARSE_FACTOR)
    right = _downsampled(pair.right, COARSE_FACTOR)
    coarse_count = math.ceil(disparity_count / COARSE_FACTOR)
    matched_as_given = _matched_fraction(left, right, coarse_count)
    matched_swapped = _matched_fraction(right, left, coarse_count)
    if matched_swapped > max(SWAPPED_FACTOR * matched_as_given, MIN_SWAPPED_FRACTION):
        return "left and right are probably swapped: exchange them"
    offset_px = _vertical_offset_px(pair, disparity_count)
    if abs(offset_px) >= MIN_OFFSET_PX:
        direction = "lower" if offset_px > 0 else "higher"
        return f"the right image is probably about {abs(offset_px)} rows {direction}: rectify the images"
    return (
        "check that they are rectified, taken at the same time and by this rig, and that no surface is nearer than "
        "min_range_m"
    )


def _vertical_offset_px(pair: StereoPair, disparity_count: int) -> int:
    """Return the vertical offset at which the downsampled images match, pixels; 0 if they do not match.

    The offset is positive if content of the right image is lower.

    The offset is the mean of the best of the tried offsets and its neighbours, weighted by the matched fraction above
    `CHANCE_FRACTION`.
    """
    left = _downsampled(pair.left, VERTICAL_FACTOR)
    right = _downsampled(pair.right, VERTICAL_FACTOR)
    count = math.ceil(disparity_count / VERTICAL_FACTOR)
    offsets = np.arange(-MAX_VERTICAL_ROWS, MAX_VERTICAL_ROWS + 1)
    matched = np.array([_matched_fraction(left, np.roll(right, -rows, axis=0), count) for rows in offsets])
    if matched.max() <= MIN_OFFSET_FRACTION:
        return 0
    best = offsets[np.argmax(matched)]
    weights = np.maximum(matched - CHANCE_FRACTION, 0.0) * (np.abs(offsets - best) <= 1)
    return round(VERTICAL_FACTOR * float(np.average(offsets, weights=weights)))


def _downsampled(image: GreyImage, factor: int) -> GreyImage:
    """Return an image downsampled by an integer factor."""
    height, width = image.shape
    return np.asarray(cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA), np.uint8)


def _matched_fraction(left: GreyImage, right: GreyImage, count: int) -> float:
    """Return the fraction of the pixels that are matched with `count` searched disparities."""
    return float(np.isfinite(semi_global_matching(left, right, count)).mean())
