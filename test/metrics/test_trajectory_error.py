"""Laws of the errors of sub-trajectories; `reference.py` says what they are."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.metrics.trajectory_error import (
    ALONG,
    CROSS,
    ONLY_POSITION,
    WHOLE_POSE,
    PoseRows,
    heading_rad,
    headings_rad,
    sub_trajectory_errors,
    wrapped_deg,
)


@pytest.mark.clause("4.1.2")
def test_errors_do_not_depend_on_the_world_frame_of_the_estimate() -> None:
    """Re-based by the whole pose, a rotated and shifted world changes nothing."""
    rng, count = np.random.default_rng(5), 60
    truth = Rotation.random(count, random_state=5)
    estimate = truth * Rotation.from_rotvec(0.2 * rng.uniform(-1, 1, (count, 3)))
    position = rng.normal(0, 5, (count, 3))
    moved = position + 0.2 * rng.normal(size=(count, 3))
    headings = headings_rad(truth.as_quat()), headings_rad(estimate.as_quat())
    rows = PoseRows(position, truth.as_quat(), moved, estimate.as_quat(), rng.uniform(0, 1, (count, 2)), *headings)
    world = Rotation.random(random_state=9)
    turned = (world * estimate).as_quat()
    shifted = world.apply(moved) + np.array([3.0, -2.0, 1.0])
    other = rows._replace(est_pos=shifted, est_quat=turned, est_heading=headings_rad(turned))
    starts, ends = np.arange(0, 30), np.arange(30, 60)
    whole = [sub_trajectory_errors(each, starts, ends, WHOLE_POSE) for each in (rows, other)]
    assert whole[0] == pytest.approx(whole[1], abs=1e-10)
    only_position = [sub_trajectory_errors(each, starts, ends, ONLY_POSITION) for each in (rows, other)]
    assert np.abs(only_position[0] - only_position[1]).max() > 1.0


def test_without_a_horizontal_displacement_the_heading_is_the_direction() -> None:
    yaw = np.array([0.0, 0.0, math.sin(0.4), math.cos(0.4)])
    still, up = np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 5.0]])
    quats, headings = np.tile(yaw, (2, 1)), np.full(2, 0.8)
    rows = PoseRows(still, quats, up, quats, np.zeros((2, 2)), headings, headings)
    got = sub_trajectory_errors(rows, np.array([0]), np.array([1]), WHOLE_POSE)[0]
    assert got[ALONG] == pytest.approx(math.cos(0.8) + 2.0 * math.sin(0.8))
    assert got[CROSS] == pytest.approx(2.0 * math.cos(0.8) - math.sin(0.8))


@pytest.mark.clause("4.2.3.3")
def test_heading_is_that_of_the_forward_axis_and_angles_are_wrapped() -> None:
    for rotation in Rotation.random(50, random_state=4):
        x, y, _ = rotation.apply([1.0, 0.0, 0.0])
        assert heading_rad(tuple(rotation.as_quat())) == pytest.approx(math.atan2(y, x), abs=1e-12)
    for angle, wrapped in ((0, 0), (180, 180), (-180, 180), (181, -179), (540, 180), (-359, 1)):
        assert wrapped_deg(float(angle)) == wrapped
