"""Covariance of the rover's pose: drift of the window, start, calibration, and errors that all landmarks share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import skew
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import LocalisationConfig

DRIFT_SHARE = 0.1
"""Standard deviation of the attitude that a drift of the right camera leaves, as a share of the drift followed."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Pose at which a window or a run begins.

    Attributes:
        position: `(3,)` metres, in some frame.
        covariance: `(6, 6)` of the pose there, position and rotation about the fixed axes of that frame.
    """

    position: FloatArray
    covariance: FloatArray

    def propagated_to(self, position: FloatArray) -> FloatArray:
        """Return its share `(6, 6)` of the covariance at another position `(3,)`: a rotation error swings the path."""
        return propagated_covariance(self.covariance, position - self.position)


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceMark:
    """What the covariance of one pose was made of, so that a later one can be taken relative to it.

    Attributes:
        window: Number of its window.
        position: `(3,)` of the pose, metres, world.
        in_window: `(6, 6)` of it in its window.
        per_disparity_bias: `(3,)` path integral of position over disparity error up to it.
        corrected_bias: `(3,)` the part of it that was corrected.
        doubt: `(2,)` metres and radians by which motions up to it may have been other ones.
    """

    window: int
    position: FloatArray
    in_window: FloatArray
    per_disparity_bias: FloatArray
    corrected_bias: FloatArray
    doubt: FloatArray


class CovarianceModel:
    """Adds to the covariance of a pose in its window what the window does not contain.

    The path integral of position over disparity error tells how far a constant error of all disparities has moved the
    pose: a disparity error of 1 px scales a step by `depth / (fx baseline)`.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig) -> None:
        """Start without a path."""
        self._focal_px, self._baseline_m, self._config = rig.fx, rig.baseline_m, config
        self._in_window, self._unseen = np.zeros((6, 6)), np.zeros((6, 6))
        self._start = Start(np.zeros(3), np.zeros((6, 6)))
        self._reference: Start | None = None
        self._window = 0
        self._doubt, self._doubted = np.zeros(2), Start(np.zeros(3), np.zeros((6, 6)))
        self._position_per_disparity_bias, self._corrected_bias = np.zeros(3), np.zeros(3)
        self._bias_before = np.zeros(3), np.zeros(3)

    def start(self, position: FloatArray, covariance: FloatArray, in_window: FloatArray, depth_m: float) -> None:
        """Begin a window.

        Args:
            position: `(3,)` of its first pose, metres, world.
            covariance: `(6, 6)` of that pose.
            in_window: `(6, 6)` of it given by the window itself.
            depth_m: Median depth of the landmarks: the first image has the error of any whole image.
        """
        systematic = systematic_covariance(depth_m, self._config.common_px, self._focal_px)
        self._start, self._reference = Start(position, covariance + systematic), None
        self._window += 1
        self.set_in_window(in_window)

    def restart(self, position: FloatArray, covariance: FloatArray) -> None:
        """Forget the path: the covariance `(6, 6)` at the last known position `(3,)` is given."""
        self._start, self._reference = Start(position, covariance), None
        self._doubt, self._doubted = np.zeros(2), Start(position, np.zeros((6, 6)))
        self.set_in_window(np.zeros((6, 6)))
        self._bias_before = self._position_per_disparity_bias.copy(), self._corrected_bias.copy()

    def mark(self, T_world_left: Transform) -> CovarianceMark:
        """Return what the covariance of the present pose is made of."""
        bias = self._position_per_disparity_bias.copy(), self._corrected_bias.copy()
        return CovarianceMark(self._window, T_world_left.translation, self._in_window, *bias, self._doubt)

    def rebase(self, mark: CovarianceMark, covariance: FloatArray) -> None:
        """Count from a pose of the past, whose covariance `(6, 6)` is given."""
        self._bias_before = mark.per_disparity_bias, mark.corrected_bias
        self._doubt = self._doubt - mark.doubt
        self._doubted = Start(mark.position, covariance_of_doubt(self._doubt))
        if mark.window == self._window:
            self._start, self._reference = Start(mark.position, covariance), Start(mark.position, mark.in_window)
            return
        position = self._start.position  # what was not seen between the windows is in the present start
        at_start = Start(mark.position, covariance).propagated_to(position)
        self._start, self._reference = Start(position, self._start.covariance + at_start), None

    def after_gap(self, position: FloatArray, unseen: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` of a new window's start at the last known position.

        Args:
            position: `(3,)` metres, world.
            unseen: `(6, 6)` of the motion since it was known, in the world.
        """
        return np.asarray(self._of_window(position) + self._start.propagated_to(position) + unseen)

    def step(self, step: FloatArray, depth_m: float, right_offset_u: float) -> None:
        """Extend the path.

        Args:
            step: `(3,)` metres, world.
            depth_m: Median depth of the landmarks.
            right_offset_u: Offset along the rows that the step was corrected by, pixels.
        """
        per_bias = step * depth_m / (self._focal_px * self._baseline_m)
        self._position_per_disparity_bias += per_bias
        self._corrected_bias += per_bias * right_offset_u

    def doubt(self, position: FloatArray, step: tuple[float, float]) -> None:
        """Allow for a motion that may have been another one: it may err by metres and radians, always the same way."""
        before, self._doubt = self._doubt, self._doubt + step
        more = covariance_of_doubt(self._doubt) - covariance_of_doubt(before)
        self._doubted = Start(position, self._doubted.propagated_to(position) + more)

    def set_in_window(self, covariance: FloatArray) -> None:
        """Take the covariance `(6, 6)` of the last pose given by the window."""
        self._in_window, self._unseen = covariance, np.zeros((6, 6))

    def allow_unseen(self, covariance: FloatArray) -> None:
        """Allow for a motion `(6, 6)` that no image shows, until the window gives a pose again."""
        self._unseen = covariance

    def of_left(self, position: FloatArray, depth_m: float, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(6, 6)` of the left camera in the world.

        Args:
            position: `(3,)` metres, world.
            depth_m: Median depth of the landmarks.
            calibration: What is known of the right camera.
        """
        covariance = self._of_window(position) + self._start.propagated_to(position)
        if self._doubt.any():
            covariance = covariance + self._doubted.propagated_to(position)
        covariance = covariance + systematic_covariance(depth_m, self._config.common_px, self._focal_px)
        covariance[:3, :3] += self.path_covariance(calibration)
        covariance[3:, 3:] += np.eye(3) * (DRIFT_SHARE * calibration.followed_px / self._focal_px) ** 2
        return np.asarray(covariance + self._unseen)

    def _of_window(self, position: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` of the drift since the window's start, or since a pose that was given."""
        covariance = self._in_window
        if self._reference is not None:
            growth = covariance - self._reference.propagated_to(position)
            values, vectors = np.linalg.eigh(0.5 * (growth + growth.T))
            covariance = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(covariance * self._config.inflation)

    def path_covariance(self, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(3, 3)` of the position from errors that all disparities share.

        These are a constant error, the yaw of the right camera as far as it is unknown, and the path travelled before
        the yaw was found.
        """
        bias = self._position_per_disparity_bias - self._bias_before[0]
        uncorrected = calibration.target_u * bias - (self._corrected_bias - self._bias_before[1])
        variance = self._config.common_disparity_px**2 + calibration.sigma_u**2
        return np.asarray(variance * np.outer(bias, bias) + np.outer(uncorrected, uncorrected))


def covariance_of_doubt(doubt: tuple[float, float] | FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of errors of so many metres and radians."""
    return np.diag(np.repeat(np.square(doubt), 3))


def systematic_covariance(depth_m: float, systematic_px: float, focal_px: float) -> FloatArray:
    """Return the covariance `(6, 6)` of an error that a whole image shares (blur, jitter): it is unobservable.

    Args:
        depth_m: Median depth of the landmarks.
        systematic_px: Standard deviation, pixels.
        focal_px: Focal length, pixels.
    """
    angle = systematic_px / focal_px
    return np.diag(np.repeat(np.square([angle * depth_m, angle]), 3))


def covariance_of_point(covariance: FloatArray, rotation: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of the pose of another point of a rigid body, in other axes.

    Args:
        covariance: `(6, 6)` of a pose of the body, position and rotation about fixed axes.
        rotation: `(3, 3)` from these axes to the others.
        lever: `(3,)` from the point to the other, metres, in the other axes.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = rotation
    jacobian[:3, 3:] = -skew(lever) @ rotation
    result = jacobian @ covariance @ jacobian.T
    return np.asarray(0.5 * (result + result.T))
