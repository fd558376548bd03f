"""Online calibration: rotation of the right camera against its calibration, estimated from the images.

A rotation of some hundredths of a degree is the commonest error of a rig after a shock or a change of temperature.
Pitch and roll show in every stereo match as vertical disparity. Yaw changes all depths, hence the length of the path;
it is observable only where depths from stereo disagree with depths from motion, in the bundle adjustment, which takes
it to be constant over a whole window. A camera that turns while the window lasts shifts the right images against
landmarks that were made before; each pair shows that to a hundredth of a pixel, and it is followed from pair to pair.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset

MIN_PAIRS: Final = 8
MAX_PAIRS: Final = 16  #: Fewest and most consecutive pairs that a drift is judged by.
SIGMAS: Final = 5.0  #: Standard errors beyond which the shift is a drift.
FLOOR_PX: Final = 0.015  #: Shift that is no drift, whatever its standard error.
AFTERMATH_PAIRS: Final = 20  #: Pairs after the last correction in which the camera still counts as drifting.
FIRST_SIGMA_PX: Final = 0.3  #: Standard deviation of the offset along the rows before any observation.
DRIFT_PX: Final = 0.002  #: Random walk of the offset per keyframe.
DRIFT_UNCERTAINTY: Final = 0.1  #: Standard deviation of each correction of a drift, as a share of it.
MAX_STEP_PX: Final = 0.05  #: Maximum change of the correction along the rows per keyframe, or, if that is more,
STEP_SHARE: Final = 0.2  #: this share of what is left to correct.
UNSETTLED_PX: Final = 0.2  #: Offset left to correct beyond which poses may be off.
MIN_MATCHES: Final = 20  #: Minimum number of matches of a keyframe that is learnt from.
VERTICAL_NOISE_PX: Final = 0.15  #: Typical noise of the vertical disparity of a match.
RETENTION: Final = 0.98  #: Weight that the information about vertical disparity keeps with each keyframe.
VERTICAL_PRIOR: Final = (1e-3, 5e-3)  #: Weight of zero pitch and zero roll before any observation, in keyframes.
BLOCKS: Final = (4, 6)  #: Rows and columns of blocks of the image, each of which has its residual.
SIGHTINGS: Final = 8  #: Pairs in which a landmark is seen, with one error.
FIRST_LENS_PX: Final = 0.08  #: What a lens is taken to leave of the disparities
LENS_PAIRS: Final = 20  #: until so many pairs have shown it.
DETECTION_SIGMAS: Final = 4.0
"""Standard deviations beyond which an offset along the rows is corrected; a rig without error is left alone."""


class OnlineCalibration:
    """Estimates the rotation error of the right camera; lengths are pixels.

    `offset` is the correction, its `u` 0 while not significant: `drift_u`, which was followed, and `constant_u`, which
    approaches `target_u`, of standard deviation `sigma_u`, in small steps. `followed_px` is the length of all of them;
    `drifts`: the right camera turns, or has just done so. `lens_px` is what is left of the disparities, RMS,
    alike in all pairs but not over the image.
    """

    def __init__(self, camera: StereoCamera, window_keyframes: int) -> None:
        """Start without an error; as many consecutive windows as one has keyframes share observations, count as one."""
        self.offset, self.target_u, self.constant_u, self.drift_u = RightOffset(), 0.0, 0.0, 0.0
        self.sigma_u = FIRST_SIGMA_PX
        self.followed_px, self.drifts = 0.0, False
        self.lens_px, self._pairs, self._residuals = 0.0, 0, np.zeros((3, BLOCKS[0] * BLOCKS[1]))
        self._shifts: deque[float] = deque(maxlen=MAX_PAIRS)
        self._still_pairs = AFTERMATH_PAIRS
        self._camera, self._shared = camera, float(window_keyframes)
        self._mean_u, self._variance_u = 0.0, FIRST_SIGMA_PX**2
        self._information, self._information_vector = np.diag(VERTICAL_PRIOR), np.zeros(2)

    @property
    def remaining_u(self) -> float:
        """What is left to correct along the rows, pixels."""
        return self.target_u - self.constant_u

    @property
    def likely_lens_px(self) -> float:
        """The same as `lens_px`, or what is typical before it is known."""
        return max(self.lens_px, FIRST_LENS_PX) if self._pairs < LENS_PAIRS else self.lens_px

    def learn_lens(self, uv: FloatArray, disparity: FloatArray) -> None:
        """Take residual disparities `(N,)` at left pixels `(N, 2)`: a lens leaves the same in all pairs."""
        self._pairs += 1
        (rows, columns), camera = BLOCKS, self._camera
        row, column = np.int64(uv[:, 1] * rows / (2.0 * camera.cy)), np.int64(uv[:, 0] * columns / (2.0 * camera.cx))
        block = np.clip(row, 0, rows - 1) * columns + np.clip(column, 0, columns - 1)
        for k, of in enumerate((None, disparity, disparity**2)):
            self._residuals[k] += np.bincount(block, of, rows * columns)
        count, total, squares = self._residuals
        of_blocks, number = float(np.sum(total**2 / np.maximum(count, 1.0))), max(float(count.sum()), 1.0)
        # what the means of blocks have by chance: a landmark has the same error each time it is seen
        noise = (squares.sum() - of_blocks) / number * min(self._pairs, SIGHTINGS) * np.count_nonzero(count)
        self.lens_px = float(np.sqrt(max(of_blocks - noise, 0.0) / number))

    def interrupt(self) -> None:
        """Note that the next pair has new landmarks: the shifts of pairs before do not belong to them."""
        self._shifts.clear()

    def learn_shift(self, px: float, variance: float) -> float:
        """Take the shift of the right image of a pair against the landmarks, as of `right_shift`.

        A line through the shifts of the last pairs gives the present one and its standard error: a steady drift is no
        noise, and a shift of one pair alone (vibration, cameras out of step) is no drift. Returns the drift by which
        `offset.u` was corrected at once, pixels; 0 where there is none.
        """
        if not np.isfinite(variance):
            return 0.0
        self._shifts.append(px)
        self._still_pairs += 1
        self.drifts = self._still_pairs < AFTERMATH_PAIRS
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
        self._still_pairs, self.drifts = 0, True
        self.drift_u += now
        self.followed_px += abs(now)
        self.offset = self.offset._replace(u=self.offset.u + now)
        self.constant_u = self.offset.u - self.drift_u
        self._variance_u += (DRIFT_UNCERTAINTY * now) ** 2
        self.sigma_u = float(np.sqrt(self._variance_u))
        return now

    def learn_vertical(self, right_uv: FloatArray, vertical_disparity: FloatArray) -> None:
        """Update pitch and roll from right pixels `(N, 2)` and how much lower than the left ones they are, `(N,)`."""
        if len(vertical_disparity) < MIN_MATCHES:
            return
        x, y = self._camera.normalised(right_uv).T
        design = np.column_stack((1.0 + y * y, x))
        without_yaw = vertical_disparity - self.offset.u * x * y
        before, prior = np.array([self.offset.v, self.offset.roll]), np.diag(VERTICAL_PRIOR)
        residual = without_yaw - design @ before
        change = np.array([float(np.median(residual)), 0.0])
        for _ in range(5):  # outliers are judged by what this keyframe says alone
            weight = 1.0 / (1.0 + ((residual - design @ change) / VERTICAL_NOISE_PX) ** 2) / len(residual)
            weighted = (design * weight[:, None]).T
            change = np.linalg.solve(prior + weighted @ design, weighted @ residual)
        # all keyframes together: matches on one side of the image say little of the other
        self._information = RETENTION * self._information + weighted @ design
        self._information_vector = RETENTION * self._information_vector + weighted @ without_yaw
        v, roll = map(float, np.linalg.solve(self._information, self._information_vector))
        self.offset = self.offset._replace(v=v, roll=roll)

    def learn_yaw(self, remaining_u: float, variance: float) -> float:
        """Update the offset along the rows by what an adjusted window shows beyond it, px, px^2; return its change."""
        self._variance_u += DRIFT_PX**2
        gain = self._variance_u / (self._variance_u + variance * self._shared)
        before = self.constant_u
        self._mean_u += gain * (before + remaining_u - self._mean_u)
        self._variance_u *= 1.0 - gain
        self.sigma_u = float(np.sqrt(self._variance_u))
        self.target_u = self._mean_u if abs(self._mean_u) > DETECTION_SIGMAS * self.sigma_u else 0.0
        if abs(self.remaining_u) > UNSETTLED_PX:  # what is left of the disparities is by this
            self.lens_px, self._pairs, self._residuals = 0.0, 0, np.zeros_like(self._residuals)
        # small steps: the pose moves a little with each
        most = max(MAX_STEP_PX, STEP_SHARE * abs(self.remaining_u))
        u = before + float(np.clip(self.remaining_u, -most, most))
        self.offset = self.offset._replace(u=u + self.drift_u)
        self.constant_u = self.offset.u - self.drift_u
        return u - before
