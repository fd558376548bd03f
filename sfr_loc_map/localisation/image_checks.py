"""Images that are not what the cameras see now: frozen or repeated ones, torn transfers.

- The noise of a camera makes two images of one scene differ in every textured row, so rows that are equal to the last
  bit were not exposed again.
- A frozen image may have new noise. It shows the same scene twice, as a rover that stands still does. A camera that is
  exposed again has noise of its own in either image: where noise made the first one brighter, the second one is darker,
  as far as they differ at all (regression to the mean, slope -1/2). An old image with noise added differs by what does
  not depend on it (slope 0). Where hardly a pixel differs, there was no exposure at all.
- A torn image is of two exposures: above some row new, below it of the pair before, or the other way round.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.estimate import StateReason

ROW_STEPS: Final = (16, 1)  #: Every so many rows are compared; more of them where the first ones do not decide.
MAX_NOISE: Final = 12.0
"""Standard deviation of a difference, grey levels, beyond which it is no noise: most moving images are told by it."""
MAX_NEIGHBOUR_CORRELATION: Final = 0.2
"""Correlation of neighbouring pixels of a difference beyond which it is no noise: what moves leaves edges."""
UNEXPOSED, OVEREXPOSED = 8, 247  #: Grey levels beyond which noise is cut off.
MIN_PIXELS: Final = 256  #: Fewest exposed pixels that tell anything.
MIDDLE_SLOPE: Final = -0.25
"""Slope of the difference over the first image, between that of two exposures and that of an old image."""
STANDARD_ERRORS: Final = 4.0
CALM_SHARE: Final = 0.1
"""Quantile of the texture beside a pixel from which on it counts less: noise is seen best where there is little."""
MAX_CHANGED: Final = 0.1
"""Share of the exposed pixels that differ in an image that was not exposed again; noise of a tenth of a grey level
makes a tenth of the pixels of two exposures differ."""
MIN_ROW_RANGE: Final = 8
"""Range of the grey levels of a row that has texture: sky and saturated rows are equal in all images."""
MIN_STALE_SHARE: Final = 0.05  #: Share of the rows that make an image torn.
PROBE: Final = 64  #: Every so many columns, or rows, are compared first.


class StaleRows(NamedTuple):
    """Rows of one image that repeat the image before."""

    rows: Mask  #: `(H,)` textured rows that are equal.
    all: bool  #: Whether all textured rows are, and there are some.
    stays: bool  #: Whether the image is the one before, textured or not, but for new noise.


class StaleImageFilter:
    """Blanks what an image repeats from the one before, which is not tracked; `rows` `(H,)` is what was blanked last.

    A part that stays the same for longer is no torn image but something fixed to the camera, and is left as it is.
    """

    def __init__(self) -> None:
        self._before: StereoPair | None = None
        self.rows: Mask = np.zeros(0, np.bool_)
        self._last: tuple[StaleRows, StaleRows] | None = None

    def fresh(self, pair: StereoPair, *, may_repeat: bool) -> tuple[StereoPair | None, StateReason | None]:
        """Return a pair with stale parts blanked, and the reason to doubt it; the next one is compared with it.

        None, and nothing else happens, if it may repeat the pair before and both images are those but for new noise,
        also if swapped.
        """
        before, last = self._before, self._last
        if before is None or last is None:
            self._before, nothing = pair, StaleRows(np.zeros(len(pair.left), np.bool_), all=False, stays=False)
            self._last = nothing, nothing
            return pair, None
        few = slice(len(pair.left) // 2, None, PROBE)  # rows that tell most others
        swapped = np.array_equal(before.right[few], pair.left[few])
        swapped = swapped and np.array_equal(before.right, pair.left) and np.array_equal(before.left, pair.right)
        stale = []
        for old, new in ((before.left, pair.left), (before.right, pair.right)):
            # most images move, and differ by more than noise: this is cheap
            change = cv2.subtract(new[1 : -1 : ROW_STEPS[0]], old[1 : -1 : ROW_STEPS[0]], dtype=cv2.CV_32F)
            little = cv2.meanStdDev(change)[1].item() ** 2 <= 1.1 * MAX_NOISE**2  # rounded
            if little and is_frozen(old, new):
                stale.append(StaleRows(np.ones(len(new), np.bool_), all=True, stays=True))
                continue
            same = (old[:, ::PROBE] == new[:, ::PROBE]).all(axis=1)
            rows, whole = np.zeros(len(new), np.bool_), False
            if same.any():
                same &= (old == new).all(axis=1)
                textured = np.ptp(new, axis=1) >= MIN_ROW_RANGE
                if np.count_nonzero(same & textured) >= MIN_STALE_SHARE * len(new):
                    rows, whole = same & textured, bool(same[textured].all())
            stale.append(StaleRows(rows, whole, stays=bool(same.all())))
        left, right = stale
        if may_repeat and (swapped or (left.stays and right.stays)):
            return None, None
        self._last, self._before = (left, right), pair
        if not (left.rows.any() or right.rows.any()):
            return pair, None
        # a frozen image is always compared with the one that was exposed
        kept_left = before.left if left.all else pair.left
        kept_right = before.right if right.all else pair.right
        self._before = StereoPair(pair.stamp_ns, kept_left, kept_right)
        blank_left, blank_right = (
            now.rows if now.all else now.rows & ~old.rows for now, old in zip((left, right), last, strict=True)
        )
        if not (blank_left.any() or blank_right.any()):
            return pair, None
        self.rows = blank_left | blank_right
        reason = StateReason.REPEATED_IMAGES if left.all or right.all else StateReason.TORN_IMAGES
        return replace(pair, left=_blanked(pair.left, blank_left), right=_blanked(pair.right, blank_right)), reason


def _blanked(image: GreyImage, rows: Mask) -> GreyImage:
    if not rows.any():
        return image
    blanked = image.copy()
    blanked[rows] = 0
    return blanked


def is_frozen(before: GreyImage, now: GreyImage) -> bool:
    """Tell whether an image is one before it with new noise; equal images have none and are not told."""
    for step in ROW_STEPS:
        change = np.asarray(cv2.subtract(now[1:-1:step], before[1:-1:step], dtype=cv2.CV_32F), np.float32)
        # noise is little, and each pixel's own
        centred = change - change.mean()
        variance = float(np.mean(np.square(centred)))
        alike = float(np.mean(centred[:, 1:] * centred[:, :-1]))
        if variance > MAX_NOISE**2 or not alike <= MAX_NEIGHBOUR_CORRELATION * variance:
            return False
        first = before[1:-1:step].astype(np.float32)
        exposed = (first[:, 1:-1] > UNEXPOSED) & (first[:, 1:-1] < OVEREXPOSED)
        if np.count_nonzero(exposed) < MIN_PIXELS:
            return False
        # what is weighted by the texture of other rows has noise of any sign
        beside = (np.abs(_second_difference(rows.astype(np.float32))) for rows in (before[:-2:step], before[2::step]))
        texture = np.maximum(*beside)[exposed]
        scale = float(np.quantile(texture, CALM_SHARE)) + 1.0
        weight = np.asarray(1.0 / (np.square(texture) + scale**2), np.float32)
        # the weighted slope of the changes over the image, in their power, and its standard error
        there, changes = _second_difference(first)[exposed], _second_difference(change)[exposed]
        power = float(np.sum(weight * np.square(changes)))
        if power > 0.0:
            products = weight * there * changes
            slope, error = float(np.sum(products)) / power, float(np.sqrt(np.sum(np.square(products)))) / power
            if abs(slope - MIDDLE_SLOPE) > STANDARD_ERRORS * error:
                return slope > MIDDLE_SLOPE
    return float(np.mean(change[:, 1:-1][exposed] != 0.0)) < MAX_CHANGED and not np.array_equal(before, now)


def _second_difference(image: FloatImage) -> FloatImage:
    """Return what varies from pixel to pixel along the rows: noise, and little of the scene."""
    return np.asarray(2.0 * image[:, 1:-1] - image[:, :-2] - image[:, 2:], np.float32)
