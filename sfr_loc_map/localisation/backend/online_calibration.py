"""Online calibration: rotation of the right camera against its calibration, estimated from the images.

A rotation of some hundredths of a degree is the most common error of a rig after a shock or a change of temperature.

- Pitch and roll appear in every stereo match as vertical disparity.
- Yaw changes all depths, hence the length of the path. It is observable only where depths from stereo disagree with
  depths from motion, in the bundle adjustment, which assumes a constant yaw within a window.
- A right camera that turns while a window lasts shifts the right images against landmarks of earlier keyframes. Each
  pair shows that shift to a hundredth of a pixel, and it is followed from pair to pair.

The calibration is a value: each update returns a new one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.localisation.backend.bundle_adjustment import OffsetEstimate
from sfr_loc_map.localisation.frontend.right_camera import RightOffset, RightShift

# The values were chosen by hand on rendered drives with injected yaw, pitch and drift.

MIN_SHIFTS: Final = 8
"""Minimum number of consecutive pairs from which a drift is detected. A line through eight shifts leaves six degrees of
freedom, by which its standard error is known to 29 %."""
MAX_SHIFTS: Final = 16
"""Maximum number of consecutive pairs from which a drift is detected: 1.6 s at 10 Hz, over which a drift is nearly
linear."""
DRIFT_SIGMAS: Final = 5.0
"""Standard errors of the shift above which the right camera drifts. Chosen by hand: with six degrees of freedom, 5 are
exceeded by chance in a quarter of a percent of the fits. If larger, a drift biases the depths for longer before it is
followed; if smaller, noise is followed and adds up."""
DRIFT_FLOOR_PX: Final = 0.015
"""Shift, px, that is not a drift, whatever its standard error. Chosen by hand near the error that all disparities share
(`ErrorSources.disparity_px`, 0.01 px). If larger, slow drifts are left to the yaw of the windows; if smaller, errors of
the landmarks are followed."""
AFTER_DRIFT_PAIRS: Final = 20
"""Pairs after the last correction in which the right camera is still reported to drift. Chosen by hand, more than a
drift needs to be detected again (`MAX_SHIFTS`). If smaller, the state alternates within one drift; if larger, good
pairs stay degraded."""
FOLLOWED_ERROR_RATIO: Final = 0.1
"""Standard deviation of a followed drift, as a ratio to the drift. Chosen by hand, equal to
`ErrorSources.followed_attitude_ratio`. If larger, windows correct the yaw more after a drift and poses state larger
errors; if smaller, an error of the drift stays."""
FIRST_SIGMA_PX: Final = 0.3
"""Prior standard deviation of the yaw, px: 0.03 degrees at a focal length of 600 px, as after a shock or a change of
temperature."""
YAW_WALK_PX: Final = 0.002
"""Process noise of the yaw per keyframe, px. Chosen by hand: over a hundred keyframes it adds 0.02 px. If larger, the
yaw never becomes certain; if smaller, a later change of temperature is followed too slowly."""
DETECTION_SIGMAS: Final = 4.0
"""Standard deviations above which a yaw is corrected; smaller ones are left alone. A correct calibration is changed by
chance in one of 16 000 cases (normal errors). If larger, a real yaw scales the path for longer."""
MAX_CORRECTION_PX: Final = 0.05
"""Maximum change of the yaw correction per keyframe, px, because the pose moves with it. Chosen by hand: a sixth of the
prior standard deviation. If larger, steps of the path are larger; if smaller, the path is scaled for longer."""
CORRECTION_GAIN: Final = 0.2
"""Maximum change as a ratio to the remaining yaw, if that is larger. Chosen by hand, so that three keyframes halve a
large yaw (0.8^3 = 0.51). Larger and smaller values act as those of `MAX_CORRECTION_PX`."""
UNSETTLED_PX: Final = 0.2
"""Remaining yaw, px, above which poses are degraded. Chosen by hand below its prior standard deviation. If larger,
poses with a bent path are published as good; if smaller, more pairs are degraded, although the covariance contains the
remaining yaw."""
MIN_MATCHES: Final = 20
"""Minimum number of stereo matches of a keyframe that updates pitch and roll: ten for each unknown."""
VERTICAL_NOISE_PX: Final = 0.15
"""Standard deviation of the vertical disparity of a match, px. Chosen by hand above the usual residual of an inlier
(0.1 px). It is the scale of the robust weight: if larger, wrong matches count more; if smaller, fewer matches count."""
VERTICAL_ITERATIONS: Final = 5
"""Iterations of the robust fit of pitch and roll. Chosen by hand. With fewer, wrong matches keep more weight; with
more, a keyframe takes longer."""
RETENTION: Final = 0.98
"""Weight that the information on pitch and roll keeps with each keyframe: fifty keyframes count. Chosen by hand. If
larger, a change of temperature is followed more slowly; if smaller, noise of the matches remains in the correction."""
VERTICAL_PRIOR: Final = (1e-3, 5e-3)
"""Information of the prior "no pitch, no roll", in keyframes. Chosen by hand far below one keyframe, so that it decides
only what no match shows. If larger, small rotations are not corrected completely."""
LENS_BLOCKS: Final = (4, 6)
"""Rows and columns of image blocks, each with a mean residual disparity. Chosen by hand: residuals of a lens vary
smoothly. With more blocks, fewer landmarks determine each; with fewer, the variation within a block is missed."""
SIGHTINGS: Final = 8
"""Pairs in which a landmark is seen with the same error. Chosen by hand. If larger, more of the block means is
attributed to chance and a lens with errors is missed; if smaller, the lens of a clean drive is given errors."""
FIRST_LENS_PX: Final = 0.08  #: Prior RMS of the residual disparity of a lens, px. A KITTI car has 0.07 to 0.09 px.
LENS_PAIRS: Final = 20
"""Number of first pairs in which the prior is a lower bound. Chosen by hand: two seconds at 10 Hz. If larger, sheared
rows at the start are detected later; if smaller, an unknown lens is reported as sheared rows."""


class LensResidual(NamedTuple):
    """Residual disparities by image block: errors of the lens are constant in time but vary over the image."""

    sums: FloatArray  #: `(3, blocks)` number, sum and sum of squares of the residual disparities, px.
    pairs: int  #: Number of pairs.
    rms_px: float  #: RMS of the block means without what they have by chance, px.

    @classmethod
    def none(cls) -> LensResidual:
        """Return the residuals before the first pair."""
        return cls(np.zeros((3, LENS_BLOCKS[0] * LENS_BLOCKS[1])), 0, 0.0)

    @property
    def likely_px(self) -> float:
        """RMS of the block means, px; at least the prior in the first pairs."""
        return max(self.rms_px, FIRST_LENS_PX) if self.pairs < LENS_PAIRS else self.rms_px

    def with_pair(self, uv: FloatArray, disparity: FloatArray, camera: StereoCamera) -> LensResidual:
        """Add the residual disparities `(N,)` of a pair at left pixels `(N, 2)`."""
        rows, columns = LENS_BLOCKS
        row = np.int64(uv[:, 1] * rows / (2.0 * camera.cy))
        column = np.int64(uv[:, 0] * columns / (2.0 * camera.cx))
        row = np.minimum(np.maximum(row, 0), rows - 1)  # faster than `clip` for so few numbers
        column = np.minimum(np.maximum(column, 0), columns - 1)
        block = row * columns + column
        size = rows * columns
        count = self.sums[0] + np.bincount(block, None, size)
        total = self.sums[1] + np.bincount(block, disparity, size)
        squares = self.sums[2] + np.bincount(block, disparity**2, size)
        pairs = self.pairs + 1
        between_blocks = float(np.sum(total**2 / np.maximum(count, 1.0)))
        number = max(float(count.sum()), 1.0)
        # the block means differ by chance: a landmark has the same error in each pair that shows it
        by_chance = (squares.sum() - between_blocks) / number * min(pairs, SIGHTINGS) * np.count_nonzero(count)
        rms_px = float(np.sqrt(max(between_blocks - by_chance, 0.0) / number))
        return LensResidual(np.stack((count, total, squares)), pairs, rms_px)


class YawEstimate(NamedTuple):
    """Kalman filter of a constant yaw of the right camera, px at the image centre."""

    mean_px: float = 0.0
    variance_px2: float = FIRST_SIGMA_PX**2
    target_px: float = 0.0  #: Yaw to be corrected: the mean where it is significant, else 0.


@dataclass(frozen=True, slots=True, eq=False)
class OnlineCalibration:
    """Rotation error of the right camera; lengths are pixels.

    The yaw correction `offset.u` is the sum of a drift that was followed from pair to pair and of a constant part,
    which approaches the estimated yaw in small steps.
    """

    camera: StereoCamera
    window_keyframes: int
    """Consecutive windows share observations: the variance of a window's yaw is inflated by its number of keyframes."""
    offset: RightOffset = RightOffset()  #: Correction of the right observations.
    drift_px: float = 0.0  #: Followed drift within `offset.u`.
    followed_px: float = 0.0  #: Sum of the absolute drifts that were followed.
    shifts: tuple[float, ...] = ()  #: Shifts of the right images of the last pairs against the landmarks.
    pairs_since_drift: int = AFTER_DRIFT_PAIRS
    is_drifting: bool = False  #: Whether the right camera turns, or has just turned.
    yaw: YawEstimate = YawEstimate()
    lens: LensResidual = field(default_factory=LensResidual.none)
    #: `(2, 2)` information matrix of pitch and roll.
    information: FloatArray = field(default_factory=lambda: np.diag(VERTICAL_PRIOR))
    information_vector: FloatArray = field(default_factory=lambda: np.zeros(2))

    @property
    def yaw_sigma_px(self) -> float:
        """Standard deviation of the yaw."""
        return float(np.sqrt(self.yaw.variance_px2))

    @property
    def corrected_px(self) -> float:
        """Part of the constant yaw that is corrected."""
        return self.offset.u - self.drift_px

    @property
    def remaining_px(self) -> float:
        """Part of the constant yaw that is still to be corrected."""
        return self.yaw.target_px - self.corrected_px

    @property
    def is_settled(self) -> bool:
        """Whether the right camera neither drifts nor has a large yaw still to be corrected."""
        return not self.is_drifting and abs(self.remaining_px) <= UNSETTLED_PX

    def after_restart(self) -> OnlineCalibration:
        """Forget the shifts of earlier pairs: they belong to other landmarks."""
        return replace(self, shifts=())

    def with_lens_residuals(self, shift: RightShift) -> OnlineCalibration:
        """Add the residual disparities of a pair."""
        return replace(self, lens=self.lens.with_pair(shift.uv, shift.disparity, self.camera))

    def with_shift(self, shift: RightShift) -> tuple[OnlineCalibration, float]:
        """Follow the shift of the right image of a pair against the landmarks; return the drift, px, or 0.

        A line through the shifts of the last pairs gives the present shift and its standard error. A steady drift is
        therefore not taken for noise, and the shift of a single pair (vibration, cameras out of step) not for a drift.
        """
        if not np.isfinite(shift.variance):
            return self, 0.0
        shifts = (*self.shifts, shift.px)[-MAX_SHIFTS:]
        pairs_since_drift = self.pairs_since_drift + 1
        quiet = replace(
            self, shifts=shifts, pairs_since_drift=pairs_since_drift, is_drifting=pairs_since_drift < AFTER_DRIFT_PAIRS
        )
        if len(shifts) < MIN_SHIFTS:
            return quiet, 0.0
        drift_px, sigma_px = _end_of_line(np.array(shifts))
        if abs(drift_px) < DRIFT_FLOOR_PX + DRIFT_SIGMAS * sigma_px:
            return quiet, 0.0
        variance_px2 = self.yaw.variance_px2 + (FOLLOWED_ERROR_RATIO * drift_px) ** 2
        followed = replace(
            self,
            shifts=tuple((np.array(shifts) - drift_px).tolist()),
            pairs_since_drift=0,
            is_drifting=True,
            drift_px=self.drift_px + drift_px,
            followed_px=self.followed_px + abs(drift_px),
            offset=self.offset._replace(u=self.offset.u + drift_px),
            yaw=self.yaw._replace(variance_px2=variance_px2),
        )
        return followed, drift_px

    def with_matches(self, right_uv: FloatArray, vertical_disparity: FloatArray) -> OnlineCalibration:
        """Update pitch and roll by the stereo matches of a keyframe.

        The right pixels are `(N, 2)`; the vertical disparities `(N,)` are positive where the right pixel is lower.
        """
        if len(vertical_disparity) < MIN_MATCHES:
            return self
        x, y = self.camera.normalised(right_uv).T
        design = np.column_stack((1.0 + y * y, x))
        without_yaw = vertical_disparity - self.offset.u * x * y
        residual = without_yaw - design @ np.array([self.offset.v, self.offset.roll])
        change = np.array([float(np.median(residual)), 0.0])
        prior = np.diag(VERTICAL_PRIOR)
        for _ in range(VERTICAL_ITERATIONS):  # outliers are judged by this keyframe alone
            weight = 1.0 / (1.0 + ((residual - design @ change) / VERTICAL_NOISE_PX) ** 2) / len(residual)
            weighted = (design * weight[:, None]).T
            change = np.linalg.solve(prior + weighted @ design, weighted @ residual)
        # all keyframes together: matches on one side of the image say little about the other side
        information = RETENTION * self.information + weighted @ design
        vector = RETENTION * self.information_vector + weighted @ without_yaw
        v, roll = map(float, np.linalg.solve(information, vector))
        return replace(
            self, information=information, information_vector=vector, offset=self.offset._replace(v=v, roll=roll)
        )

    def with_window(self, found: OffsetEstimate) -> tuple[OnlineCalibration, float]:
        """Update the yaw by the remaining offset that an adjusted window shows; return the change of the correction."""
        predicted_px2 = self.yaw.variance_px2 + YAW_WALK_PX**2
        gain = predicted_px2 / (predicted_px2 + found.variance * float(self.window_keyframes))
        before_px = self.corrected_px
        mean_px = self.yaw.mean_px + gain * (before_px + found.px - self.yaw.mean_px)
        variance_px2 = predicted_px2 * (1.0 - gain)
        is_significant = abs(mean_px) > DETECTION_SIGMAS * float(np.sqrt(variance_px2))
        yaw = YawEstimate(mean_px, variance_px2, mean_px if is_significant else 0.0)
        remaining_px = yaw.target_px - before_px
        # an uncorrected yaw dominates the residual disparities
        lens = LensResidual.none() if abs(remaining_px) > UNSETTLED_PX else self.lens
        # small steps, because the pose moves with each of them
        most_px = max(MAX_CORRECTION_PX, CORRECTION_GAIN * abs(remaining_px))
        corrected_px = before_px + float(np.clip(remaining_px, -most_px, most_px))
        offset = self.offset._replace(u=corrected_px + self.drift_px)
        return replace(self, yaw=yaw, lens=lens, offset=offset), corrected_px - before_px


def _end_of_line(shifts: FloatArray) -> tuple[float, float]:
    """Fit a line through shifts `(N,)` of consecutive pairs; return its last value and the standard error."""
    count = len(shifts)
    pairs = np.arange(count) - 0.5 * (count - 1)
    power = float(pairs @ pairs)
    slope = float(pairs @ shifts) / power
    mean = shifts.mean()
    last = float(mean) + slope * float(pairs[-1])
    variance = float(np.square(shifts - mean - slope * pairs).sum()) / (count - 2)
    return last, float(np.sqrt(variance * (1.0 / count + pairs[-1] ** 2 / power)))
