"""Points against the pinhole equations, their sigma against Monte Carlo and against a calibration that is wrong."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
from sfr_loc_map.mapping.pair_view import ViewPoints, reproject_pixels
from sfr_loc_map.mapping.point_sigma import total_sigma

SMALL = StereoRig(32, 24, 40.0, 44.0, 14.5, 12.25, 0.25)
RIG = StereoRig(400, 300, 320.0, 320.0, 199.5, 149.5, 0.2)
POSE = Transform(matrix_from_rotvec([0.2, -0.4, 0.3]), np.array([3.0, -1.0, 2.0]))
ANGLE = 1e-4
"""Radians, and the share by which a length is wrong: small enough for the first order."""


def test_sigma_is_the_scatter_along_the_ray() -> None:
    """Disparities drawn from a normal distribution; the ranges scatter by what is stated."""
    rng, sigma_px = np.random.default_rng(0), 0.05
    truth, grey = np.full((SMALL.height, SMALL.width), 5.0, np.float32), np.zeros((SMALL.height, SMALL.width), np.uint8)
    deviation, ranges = np.full_like(truth, sigma_px), []
    for _ in range(600):
        drawn = rng.normal(truth, sigma_px).astype(np.float32)
        points, _ = reproject_pixels(drawn, deviation, grey, SMALL, POSE)
        ranges.append(np.linalg.norm(points.xyz - POSE.translation, axis=1))
    of_truth, _ = reproject_pixels(truth, deviation, grey, SMALL, POSE)
    ratio = np.std(ranges, axis=0) / of_truth.fusion_sigma
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    assert ratio.std() < 0.04


def points_of(rotation: tuple[float, ...] = (0, 0, 0), rig: StereoRig = RIG, sigma_px: float = 0.0) -> ViewPoints:
    """Return the points of ground that a right camera rotated by a vector sees, as made with a rig."""
    v, u = np.mgrid[: RIG.height, : RIG.width].astype(float)
    depth = RIG.fx * RIG.baseline_m / (4.0 + 0.05 * v + 0.01 * u)
    left = np.stack(((u - RIG.cx) / RIG.fx, (v - RIG.cy) / RIG.fy, np.ones_like(u)), axis=-1) * depth[..., None]
    right = (left - [RIG.baseline_m, 0.0, 0.0]) @ matrix_from_rotvec(rotation)
    disparity = (u - (RIG.fx * right[..., 0] / right[..., 2] + RIG.cx)).astype(np.float32)
    points, _ = reproject_pixels(disparity, np.full_like(disparity, sigma_px), disparity.astype(np.uint8), rig, POSE)
    return points


def total(points: ViewPoints, calibration: CalibrationSigma) -> np.ndarray:
    """Return the total sigma of points of one pair."""
    return total_sigma(points, points.fusion_sigma, POSE, calibration, RIG)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("yaw_rad", {"rotation": (0.0, ANGLE, 0.0)}),
        ("pitch_rad", {"rotation": (ANGLE, 0.0, 0.0)}),
        ("roll_rad", {"rotation": (0.0, 0.0, ANGLE)}),
        ("focal_fraction", {"rig": replace(RIG, fx=RIG.fx * (1 + ANGLE), fy=RIG.fy * (1 + ANGLE))}),
        ("baseline_fraction", {"rig": replace(RIG, baseline_m=RIG.baseline_m * (1 + ANGLE))}),
    ],
)
def test_sigma_is_how_far_a_wrong_calibration_moves_the_points(name: str, wrong: dict[str, Any]) -> None:
    points = points_of()
    sigma = total(points, CalibrationSigma(**{name: ANGLE}))
    moved = np.linalg.norm(points_of(**wrong).xyz - points.xyz, axis=1)
    if name == "focal_fraction":  # the depth alone moves, the point stays on its column and row
        ray = (points.xyz - POSE.translation) / np.linalg.norm(points.xyz - POSE.translation, axis=1)[:, None]
        moved = moved / (ray @ POSE.rotation[:, 2])
    assert (np.abs(sigma - moved) < 0.02 * moved + 2e-5).mean() > 0.999
    assert sigma.max() > 1e-4


def test_parts_add_as_variances_and_none_leaves_sigma_as_it_is() -> None:
    points = points_of(sigma_px=0.1)
    random = points.fusion_sigma
    np.testing.assert_array_equal(total(points, CalibrationSigma()), random)
    parts = CalibrationSigma(1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 4e-4)
    single = [total(points, CalibrationSigma(**{name: value})) for name, value in parts._asdict().items()]
    variance = sum(np.square(s) - np.square(random) for s in single) + np.square(random)
    np.testing.assert_allclose(total(points, parts), np.sqrt(variance), rtol=1e-4)
