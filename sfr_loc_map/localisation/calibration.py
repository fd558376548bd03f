"""What the pictures themselves say of small errors of the stereo calibration.

A right picture that lies off by a fraction of a pixel is the commonest error of a rig that was knocked or warmed up.
Along the rows it is seen in every stereo match. Along the columns it makes all depths wrong, and so the length of the
drive; it shows only where depths from stereo disagree with depths from motion, in the adjustment of the window.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sfr_loc_map.geometry.rotation import FloatArray

FIRST_SIGMA_PX: Final = 0.3
"""How far a rig may be off along the columns before anything was seen (standard deviation)."""
DRIFT_PX: Final = 0.002
"""Random walk of the offset from one keyframe to the next."""
SURE: Final = 4.0
"""Standard deviations from which on an offset is taken as real; a rig without error is left alone."""


class RightOffset:
    """Learns by how many pixels right pictures lie too far right and too low.

    Attributes:
        u: Offset along the columns that is corrected, pixels; 0 until it is beyond doubt.
        v: Offset along the rows that is corrected, pixels.
    """

    def __init__(self, window_keyframes: int) -> None:
        """Start with a rig that is right; `window_keyframes` windows share what they see, and count as one."""
        self.u, self.v = 0.0, 0.0
        self._share = float(window_keyframes)
        self._mean, self._variance = 0.0, FIRST_SIGMA_PX**2
        self._first = True

    def learn_rows(self, offsets: FloatArray) -> None:
        """Learn from stereo matches: row in the right picture minus row in the left `(N,)`, pixels."""
        if len(offsets) >= 20:
            rate = 1.0 if self._first else 0.1
            self.v += rate * (float(np.median(offsets)) - self.v)
            self._first = False

    def learn_columns(self, beyond: float, variance: float) -> float:
        """Learn from an adjusted window.

        Args:
            beyond: By how many pixels right pictures lie too far right, with `u` taken away.
            variance: Of that, px^2; infinite where the window says nothing.

        Returns:
            By how much `u` has changed, pixels.
        """
        self._variance += DRIFT_PX**2
        gain = self._variance / (self._variance + variance * self._share)
        self._mean += gain * (self.u + beyond - self._mean)
        self._variance *= 1.0 - gain
        before = self.u
        self.u = self._mean if abs(self._mean) > SURE * np.sqrt(self._variance) else 0.0
        return self.u - before
