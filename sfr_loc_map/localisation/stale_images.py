"""Images that repeat those of the pair before, whole or in part: a frozen camera, a torn transfer.

The noise of a camera makes two images of one scene differ in every textured row, so rows that are equal to the last bit
were not exposed again. A frozen image may have new noise (`frozen_images`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair, are_equal
from sfr_loc_map.localisation.estimate import StateReason
from sfr_loc_map.localisation.frozen_images import is_frozen

MIN_ROW_RANGE: Final = 8
"""Range of the grey levels of a row that has texture: sky and saturated rows are equal in all images."""
MIN_STALE_SHARE: Final = 0.05
"""Share of the rows that make an image torn."""
PROBE: Final = 16
"""Every so many columns are compared first."""


@dataclass(frozen=True, slots=True, eq=False)
class StaleRows:
    """Rows of one image that repeat the image before.

    Attributes:
        rows: `(H,)` textured rows that are equal.
        all: Whether all textured rows are, and there are some.
    """

    rows: Mask
    all: bool


def stale_rows(before: GreyImage, now: GreyImage) -> StaleRows:
    """Return which textured rows of an image are those of the image before, to the last bit."""
    same = (before[:, ::PROBE] == now[:, ::PROBE]).all(axis=1)
    none = StaleRows(np.zeros(len(now), np.bool_), all=False)
    if not same.any():
        return none
    same &= (before == now).all(axis=1)
    textured = np.ptp(now, axis=1) >= MIN_ROW_RANGE
    rows = same & textured
    if np.count_nonzero(rows) < MIN_STALE_SHARE * len(now):
        return none
    return StaleRows(rows, all=bool(rows[textured].all()))


class StaleImageFilter:
    """Blanks what an image repeats from the one before, so that nothing is tracked there.

    A part that stays the same for longer is no torn image but something fixed to the camera, and is left as it is.

    Attributes:
        rows: `(H,)` what was blanked last.
    """

    def __init__(self) -> None:
        """Start without an image."""
        self._before: StereoPair | None = None
        self._stale: tuple[StaleRows | None, StaleRows | None] = None, None
        self.rows: Mask = np.zeros(0, np.bool_)

    def repeats(self, pair: StereoPair) -> bool:
        """Tell whether both images are those of the pair before, but for new noise; if need be swapped."""
        before = self._before
        if before is None:
            return False
        return _both_stay(before, pair) or is_duplicate_pair(_swapped(before), pair)

    def fresh(self, pair: StereoPair) -> tuple[StereoPair, StateReason | None]:
        """Return the pair with stale parts blanked, and the reason to doubt it, if there is one."""
        before, self._before = self._before, pair
        if before is None:
            return pair, None
        found = _stale(before.left, pair.left), _stale(before.right, pair.right)
        # a frozen image is always compared with the one that was exposed
        kept = [old if side.all else new for side, old, new in zip(found, _images(before), _images(pair), strict=True)]
        self._before = StereoPair(pair.stamp_ns, kept[0], kept[1])
        last, self._stale = self._stale, found
        left, right = (_new_rows(now, then) for now, then in zip(found, last, strict=True))
        if not (left.any() or right.any()):
            return pair, None
        reason = StateReason.REPEATED_IMAGES if any(side.all for side in found) else StateReason.TORN_IMAGES
        self.rows = left | right
        return replace(pair, left=_blanked(pair.left, left), right=_blanked(pair.right, right)), reason


def is_duplicate_pair(before: StereoPair, now: StereoPair) -> bool:
    """Tell whether two pairs have bit-identical images."""
    return are_equal(before.left, now.left) and are_equal(before.right, now.right)


def _both_stay(before: StereoPair, now: StereoPair) -> bool:
    pairs = (before.left, now.left), (before.right, now.right)
    return all(are_equal(*images) or is_frozen(*images) for images in pairs)


def _swapped(pair: StereoPair) -> StereoPair:
    return StereoPair(pair.stamp_ns, pair.right, pair.left)


def _stale(before: GreyImage, now: GreyImage) -> StaleRows:
    """Return the rows of an image that are stale: those that are equal, or all of a frozen one."""
    if is_frozen(before, now):
        return StaleRows(np.ones(len(now), np.bool_), all=True)
    return stale_rows(before, now)


def _images(pair: StereoPair) -> tuple[GreyImage, GreyImage]:
    return pair.left, pair.right


def _new_rows(now: StaleRows, before: StaleRows | None) -> Mask:
    """Return the rows to be blanked."""
    if now.all or before is None:
        return now.rows
    return now.rows & ~before.rows


def _blanked(image: GreyImage, rows: Mask) -> GreyImage:
    if not rows.any():
        return image
    blanked = image.copy()
    blanked[rows] = 0
    return blanked
