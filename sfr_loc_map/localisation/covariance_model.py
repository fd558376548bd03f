"""Covariance of the rover's pose: drift of the window, start, calibration, and errors that all landmarks share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import skew
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import LocalisationConfig

UNSEEN_SIGMA = (1.0, 1.0, 0.3, 0.1, 0.1, 0.5)
"""Standard deviation of an unobserved motion of the rover, in any direction, metres and radians."""


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


class CovarianceModel:
    """Adds to the covariance of a pose in its window what the window does not contain.

    The path integral of position over disparity error tells how far a constant error of all disparities has moved the
    pose: a disparity error of 1 px scales a step by `depth / (fx baseline)`.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig) -> None:
        """Start without a path."""
        self._focal_px, self._baseline_m, self._config = rig.fx, rig.baseline_m, config
        self._in_window, self._unobserved, self._repeats = np.zeros((6, 6)), np.zeros((6, 6)), 0
        self._start = Start(np.zeros(3), np.zeros((6, 6)))
        self._position_per_disparity_bias, self._corrected_bias = np.zeros(3), np.zeros(3)

    def start(self, position: FloatArray, covariance: FloatArray, in_window: FloatArray, depth_m: float) -> None:
        """Begin a window.

        Args:
            position: `(3,)` of its first pose, metres, world.
            covariance: `(6, 6)` of that pose.
            in_window: `(6, 6)` of it given by the window itself.
            depth_m: Median depth of the landmarks: the first image has the error of any whole image.
        """
        systematic = systematic_covariance(depth_m, self._config.common_px, self._focal_px)
        self._start = Start(position, covariance + systematic)
        self.set_in_window(in_window)

    def after_gap(self, position: FloatArray, in_window: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` of a new window's start at the last known position, after lost tracking."""
        return np.asarray(in_window + self._start.propagated_to(position) + np.diag(np.square(UNSEEN_SIGMA)))

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

    def set_in_window(self, covariance: FloatArray) -> None:
        """Take the covariance `(6, 6)` of the last pose given by the window."""
        self._in_window, self._unobserved, self._repeats = covariance, np.zeros((6, 6)), 0

    def repeat(self, step: tuple[float, float]) -> None:
        """Allow for one more motion that no image shows, of the size of the last one: metres and radians."""
        self._repeats += 1
        self._unobserved = np.diag((self._repeats * np.repeat(step, 3)) ** 2) / self._config.inflation

    def of_left(self, position: FloatArray, depth_m: float, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(6, 6)` of the left camera in the world.

        Args:
            position: `(3,)` metres, world.
            depth_m: Median depth of the landmarks.
            calibration: What is known of the right camera.
        """
        in_window = self._in_window + self._unobserved
        covariance = in_window * self._config.inflation + self._start.propagated_to(position)
        covariance = covariance + systematic_covariance(depth_m, self._config.common_px, self._focal_px)
        covariance[:3, :3] += self.path_covariance(calibration)
        return np.asarray(covariance)

    def path_covariance(self, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(3, 3)` of the position from errors that all disparities share.

        These are a constant error, the yaw of the right camera as far as it is unknown, and the path travelled before
        the yaw was found.
        """
        bias = self._position_per_disparity_bias
        uncorrected = calibration.target_u * bias - self._corrected_bias
        variance = self._config.common_disparity_px**2 + calibration.sigma_u**2
        return np.asarray(variance * np.outer(bias, bias) + np.outer(uncorrected, uncorrected))


def systematic_covariance(depth_m: float, systematic_px: float, focal_px: float) -> FloatArray:
    """Return the covariance `(6, 6)` of an error that a whole image shares (blur, jitter): it is unobservable.

    Args:
        depth_m: Median depth of the landmarks.
        systematic_px: Standard deviation, pixels.
        focal_px: Focal length, pixels.
    """
    angle = systematic_px / focal_px
    return np.diag(np.repeat(np.square([angle * depth_m, angle]), 3))


def covariance_of_rb(covariance: FloatArray, R_ds_world: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of RB in DS.

    Args:
        covariance: `(6, 6)` of the left camera in the world.
        R_ds_world: `(3, 3)` world to DS.
        lever: `(3,)` from the camera to RB, metres, DS.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = R_ds_world
    jacobian[:3, 3:] = -skew(lever) @ R_ds_world
    result = jacobian @ covariance @ jacobian.T
    return np.asarray(0.5 * (result + result.T))
