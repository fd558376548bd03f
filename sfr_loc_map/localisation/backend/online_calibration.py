"""Online calibration: rotation error of the right camera, estimated from the images.

A rotation of a few hundredths of a degree is the most common error of a rig after a shock or a change of temperature.

- Pitch and roll appear in every stereo match as vertical disparity.
- Yaw changes all depths and therefore scales the path. The bundle adjustment estimates the yaw from the disagreement of
  depths from stereo with depths from motion. The adjustment assumes a constant yaw within a window.
- Drift is a rotation of the right camera within a window. In each pair, the change of the yaw since the landmarks were
  triangulated is measured with an error of a hundredth of a pixel. The drift is corrected from pair to pair.

The calibration is immutable: each update returns a new object.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, read_only
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.robust_statistics import cauchy_weight
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.backend.bundle_adjustment import OffsetEstimate
from sfr_loc_map.localisation.frontend.right_camera import PairYaw, RightCameraOffset

# The values were chosen by hand on rendered drives with injected yaw, pitch and drift.

MIN_YAWS: Final = 8
"""Minimum number of consecutive pairs from which a drift is detected. A line fitted to eight yaws has six degrees of
freedom, so its standard error is accurate to 29 %."""
MAX_YAWS: Final = 16
"""Maximum number of consecutive pairs from which a drift is detected: 1.6 s at 10 Hz, over which a drift is nearly
linear."""
DRIFT_SIGMAS: Final = 5.0
"""Detection threshold of a drift, in standard errors of the yaw. Noise exceeds 5 standard errors in 0.25 % of the fits
with six degrees of freedom. With a larger threshold, a drift biases the depths for longer. With a smaller value, the
correction follows noise, which accumulates."""
DRIFT_FLOOR_PX: Final = 0.015
"""Yaw, px, that is added to the detection threshold of a drift. The value is near the common error of all disparities
(`ErrorSources.disparity_px`, 0.01 px). With a larger value, slow drifts are left to the yaw of the windows. With a
smaller value, errors of the landmarks are attributed to a drift."""
AFTER_DRIFT_PAIRS: Final = 20
"""Number of pairs after the last correction for which the right camera is still reported as drifting. The value is
above the number of pairs that detect a drift (`MAX_YAWS`). With fewer pairs, the state alternates during a drift. With
more pairs, good pairs stay degraded."""
DRIFT_ERROR_RATIO: Final = 0.1
"""Ratio of the standard deviation of a drift correction to the correction. The value is equal to
`ErrorSources.drift_attitude_ratio`. With a larger ratio, windows correct the yaw more after a drift, and covariances
are larger. With a smaller value, an error of the drift correction remains."""
FIRST_SIGMA_PX: Final = 0.3
"""Prior standard deviation of the yaw, px. At a focal length of 600 px it is 0.03 deg, as after a shock or a change of
temperature."""
YAW_WALK_PX: Final = 0.002
"""Process noise of the yaw per keyframe, px. Over a hundred keyframes it adds 0.02 px. With a larger value, the yaw
variance stays large. With a smaller value, a later change of temperature is tracked too slowly."""
DETECTION_SIGMAS: Final = 4.0
"""Minimum significance of a yaw that is corrected, in standard deviations. With normal errors, a correct calibration is
changed by chance in one of 16 000 cases. With a larger value, a real yaw scales the path for longer."""
SMALL_CORRECTION_PX: Final = 0.05
"""Maximum change of the yaw correction per keyframe while the remaining yaw is small, px. A large yaw permits larger
changes (`CORRECTION_GAIN`). Each change moves the pose. The value is a sixth of the prior standard deviation. With a
larger value, the path has larger steps. With a smaller value, the path is scaled for longer."""
CORRECTION_GAIN: Final = 0.2
"""Ratio of the maximum change to the remaining yaw, if that change exceeds `SMALL_CORRECTION_PX`. Three keyframes halve
a large yaw (0.8^3 = 0.51). Larger or smaller values have the same effects as for `SMALL_CORRECTION_PX`."""
UNSETTLED_PX: Final = 0.2
"""Remaining yaw, px, above which poses are degraded. The value is below the prior standard deviation of the yaw. With a
larger value, poses on a bent path are published as good. With a smaller value, more pairs are degraded, although the
covariance includes the remaining yaw."""
MIN_MATCHES: Final = 20
"""Minimum number of stereo matches of a keyframe that updates pitch and roll: ten for each unknown."""
VERTICAL_SCALE_PX: Final = 0.15
"""Standard deviation of the vertical disparity of a match, px: the scale of the robust weight. The value is above the
usual residual of an inlier (0.1 px). A larger value gives wrong matches more weight. A smaller value lowers the weight
of correct matches."""
VERTICAL_ITERATIONS: Final = 5
"""Iterations of the robust fit of pitch and roll. With fewer iterations, wrong matches keep more weight. With more
iterations, a keyframe takes longer."""
RETENTION: Final = 0.98
"""Factor of the earlier information on pitch and roll at each keyframe. About fifty keyframes contribute. With a larger
factor, a change of temperature is tracked more slowly. With a smaller value, noise of the matches remains in the
correction."""
VERTICAL_PRIOR: Final = (1e-3, 5e-3)
"""Prior information of zero pitch and of zero roll, relative to that of one keyframe. The value is far below 1, so that
the prior determines only what no match shows. With larger values, small rotations are not corrected completely."""
LENS_BLOCKS: Final = (4, 6)
"""Numbers of rows and columns of image blocks, each with a mean residual disparity. The residuals of a lens vary
smoothly. With more blocks, each has fewer landmarks. With fewer blocks, the variation within a block is missed."""
SIGHTINGS: Final = 8
"""Number of pairs in which a landmark is assumed to be observed with the same error. With a larger number, lens errors
are attributed to chance. With a smaller value, random errors are reported as lens errors."""
FIRST_LENS_PX: Final = 0.08  #: Prior RMS of residual disparities due to lens errors, px. KITTI has 0.07 to 0.09 px.
LENS_PAIRS: Final = 20
"""Number of initial pairs in which `FIRST_LENS_PX` is the minimum RMS. The value is two seconds at 10 Hz. With more
pairs, a shear of the rows at the start is detected later. With fewer pairs, lens errors are reported as a shear."""


class LensResidual(NamedTuple):
    """Residual disparities by image block. Lens errors are constant in time but vary over the image."""

    sums: FloatArray  #: `(3, blocks)` number, sum and sum of squares of the residual disparities, px.
    pairs: int  #: Number of pairs.
    rms_px: float  #: RMS of the block means after subtraction of the variance due to chance, px.

    @classmethod
    def none(cls) -> LensResidual:
        """Return the residuals before the first pair."""
        return cls(np.zeros((3, LENS_BLOCKS[0] * LENS_BLOCKS[1])), 0, 0.0)

    @property
    def likely_px(self) -> float:
        """RMS of the block means, px; at least `FIRST_LENS_PX` in the first `LENS_PAIRS` pairs."""
        return max(self.rms_px, FIRST_LENS_PX) if self.pairs < LENS_PAIRS else self.rms_px

    def with_pair(self, uv: FloatArray, disparity: FloatArray, shape: tuple[int, int]) -> LensResidual:
        """Add the residual disparities `(N,)` of a pair at left pixels `(N, 2)`.

        The blocks divide the image, whose shape is (height, width). The principal point may be elsewhere. Block b has
        n_b residual disparities d of all pairs, N together:

            between = sum_b (sum d)^2 / n_b                    = sum_b n_b mean_b^2
            within  = (sum d^2 - between) / N                  variance of a residual about the mean of its block
            chance  = within min(pairs, SIGHTINGS) blocks      expected value of `between` without lens errors
            rms_px^2 = (between - chance) / N

        Independent residuals would give the expected value `within` for each block with residuals. A landmark, however,
        has the same error in each pair that observes it, in about `SIGHTINGS` pairs.
        """
        sums = self.sums + _block_sums(uv, disparity, shape)
        count, total, squares = sums
        pairs = self.pairs + 1
        between_blocks = float((total**2 / np.maximum(count, 1.0)).sum())
        number = max(float(count.sum()), 1.0)
        by_chance = (squares.sum() - between_blocks) / number * min(pairs, SIGHTINGS) * np.count_nonzero(count)
        rms_px = math.sqrt(max(between_blocks - by_chance, 0.0) / number)
        return LensResidual(sums, pairs, rms_px)


@jit
def _block_sums(uv: FloatArray, disparity: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return `LensResidual.sums` of residual disparities `(N,)` at pixels `(N, 2)` of an image (height, width)."""
    height, width = shape
    rows, columns = LENS_BLOCKS
    sums = np.zeros((3, rows * columns))
    for n in range(len(disparity)):
        row = min(max(int(uv[n, 1] * rows / (height - 1.0)), 0), rows - 1)
        column = min(max(int(uv[n, 0] * columns / (width - 1.0)), 0), columns - 1)
        block = row * columns + column
        sums[0, block] += 1.0
        sums[1, block] += disparity[n]
        sums[2, block] += disparity[n] * disparity[n]
    return sums


class YawEstimate(NamedTuple):
    """Kalman filter of a constant yaw of the right camera, px at the principal point, and its correction.

    The right camera is corrected by the estimate if the estimate is significant. The correction approaches the
    estimate in small steps, because each step moves the pose.
    """

    mean_px: float = 0.0
    variance_px2: float = FIRST_SIGMA_PX**2
    target_px: float = 0.0  #: Yaw to be corrected: the mean if it is significant, else 0.
    corrected_px: float = 0.0  #: Part of the yaw that is corrected.
    #: Yaw that was to be corrected in maps that were discarded, because it has bent the path, px (absolute value).
    earlier_px: float = 0.0

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the yaw."""
        return math.sqrt(self.variance_px2)

    @property
    def remaining_px(self) -> float:
        """Part of the yaw that is still to be corrected."""
        return self.target_px - self.corrected_px

    @property
    def bent_px(self) -> float:
        """Yaw that has bent the path before its correction, in this map and in discarded maps."""
        return float(np.hypot(self.target_px, self.earlier_px))

    def with_window(self, found: OffsetEstimate, window_keyframes: int) -> YawEstimate:
        """Return the yaw after the adjustment of a window; `found` is the offset that the correction leaves.

        The variance of the offset is multiplied by the number of keyframes of a window, because consecutive windows
        share observations.
        """
        predicted_px2 = self.variance_px2 + YAW_WALK_PX**2
        gain = predicted_px2 / (predicted_px2 + found.variance * float(window_keyframes))
        mean_px = self.mean_px + gain * (self.corrected_px + found.px - self.mean_px)
        variance_px2 = predicted_px2 * (1.0 - gain)
        is_significant = abs(mean_px) > DETECTION_SIGMAS * math.sqrt(variance_px2)
        target_px = mean_px if is_significant else 0.0
        return YawEstimate(mean_px, variance_px2, target_px, self.corrected_px, self.earlier_px)

    def corrected(self) -> YawEstimate:
        """Return the yaw after one step of the correction."""
        most_px = max(SMALL_CORRECTION_PX, CORRECTION_GAIN * abs(self.remaining_px))
        step_px = float(np.clip(self.remaining_px, -most_px, most_px))
        return self._replace(corrected_px=self.corrected_px + step_px)


class DriftEstimate(NamedTuple):
    """Change of the yaw within a window, detected from the yaws of consecutive pairs and corrected completely."""

    px: float = 0.0  #: Sum of the corrections.
    total_px: float = 0.0  #: Sum of the absolute corrections, for the uncertainty of the attitude.
    yaws_px: tuple[float, ...] = ()  #: Yaws of the last pairs relative to the landmarks (`PairYaw`).
    pairs_since: int = AFTER_DRIFT_PAIRS  #: Number of pairs since the last correction.

    @property
    def is_recent(self) -> bool:
        """Whether the right camera has drifted within the last `AFTER_DRIFT_PAIRS` pairs."""
        return self.pairs_since < AFTER_DRIFT_PAIRS

    def with_pair_yaw(self, px: float) -> tuple[DriftEstimate, float]:
        """Add the yaw of a pair relative to the landmarks; return the new drift, px, or 0.

        A line fitted to the yaws of the last pairs gives the current yaw and its standard error. The fit
        distinguishes a steady drift from noise and from the yaw of a single pair (vibration, unsynchronised cameras).
        """
        yaws_px = (*self.yaws_px, px)[-MAX_YAWS:]
        quiet = self._replace(yaws_px=yaws_px, pairs_since=self.pairs_since + 1)
        if len(yaws_px) < MIN_YAWS:
            return quiet, 0.0
        drift_px, sigma_px = _end_of_line(np.array(yaws_px))
        if abs(drift_px) < DRIFT_FLOOR_PX + DRIFT_SIGMAS * sigma_px:
            return quiet, 0.0
        relative = tuple((np.array(yaws_px) - drift_px).tolist())
        return DriftEstimate(self.px + drift_px, self.total_px + abs(drift_px), relative, pairs_since=0), drift_px

    def window_begun(self) -> DriftEstimate:
        """Discard the yaws of earlier pairs, because they were measured relative to other landmarks."""
        return self._replace(yaws_px=())


class VerticalEstimate(NamedTuple):
    """Pitch and roll of the right camera, a least-squares estimate from the vertical disparities of all keyframes."""

    pitch_px: float = 0.0  #: Pitch: offset of the right image along the column at the principal point.
    roll_px: float = 0.0  #: Roll, px at one focal length from the principal point.
    information: FloatArray = read_only(np.diag(VERTICAL_PRIOR))  #: `(2, 2)` of pitch and roll.
    information_vector: FloatArray = read_only(np.zeros(2))

    def with_matches(self, xy: FloatArray, disparity: FloatArray) -> VerticalEstimate:
        """Add the vertical disparities `(N,)`, px, of stereo matches at normalised right coordinates `(N, 2)`.

        The disparities are free of the effect of the yaw.
        """
        x, y = xy.T
        design = np.column_stack((1.0 + y * y, x))
        residual = disparity - design @ np.array([self.pitch_px, self.roll_px])
        change = np.array([float(np.median(residual)), 0.0])
        prior = np.diag(VERTICAL_PRIOR)
        for _ in range(VERTICAL_ITERATIONS):  # robust weights use this keyframe alone
            weight = cauchy_weight(residual - design @ change, VERTICAL_SCALE_PX) / len(residual)
            weighted = (design * weight[:, None]).T
            change = np.linalg.solve(prior + weighted @ design, weighted @ residual)
        # All keyframes contribute, because matches on one side of the image hardly constrain the other side.
        information = RETENTION * self.information + weighted @ design
        vector = RETENTION * self.information_vector + weighted @ disparity
        pitch_px, roll_px = map(float, np.linalg.solve(information, vector))
        return VerticalEstimate(pitch_px, roll_px, information, vector)


class OnlineCalibration(NamedTuple):
    """Errors of the right camera, in pixels: three estimates of its rotation error, and the residual lens errors.

    | estimate | is updated by | from |
    |---|---|---|
    | `vertical` (pitch, roll) | each keyframe (`with_matches`) | vertical disparities of its stereo matches |
    | `yaw` (constant part) | each keyframe (`with_window_yaw`) | the adjusted window |
    | `drift` (change of the yaw) | each pair (`with_pair`) | the yaw relative to the landmarks (`PairYaw`) |
    | `lens` | each pair (`with_pair`) | residual disparities by image block |
    """

    camera: StereoCamera
    shape: tuple[int, int]  #: Height and width of the images.
    window_keyframes: int  #: Number of keyframes of a window.
    vertical: VerticalEstimate = VerticalEstimate()
    yaw: YawEstimate = YawEstimate()
    drift: DriftEstimate = DriftEstimate()
    lens: LensResidual = LensResidual.none()

    @property
    def offset(self) -> RightCameraOffset:
        """Correction of the right observations."""
        return RightCameraOffset(self.yaw.corrected_px + self.drift.px, self.vertical.pitch_px, self.vertical.roll_px)

    @property
    def is_settled(self) -> bool:
        """Whether the right camera is stable: it has no drift and no large yaw that is still to be corrected."""
        return not self.drift.is_recent and abs(self.yaw.remaining_px) <= UNSETTLED_PX

    def window_begun(self) -> OnlineCalibration:
        """Return the calibration in a new window."""
        return self._replace(drift=self.drift.window_begun())

    def diverged(self) -> OnlineCalibration:
        """Return the calibration after a diverged adjustment, which starts again as at the first pair.

        The estimates are discarded with their map.

        The yaw that was to be corrected and the sum of the drift corrections continue as causes of attitude errors,
        because these errors of the path remain.
        """
        yaw = YawEstimate(earlier_px=self.yaw.bent_px)
        drift = DriftEstimate(total_px=self.drift.total_px)
        return OnlineCalibration(self.camera, self.shape, self.window_keyframes, yaw=yaw, drift=drift)

    def with_pair(self, found: PairYaw) -> tuple[OnlineCalibration, float]:
        """Add the residual disparities of a pair, and its yaw relative to the landmarks.

        The second value is the new drift, px, or 0.
        """
        lens = self.lens.with_pair(found.uv, found.disparity, self.shape)
        drift, drift_px = self.drift.with_pair_yaw(found.px)
        yaw = self.yaw
        if drift_px != 0.0:
            yaw = yaw._replace(variance_px2=yaw.variance_px2 + (DRIFT_ERROR_RATIO * drift_px) ** 2)
        return self._replace(lens=lens, drift=drift, yaw=yaw), drift_px

    def with_matches(self, right_uv: FloatArray, vertical_disparity: FloatArray) -> OnlineCalibration:
        """Update pitch and roll with the stereo matches of a keyframe.

        The right pixels are `(N, 2)`; the vertical disparities `(N,)` are positive where the right pixel is lower.
        """
        if len(vertical_disparity) < MIN_MATCHES:
            return self
        xy = self.camera.normalised(right_uv)
        without_yaw = vertical_disparity - self.offset.yaw_px * xy[:, 0] * xy[:, 1]
        return self._replace(vertical=self.vertical.with_matches(xy, without_yaw))

    def with_window_yaw(self, found: OffsetEstimate) -> tuple[OnlineCalibration, float]:
        """Update the yaw with the remaining offset of an adjusted window; return the change of the correction, px."""
        yaw = self.yaw.with_window(found, self.window_keyframes)
        # An uncorrected yaw dominates the residual disparities and hides lens errors.
        lens = LensResidual.none() if abs(yaw.remaining_px) > UNSETTLED_PX else self.lens
        corrected = yaw.corrected()
        return self._replace(yaw=corrected, lens=lens), corrected.corrected_px - yaw.corrected_px


def _end_of_line(yaws_px: FloatArray) -> tuple[float, float]:
    """Fit a line to the yaws `(N,)` of consecutive pairs; return its last value with the standard error."""
    count = len(yaws_px)
    pairs = np.arange(count) - 0.5 * (count - 1)
    power = float(pairs @ pairs)
    slope = float(pairs @ yaws_px) / power
    mean = float(yaws_px.sum()) / count  # faster than `mean`
    last = mean + slope * float(pairs[-1])
    variance = float(np.square(yaws_px - mean - slope * pairs).sum()) / (count - 2)
    return last, math.sqrt(variance * (1.0 / count + pairs[-1] ** 2 / power))
