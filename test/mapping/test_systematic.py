"""The calibration's part of a point's sigma, against points that a wrong calibration really moves."""

from dataclasses import replace

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import CalibrationUncertainty
from sfr_loc_map.mapping.disparity.camera_rotation import CameraRotation
from sfr_loc_map.mapping.reprojection import cloud_from_disparity
from sfr_loc_map.mapping.systematic import CalibrationSigma, check_calibration, total_sigma, widest

RIG = StereoRig(400, 300, 320.0, 320.0, 199.5, 149.5, 0.2)
POSE = Transform(matrix_from_rotvec([0.2, -0.4, 0.3]), np.array([3.0, -1.0, 2.0]))
NONE = CalibrationSigma(0.0, 0.0, 0.0, 0.0, 0.0)
ANGLE = 1e-4
"""Radians, and the share by which a length is wrong: small enough for the first order."""


def disparity_of(rotation: np.ndarray) -> np.ndarray:
    """Return the disparities of ground as a right camera rotated by a vector sees it."""
    v, u = np.mgrid[: RIG.height, : RIG.width].astype(float)
    depth = RIG.fx * RIG.baseline_m / (4.0 + 0.05 * v + 0.01 * u)
    left = np.stack(((u - RIG.cx) / RIG.fx, (v - RIG.cy) / RIG.fy, np.ones_like(u)), axis=-1) * depth[..., None]
    right = (left - [RIG.baseline_m, 0.0, 0.0]) @ matrix_from_rotvec(rotation)
    return u - (RIG.fx * right[..., 0] / right[..., 2] + RIG.cx)


def cloud_at(disparity: np.ndarray, rig: StereoRig = RIG, sigma_px: float = 0.0) -> object:
    deviation = np.full(disparity.shape, sigma_px, np.float32)
    grey = np.zeros(disparity.shape, np.uint8)
    return cloud_from_disparity(disparity.astype(np.float32), deviation, grey, rig, POSE, 0)


def moved_m(name: str) -> np.ndarray:
    """Return how far each point moves along its ray if one number of the calibration is wrong by `ANGLE`."""
    axes = {"pitch": 0, "yaw": 1, "roll": 2}
    rotation, rig = np.zeros(3), RIG
    if name in axes:
        rotation[axes[name]] = ANGLE
    elif name == "focal":
        rig = replace(RIG, fx=RIG.fx * (1 + ANGLE), fy=RIG.fy * (1 + ANGLE))
    else:
        rig = replace(RIG, baseline_m=RIG.baseline_m * (1 + ANGLE))
    true, wrong = cloud_at(disparity_of(np.zeros(3))), cloud_at(disparity_of(rotation), rig)
    return np.linalg.norm(wrong.xyz - true.xyz, axis=1)


@pytest.mark.parametrize("name", CalibrationSigma._fields)
def test_sigma_is_how_far_a_wrong_calibration_moves_the_points(name: str) -> None:
    cloud = cloud_at(disparity_of(np.zeros(3)))
    sigma = total_sigma(cloud, [POSE], RIG, NONE._replace(**{name: ANGLE}))
    moved = moved_m(name)
    if name == "focal":  # the depth alone moves, the point stays on its column and row
        ray = (cloud.xyz - POSE.translation) / np.linalg.norm(cloud.xyz - POSE.translation, axis=1)[:, None]
        moved = moved / (ray @ POSE.rotation[:, 2])
    near = np.abs(sigma - moved) < 0.02 * moved + 2e-5
    assert near.mean() > 0.999
    assert sigma.max() > 1e-4


def test_parts_add_as_variances_and_none_leaves_sigma_as_it_is() -> None:
    cloud = cloud_at(disparity_of(np.zeros(3)), sigma_px=0.1)
    np.testing.assert_array_equal(total_sigma(cloud, [POSE], RIG, NONE), cloud.sigma)
    parts = CalibrationSigma(1e-4, 2e-4, 3e-4, 1e-3, 2e-3)
    single = [total_sigma(cloud, [POSE], RIG, NONE._replace(**{n: v})) for n, v in parts._asdict().items()]
    variance = sum(np.square(s) - np.square(cloud.sigma) for s in single) + np.square(cloud.sigma)
    np.testing.assert_allclose(total_sigma(cloud, [POSE], RIG, parts), np.sqrt(variance), rtol=1e-4)


def test_a_measured_yaw_widens_sigma_and_is_told_a_doubtful_one_is_not() -> None:
    stated = CalibrationUncertainty()
    radians = np.radians(stated.yaw_deg)

    def checked(yaw_deg: float, sigma_deg: float) -> tuple[float, bool]:
        rotation = CameraRotation(np.radians(yaw_deg), np.radians(sigma_deg), 0.0, 0.0)
        check = check_calibration(stated, rotation, RIG)
        return check.sigma.yaw, bool(check.warnings)

    assert checked(0.008, 0.001) == (radians, False)  # as large as the calibration allows for
    assert checked(0.05, 0.02) == (radians, False)  # not measured
    assert checked(-0.015, 0.001) == (np.hypot(radians, np.radians(0.015)), False)
    assert checked(-0.05, 0.002) == (np.hypot(radians, np.radians(0.05)), True)
    wide, narrow = (check_calibration(stated, CameraRotation(y, 1e-6, 0.0, 0.0), RIG).sigma for y in (1e-3, 0.0))
    assert widest([narrow, wide, narrow]) == wide
