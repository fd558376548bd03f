"""Images of two exposures: above some row they are new, below it of the pair before, or the other way round.

Where the old rows were shown before, they are equal to the last bit (`stale_images`). Where they never were, as in the
second of two torn pairs, the landmarks on the two sides of the tear follow two motions.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.localisation.frontend.motion_segmentation import Unexplained

MIN_WITNESSES: Final = 12
"""Landmarks in view on either side of a tear that tell whether it is there."""
MIN_AGREEING: Final = 0.5
"""Share of them that agree with the pose in a whole image."""
MAX_DOUBTED_PAIRS: Final = 20
"""Pairs after a torn one that are doubted where nothing proves them whole."""
MIN_PART: Final = 30
"""Landmarks in view on the smaller side of a tear at an unknown row."""
MAX_AGREEING_BEYOND, MIN_AGREEING_WITHIN = 0.2, 0.75
"""Shares that agree with the pose on the two sides of such a tear."""
MAX_TEARS: Final = 10
"""Such pairs in a row: what lasts longer is something that moves."""


class Wholeness(IntEnum):
    """Whether an image is of one exposure; more doubtful ones are larger."""

    WHOLE = 0
    UNPROVEN = 1
    """Only one side of a tear has landmarks: they are of one moment, which may be that of the pair before."""
    TORN = 2


class TearWatch:
    """Doubts the pairs after a torn one until landmarks on both sides of the tear agree on the pose."""

    def __init__(self) -> None:
        """Start without a tear."""
        self._stale: Mask | None = None
        self._pairs = self._tears = 0

    def tear(self, stale: Mask) -> None:
        """Take a pair that is torn: some rows `(H,)` are those of the pair before."""
        self._stale, self._pairs = stale, 0

    def judge(self, unexplained: Unexplained) -> Wholeness:
        """Tell whether a tracked pair is whole; it is where there was no tear lately.

        Args:
            unexplained: Landmarks that its pose does not explain.
        """
        if self._stale is None:
            return Wholeness.WHOLE
        v, agree = rows_in_view(unexplained)
        stale = self._stale[v.astype(np.intp)]
        sides = agree[stale], agree[~stale]
        self._pairs += 1
        whole = all(len(side) >= MIN_WITNESSES and side.mean() >= MIN_AGREEING for side in sides)
        if whole or self._pairs > MAX_DOUBTED_PAIRS:
            self._stale = None
            return Wholeness.WHOLE
        witnessed = all(len(side) >= MIN_WITNESSES for side in sides)
        return Wholeness.TORN if witnessed else Wholeness.UNPROVEN

    def is_torn(self, by_each: Iterable[Unexplained]) -> bool:
        """Tell whether a pair with two motions is torn, at any row; called for all pairs with two motions.

        Args:
            by_each: What each of the motions does not explain of all landmarks.
        """
        self._tears = self._tears + 1 if all(map(has_tear, by_each)) else 0
        return 0 < self._tears <= MAX_TEARS


def has_tear(unexplained: Unexplained) -> bool:
    """Tell whether some row separates the landmarks that agree with a pose from those that do not."""
    v, agree = rows_in_view(unexplained)
    agree = agree[np.argsort(v)]
    above = np.arange(MIN_PART, len(agree) - MIN_PART + 1)
    if not len(above):
        return False
    count = np.concatenate(([0], np.cumsum(agree)))
    shares = np.stack((count[above] / above, (count[-1] - count[above]) / (len(agree) - above)))
    torn = (shares.min(axis=0) <= MAX_AGREEING_BEYOND) & (shares.max(axis=0) >= MIN_AGREEING_WITHIN)
    return bool(torn.any())


def rows_in_view(unexplained: Unexplained) -> tuple[FloatArray, Mask]:
    """Return the rows `(N,)`, pixels, of the landmarks in view, and which agree; without those fixed to the camera."""
    kept = unexplained.in_view & ~unexplained.fixed
    return unexplained.uv[kept, 1], ~unexplained.rows[kept]
