"""A right camera that turns slowly: detected and followed from pair to pair.

The bundle adjustment knows the yaw of the right camera from depths over a whole window, which takes it to be constant.
A camera that turns while the window lasts shifts the right images against landmarks that were made before; each pair
shows that to a hundredth of a pixel.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from sfr_loc_map.localisation.frontend.right_shift import RightShift

MIN_PAIRS: Final = 8
MAX_PAIRS: Final = 16
"""Fewest and most consecutive pairs that a drift is judged by."""
SIGMAS: Final = 5.0
"""Standard errors beyond which the shift is a drift."""
FLOOR_PX: Final = 0.015
"""Shift that is no drift, whatever its standard error."""
AFTERMATH_PAIRS: Final = 20
"""Pairs after the last correction in which the camera still counts as drifting."""


class RightDrift:
    """Follows the yaw of the right camera."""

    def __init__(self) -> None:
        """Start without a drift."""
        self._shifts: deque[float] = deque(maxlen=MAX_PAIRS)
        self._still_pairs = AFTERMATH_PAIRS

    @property
    def active(self) -> bool:
        """Whether the camera drifts, or has just done so."""
        return self._still_pairs < AFTERMATH_PAIRS

    def interrupt(self) -> None:
        """Forget the last pairs, as where tracking was lost."""
        self._shifts.clear()

    def learn(self, shift: RightShift) -> float:
        """Take the shift of a pair; return by how much its right positions are to be corrected, pixels.

        A line through the shifts of the last pairs gives the present one and its standard error: a steady drift is no
        noise, and a shift of one pair alone (vibration, cameras out of step) is no drift.
        """
        if not np.isfinite(shift.variance):
            return 0.0
        self._shifts.append(shift.px)
        self._still_pairs += 1
        count = len(self._shifts)
        if count < MIN_PAIRS:
            return 0.0
        shifts, pairs = np.array(self._shifts), np.arange(count) - 0.5 * (count - 1)
        slope = float(pairs @ shifts) / float(pairs @ pairs)
        mean = shifts.mean()
        now = float(mean) + slope * float(pairs[-1])
        noise2 = float(np.square(shifts - mean - slope * pairs).sum()) / (count - 2)
        sigma = np.sqrt(noise2 * (1.0 / count + pairs[-1] ** 2 / float(pairs @ pairs)))
        if abs(now) < FLOOR_PX + SIGMAS * sigma:
            return 0.0
        self._shifts = deque((shifts - now).tolist(), maxlen=MAX_PAIRS)
        self._still_pairs = 0
        return now
