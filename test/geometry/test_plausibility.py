"""What can be a camera or a pose."""

import numpy as np
import pytest

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.plausibility import (
    check_camera,
    check_distortion,
    is_plausible_covariance,
    plausible_positions,
    plausible_quats,
)


def test_cameras_of_the_field_pass_and_absurd_distortion_does_not() -> None:
    check_camera((1242, 375), (721.5, 721.5), (609.6, 172.9))  # KITTI
    check_camera((752, 480), (458.7, 457.3), (367.2, 248.4))  # EuRoC
    check_camera((1024, 1024), (2000.0, 2000.0), (-900.0, 512.0))  # a crop
    check_distortion([-0.28, 0.07, 0.0002, 1.8e-05])
    for absurd in (np.nan, np.inf, 1e300, -1e3):
        with pytest.raises(GeometryError, match="distortion"):
            check_distortion([0.0, absurd])


def test_positions_and_quaternions_row_by_row() -> None:
    positions = np.array([[0, 0, 1e9], [0, 0, 1.1e9], [np.nan, 0, 0], [np.inf, 0, 0], [0, 1e308, 0]])
    assert plausible_positions(positions).tolist() == [True, False, False, False, False]
    quats = np.array([[0, 0, 0, -1], [0, 0, 0, 1.009], [0, 0, 0, 1.02], [0, 0, 0, 0], [np.nan, 0, 0, 1], [1e300] * 4])
    assert plausible_quats(quats).tolist() == [True, True, False, False, False, False]


def test_covariances() -> None:
    root = np.random.default_rng(0).normal(size=(6, 6))
    good = root @ root.T
    assert all(map(is_plausible_covariance, (good, np.zeros((6, 6)), np.eye(6) * 9999.0)))
    skewed, unbounded = good.copy(), good.copy()
    skewed[0, 1] += 1.0
    unbounded[3, 3] = 1e300
    assert not any(map(is_plausible_covariance, (skewed, unbounded, np.full((6, 6), np.nan), good - 50.0 * np.eye(6))))
