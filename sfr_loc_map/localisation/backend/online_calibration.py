"""What the pictures themselves say of small errors of the stereo calibration.

A right camera that is turned by some hundredths of a degree is the commonest error of a rig that was knocked or
warmed up. What it does to the rows is seen in every stereo match: an offset that grows from one side to the other. Its
offset along the columns makes all depths wrong, and so the length of the drive; it shows only where depths from stereo
disagree with depths from motion, in the adjustment of the window.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

FIRST_SIGMA_PX: Final = 0.3
"""How far a rig may be off along the columns before anything was seen (standard deviation)."""
DRIFT_PX: Final = 0.002
"""Random walk of the offset from one keyframe to the next."""
LARGEST_STEP_PX: Final = 0.05
"""Largest change of what is corrected along the columns from one keyframe to the next."""
FEWEST: Final = 20
"""Matches needed to learn from a keyframe."""
ROW_NOISE_PX: Final = 0.15
"""Usual noise of the row of a match."""
KEPT: Final = 0.98
"""Weight that what was known of the rows keeps with each keyframe."""
ROWS_PRIOR: Final = (1e-3, 5e-3)
"""Weight of no offset and of no roll before anything was seen, in keyframes."""
SURE: Final = 4.0
"""Standard deviations from which on an offset is taken as real; a rig without error is left alone."""


class RightOffset:
    """Learns how the right camera is turned against its calibration.

    Attributes:
        u: Pixels by which the middle of right pictures lies too far right; 0 until it is beyond doubt.
        found_u: What `u` is on its way to, in small steps.
        v: Pixels by which it lies too low.
        roll: Turn about the optical axis, pixels at a distance of the focal length.
    """

    def __init__(self, camera: FloatArray, window_keyframes: int) -> None:
        """Start with a rig that is right; camera is fx, fy, cx, cy.

        As many windows as a window has keyframes share what they see, and count as one.
        """
        self.u, self.found_u, self.v, self.roll = 0.0, 0.0, 0.0, 0.0
        self._camera, self._share = camera, float(window_keyframes)
        self._mean, self._variance = 0.0, FIRST_SIGMA_PX**2
        self._normal, self._right_side = np.diag(ROWS_PRIOR), np.zeros(2)

    @property
    def sigma_u(self) -> float:
        """Standard deviation of `found_u`, pixels."""
        return float(np.sqrt(self._variance))

    def at(self, places: FloatArray) -> FloatArray:
        """Return the offsets `(N, 2)` of places `(N, 2)` in right pictures, pixels: the flow of a small turn."""
        x, y = ((places - self._camera[2:]) / self._camera[:2]).T
        along_u = self.u * (1.0 + x * x) + self.v * x * y - self.roll * y
        along_v = self.v * (1.0 + y * y) + self.u * x * y + self.roll * x
        return np.column_stack((along_u, along_v))

    def learn_rows(self, places: FloatArray, offsets: FloatArray) -> None:
        """Learn from stereo matches.

        Args:
            places: `(N, 2)` in the right picture, pixels.
            offsets: `(N,)` row there minus row in the left picture, pixels.
        """
        if len(offsets) < FEWEST:
            return
        x, y = ((places - self._camera[2:]) / self._camera[:2]).T
        columns = np.column_stack((1.0 + y * y, x))
        level = offsets - self.u * x * y
        before, prior = np.array([self.v, self.roll]), np.diag(ROWS_PRIOR)
        rest = level - columns @ before
        change = np.array([float(np.median(rest)), 0.0])
        for _ in range(5):  # what this keyframe says by itself tells which of its matches are wrong
            weight = 1.0 / (1.0 + ((rest - columns @ change) / ROW_NOISE_PX) ** 2) / len(rest)
            weighted = (columns * weight[:, None]).T
            change = np.linalg.solve(prior + weighted @ columns, weighted @ rest)
        # all keyframes together: matches on one side of the picture say little of the other
        self._normal = KEPT * self._normal + weighted @ columns
        self._right_side = KEPT * self._right_side + weighted @ level
        self.v, self.roll = map(float, np.linalg.solve(self._normal, self._right_side))

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
        before, sure = self.u, abs(self._mean) > SURE * self.sigma_u
        self.found_u = self._mean if sure else 0.0
        # in small steps, as the pose moves a little with each
        self.u += float(np.clip(self.found_u - self.u, -LARGEST_STEP_PX, LARGEST_STEP_PX))
        return self.u - before
