"""Images that repeat those of the pair before, whole or in part: a frozen camera, a torn transfer.

The noise of a camera makes two images of one scene differ in every textured row, so rows that are equal to the last bit
were not exposed again. A frozen image may have new noise (`frozen_images`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair, are_equal
from sfr_loc_map.localisation.estimate import StateReason
from sfr_loc_map.localisation.frozen_images import is_frozen

MIN_ROW_RANGE: Final = 8
"""Range of the grey levels of a row that has texture: sky and saturated rows are equal in all images."""
MIN_STALE_SHARE: Final = 0.05
"""Share of the rows that make an image torn."""
PROBE: Final = 64
"""Every so many columns are compared first."""


@dataclass(frozen=True, slots=True, eq=False)
class StaleRows:
    """Rows of one image that repeat the image before.

    Attributes:
        rows: `(H,)` textured rows that are equal.
        all: Whether all textured rows are, and there are some.
        stays: Whether the image is the one before, textured or not, but for new noise.
    """

    rows: Mask
    all: bool
    stays: bool


class Staleness(NamedTuple):
    """What a pair repeats of the pair before.

    Attributes:
        left, right: Of either image.
        swapped: Whether it is that pair with left and right swapped.
    """

    left: StaleRows
    right: StaleRows
    swapped: bool

    @property
    def is_repeated(self) -> bool:
        """Whether both images are those of the pair before, but for new noise; if need be swapped."""
        return (self.left.stays and self.right.stays) or self.swapped


def stale_rows(before: GreyImage, now: GreyImage) -> StaleRows:
    """Return which textured rows of an image are those of the image before, to the last bit."""
    same = (before[:, ::PROBE] == now[:, ::PROBE]).all(axis=1)
    if not same.any():
        return StaleRows(same, all=False, stays=False)
    same &= (before == now).all(axis=1)
    textured = np.ptp(now, axis=1) >= MIN_ROW_RANGE
    rows, stays = same & textured, bool(same.all())
    if np.count_nonzero(rows) < MIN_STALE_SHARE * len(now):
        return StaleRows(np.zeros(len(now), np.bool_), all=False, stays=stays)
    return StaleRows(rows, all=bool(rows[textured].all()), stays=stays)


class StaleImageFilter:
    """Blanks what an image repeats from the one before, so that nothing is tracked there.

    A part that stays the same for longer is no torn image but something fixed to the camera, and is left as it is.

    Attributes:
        rows: `(H,)` what was blanked last.
    """

    def __init__(self) -> None:
        """Start without an image."""
        self._before: StereoPair | None = None
        self._last: Staleness | None = None
        self.rows: Mask = np.zeros(0, np.bool_)

    def compare(self, pair: StereoPair) -> Staleness:
        """Return what a pair repeats of the pair before that was taken by `fresh`."""
        before = self._before
        if before is None:
            nothing = StaleRows(np.zeros(len(pair.left), np.bool_), all=False, stays=False)
            return Staleness(nothing, nothing, swapped=False)
        swapped = are_equal(before.right, pair.left) and are_equal(before.left, pair.right)
        return Staleness(_stale(before.left, pair.left), _stale(before.right, pair.right), swapped)

    def fresh(self, pair: StereoPair, found: Staleness) -> tuple[StereoPair, StateReason | None]:
        """Return the pair with stale parts blanked, and the reason to doubt it, if there is one.

        Args:
            pair: It is what the next one is compared with.
            found: By `compare`.
        """
        before, self._before = self._before, pair
        last, self._last = self._last, found
        if before is None or last is None or not (found.left.rows.any() or found.right.rows.any()):
            return pair, None
        # a frozen image is always compared with the one that was exposed
        kept_left = before.left if found.left.all else pair.left
        kept_right = before.right if found.right.all else pair.right
        self._before = StereoPair(pair.stamp_ns, kept_left, kept_right)
        left, right = _new_rows(found.left, last.left), _new_rows(found.right, last.right)
        if not (left.any() or right.any()):
            return pair, None
        reason = StateReason.REPEATED_IMAGES if found.left.all or found.right.all else StateReason.TORN_IMAGES
        self.rows = left | right
        return replace(pair, left=_blanked(pair.left, left), right=_blanked(pair.right, right)), reason


def _stale(before: GreyImage, now: GreyImage) -> StaleRows:
    """Return the rows of an image that are stale: those that are equal, or all of a frozen one."""
    if is_frozen(before, now):
        return StaleRows(np.ones(len(now), np.bool_), all=True, stays=True)
    return stale_rows(before, now)


def _new_rows(now: StaleRows, before: StaleRows) -> Mask:
    """Return the rows to be blanked."""
    return now.rows if now.all else now.rows & ~before.rows


def _blanked(image: GreyImage, rows: Mask) -> GreyImage:
    if not rows.any():
        return image
    blanked = image.copy()
    blanked[rows] = 0
    return blanked
