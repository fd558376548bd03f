"""Comparison of a pair with the previous pair, to detect parts of its images that were not exposed again.

- Camera noise makes two images of one scene differ in every textured row. Bit-identical rows were therefore not exposed
  again.
- A frozen image may have new noise, and then resembles the image of a stationary rover. The noise of the first image
  distinguishes the two. If the scene s was exposed twice, the images are s + n1 and s + n2, and their change n2 - n1
  contains the noise of the first image. The slope of the regression of the first image on the change is then -1/2, by
  `cov(n1, n2 - n1) / var(n2 - n1)`. If the second image is a copy of the first one with new noise, the change is this
  noise alone, and the slope is 0. If hardly any pixel differs, there was no exposure at all. Frozen images with new
  noise are known from injected faults only (`faults.kinds`), and no device with this fault has been recorded. In one
  drive with this fault and with left and right swapped, an error of a step was 546 times its 3 sigma without the test
  of swapped repeats, and 0.79 times with this test (measurements/localiser_injected_faults.md).
- A partially transferred image consists of two exposures. The rows above a boundary are new and those below are from
  the previous pair, or vice versa.

| term | meaning |
|---|---|
| stale | not exposed again since the previous pair |
| frozen image | image in which all textured rows are stale |
| partial transfer | image in which some textured rows are stale and others are new |
| repeated pair | pair of two frozen images, or a pair that repeats the previous pair with left and right swapped |

A pair whose left and right images are copies of one image, possibly with different noise, is detected by the same test
of noise (`show_one_image`).

Stale parts are blanked, so that nothing is tracked in them. Rows that are stale in two consecutive pairs are assumed to
show something fixed to the camera (own body, sky), and are not blanked in the second pair. If two consecutive partial
transfers affect the same rows, the second pair is therefore not blanked, and is left to `ground.selection`. A frozen
image between two exposures is skipped in this comparison, because all its rows are stale.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.jit import jit

# The thresholds were chosen by hand on rendered drives with injected faults and with noise of up to about ten grey
# levels.

ROW_STEPS: Final = (16, 1)  #: Row steps of the comparison: all rows are compared if every 16th is not decisive.
MAX_NOISE: Final = 12.0
"""Maximum standard deviation of the difference of two images of the same view, grey levels. Two exposures with a noise
of 8 grey levels differ by 11.3 grey levels. If larger, more pairs require the second test. If smaller, frozen images
with noise count as new."""
NOISE_MARGIN: Final = 1.1
"""Factor on the maximum variance in the first test, which only saves time. The second test does not use this factor.
The value is above 1, because images are rounded. If larger, more pairs require the second test."""
MAX_NEIGHBOUR_CORRELATION: Final = 0.2
"""Maximum correlation of the differences of neighbouring pixels if the scene did not move: 0 for noise, nearly 1 for
moved texture. If larger, blurred motion counts as noise. If smaller, slightly correlated noise hides a frozen image."""
EXPOSED: Final = (8, 247)
"""Grey levels between which noise is not clipped. The value is eight grey levels from either end. In a wider range,
clipped noise biases the slope. A narrower range contains fewer pixels."""
MIN_PIXELS: Final = 256  #: Minimum number of exposed pixels for a decision: the error of their slope is about 1/16.
MIDDLE_SLOPE: Final = -0.25  #: Slope midway between that of two exposures (-1/2) and that of a frozen image (0).
STANDARD_ERRORS: Final = 4.0
"""Minimum distance of the slope from `MIDDLE_SLOPE` for a decision, in standard errors, so that one of 30 000 decisions
is wrong by chance (normal errors). If larger, all rows are compared more often."""
CALM_QUANTILE: Final = 0.1
"""Quantile of the texture in neighbouring rows that sets the scale of the weights. Pixels beside more texture have less
weight. If larger, moved texture increases the error of the slope. If smaller, fewer pixels contribute."""
MAX_CHANGED: Final = 0.1
"""Maximum fraction of exposed pixels that differ in an image that was not exposed again. With a noise of 0.1 grey
levels, a tenth of the pixels of two exposures differ."""
MIN_ROW_RANGE: Final = 8
"""Minimum range of grey levels of a textured row, because sky and saturated rows are equal in all images. If larger,
stale rows of weak texture are not detected. If smaller, rows without texture count as stale."""
MIN_STALE_FRACTION: Final = 0.05
"""Fraction of stale rows from which an image is partially transferred: fewer rows contain few landmarks."""
MIN_TEXTURE_RATIO: Final = 2.0
"""Minimum ratio of the variance of the texture to that of the noise if left and right are the same image. The variances
are those of the differences between neighbouring pixels in a row. The ratio is 0.5 for two images of equal noise
without texture. If larger, a copy with much noise is not detected. If smaller, images of little texture count as
identical."""
MIN_DEVIATION: Final = 1.0
"""Minimum standard deviation of the grey levels of a textured image at full resolution. Rounding to whole grey levels
causes at most 0.5."""
PROBE: Final = 64  #: Row step of a quick comparison, which shows for nearly all images that they differ.


class RepeatedRows(NamedTuple):
    """Rows of one image that repeat the previous image."""

    rows: Mask  #: `(H,)` textured rows that are bit-identical; all rows if the image is repeated with new noise.
    is_frozen: bool  #: Whether all textured rows are repeated; False if too few rows are textured.
    is_fully_repeated: bool  #: Whether the whole image is repeated, textured or not, possibly with new noise.

    @property
    def is_stale(self) -> bool:
        """Whether no part of the image was exposed again. Two such images make the pair a repeated pair."""
        return self.is_frozen or self.is_fully_repeated


class ImageMemory(NamedTuple):
    """What the next pair is compared with."""

    pair: StereoPair  #: The last pair that was not repeated; a frozen image is replaced by the last exposed image.
    left: RepeatedRows  #: Repeated rows of the left image of this pair; unchanged by a frozen image.
    right: RepeatedRows  #: Likewise of the right image.


class ImageComparison(NamedTuple):
    """Comparison of a pair with the previous pair."""

    #: The pair with its stale parts blanked. A repeated pair is not blanked, because its two images belong together.
    pair: StereoPair
    memory: ImageMemory  #: What the next pair is compared with.
    blanked_rows: Mask  #: `(H,)` rows that were blanked in an image whose other rows are new.
    is_repeated: bool = False  #: Whether both images repeat the previous pair, possibly swapped.
    is_left_frozen: bool = False  #: Whether the left image repeats the previous left image, and is blanked.
    is_right_frozen: bool = False  #: Whether the right image repeats the previous right image, and is blanked.

    @property
    def has_stale_rows(self) -> bool:
        """Whether rows were blanked in an image whose other rows are new."""
        return bool(self.blanked_rows.any())

    @property
    def is_one_frozen(self) -> bool:
        """Whether exactly one image is frozen; False for a repeated pair."""
        return self.is_left_frozen or self.is_right_frozen


def compare(pair: StereoPair, memory: ImageMemory | None) -> ImageComparison:
    """Compare a pair with the previous pair, and blank the parts that were not exposed again."""
    nothing = np.zeros(len(pair.left), np.bool_)
    if memory is None:
        fresh = RepeatedRows(nothing, is_frozen=False, is_fully_repeated=False)
        return ImageComparison(pair, ImageMemory(pair, fresh, fresh), nothing)
    before = memory.pair
    left = repeated_rows(before.left, pair.left)
    right = repeated_rows(before.right, pair.right)
    if is_swapped_repeat(before, pair) or (left.is_stale and right.is_stale):
        return ImageComparison(pair, memory, nothing, is_repeated=True)
    if not (left.rows.any() or right.rows.any()):
        return ImageComparison(pair, ImageMemory(pair, left, right), nothing)
    # later images are compared with the last exposed image, not with its frozen copy
    exposed_left = before.left if left.is_frozen else pair.left
    exposed_right = before.right if right.is_frozen else pair.right
    exposed = StereoPair(pair.stamp_ns, exposed_left, exposed_right)
    rows_left = memory.left if left.is_frozen else left
    rows_right = memory.right if right.is_frozen else right
    # rows that were already stale in the previous pair are fixed to the camera
    new_stale_left = nothing if left.is_frozen else left.rows & ~memory.left.rows
    new_stale_right = nothing if right.is_frozen else right.rows & ~memory.right.rows
    blank_left = left.rows if left.is_frozen else new_stale_left
    blank_right = right.rows if right.is_frozen else new_stale_right
    return ImageComparison(
        pair=replace(pair, left=_blanked(pair.left, blank_left), right=_blanked(pair.right, blank_right)),
        memory=ImageMemory(exposed, rows_left, rows_right),
        blanked_rows=new_stale_left | new_stale_right,
        is_left_frozen=left.is_frozen,
        is_right_frozen=right.is_frozen,
    )


def repeated_rows(before: GreyImage, now: GreyImage) -> RepeatedRows:
    """Return the rows of an image that repeat the previous image."""
    some = slice(1, -1, ROW_STEPS[0])
    if not _differ_by_more_than_noise(before[some], now[some]) and is_repeated_with_noise(before, now):
        return RepeatedRows(np.ones(len(now), np.bool_), is_frozen=True, is_fully_repeated=True)
    same = equal_rows(before, now)
    if not same.any():
        return RepeatedRows(same, is_frozen=False, is_fully_repeated=False)
    textured = np.ptp(now, axis=1) >= MIN_ROW_RANGE
    rows = same & textured
    if np.count_nonzero(rows) >= MIN_STALE_FRACTION * len(now):
        return RepeatedRows(rows, is_frozen=bool(same[textured].all()), is_fully_repeated=bool(same.all()))
    return RepeatedRows(np.zeros(len(now), np.bool_), is_frozen=False, is_fully_repeated=bool(same.all()))


def _differ_by_more_than_noise(before: GreyImage, now: GreyImage) -> bool:
    """Return whether some rows of two images differ by more than noise. In nearly all pairs, few rows decide."""
    change = cv2.subtract(now, before, dtype=cv2.CV_32F)
    return cv2.meanStdDev(change)[1].item() ** 2 > NOISE_MARGIN * MAX_NOISE**2


@jit
def equal_rows(before: GreyImage, now: GreyImage) -> Mask:
    """Return which rows `(H,)` of two images are equal. The first different pixel of a row decides."""
    height, width = now.shape
    same = np.zeros(height, np.bool_)
    for row in range(height):
        column = 0
        while column < width and before[row, column] == now[row, column]:
            column += 1
        same[row] = column == width
    return same


def is_swapped_repeat(before: StereoPair, now: StereoPair) -> bool:
    """Return whether a pair is the previous pair with left and right swapped, possibly with new noise."""
    few = slice(len(now.left) // 2, None, PROBE)
    if _differ_by_more_than_noise(before.right[few], now.left[few]):
        return False
    return (
        repeated_rows(before.right, now.left).is_fully_repeated
        and repeated_rows(before.left, now.right).is_fully_repeated
    )


def show_one_image(pair: StereoPair) -> bool:
    """Return whether left and right are the same textured image, possibly with different noise.

    The images of two cameras differ by the disparities, so that the differences of neighbouring pixels are correlated
    (`MAX_NEIGHBOUR_CORRELATION`). The noise must be smaller than the texture, because two images without texture
    differ by noise alone as well.
    """
    few = slice(len(pair.left) // 2, None, PROBE)
    if _differ_by_more_than_noise(pair.left[few], pair.right[few]):
        return False
    change = np.asarray(cv2.subtract(pair.right, pair.left, dtype=cv2.CV_32F), np.float32)
    if not _is_noise(change) or float(np.std(pair.left)) <= MIN_DEVIATION:
        return False
    texture = np.diff(pair.left.astype(np.float32), axis=1)
    noise = np.diff(change, axis=1)
    return float(np.var(texture)) > MIN_TEXTURE_RATIO * float(np.var(noise))


def _blanked(image: GreyImage, rows: Mask) -> GreyImage:
    """Return an image with some rows `(H,)` black."""
    if not rows.any():
        return image
    blanked = image.copy()
    blanked[rows] = 0
    return blanked


def is_repeated_with_noise(before: GreyImage, now: GreyImage) -> bool:
    """Return whether an image is an earlier image with new noise; False for bit-identical images."""
    for step in ROW_STEPS:
        change = np.asarray(cv2.subtract(now[1:-1:step], before[1:-1:step], dtype=cv2.CV_32F), np.float32)
        if not _is_noise(change):
            return False
        first = before[1:-1:step].astype(np.float32)
        exposed = (first[:, 1:-1] > EXPOSED[0]) & (first[:, 1:-1] < EXPOSED[1])
        if np.count_nonzero(exposed) < MIN_PIXELS:
            return False
        slope = _slope(before, change, exposed, step)
        if slope is not None and abs(slope.value - MIDDLE_SLOPE) > STANDARD_ERRORS * slope.standard_error:
            return slope.value > MIDDLE_SLOPE
    # the slope is not decisive: the image is frozen if hardly any pixel differs
    return float(np.mean(change[:, 1:-1][exposed] != 0.0)) < MAX_CHANGED and not np.array_equal(before, now)


def _is_noise(change: FloatImage) -> bool:
    """Return whether a change between two images is small, and independent from pixel to pixel."""
    centred = change - change.mean()
    variance = float(np.mean(np.square(centred)))
    covariance = float(np.mean(centred[:, 1:] * centred[:, :-1]))
    return variance <= MAX_NOISE**2 and covariance <= MAX_NEIGHBOUR_CORRELATION * variance


class _Slope(NamedTuple):
    """Slope of the regression of the first image on the change."""

    value: float
    standard_error: float


def _slope(before: GreyImage, change: FloatImage, exposed: Mask, step: int) -> _Slope | None:
    """Return the slope of the first image on changes `(R, W)` in exposed pixels `(R, W - 2)`; None if nothing changed.

    The weight of a pixel decreases with the texture of the rows above and below, whose noise is independent of the
    noise of the pixel.
    """
    above = np.abs(_second_difference(before[:-2:step].astype(np.float32)))
    below = np.abs(_second_difference(before[2::step].astype(np.float32)))
    texture = np.maximum(above, below)[exposed]
    scale = float(np.quantile(texture, CALM_QUANTILE)) + 1.0  # at least one grey level, for images without texture
    weight = np.asarray(1.0 / (np.square(texture) + scale**2), np.float32)
    first = _second_difference(before[1:-1:step].astype(np.float32))[exposed]
    changes = _second_difference(change)[exposed]
    power = float(np.sum(weight * np.square(changes)))
    if power <= 0.0:
        return None
    products = weight * first * changes
    return _Slope(float(np.sum(products)) / power, float(np.sqrt(np.sum(np.square(products)))) / power)


def _second_difference(image: FloatImage) -> FloatImage:
    """Return the second difference along the rows, which contains noise and little of the scene."""
    return np.asarray(2.0 * image[:, 1:-1] - image[:, :-2] - image[:, 2:], np.float32)
