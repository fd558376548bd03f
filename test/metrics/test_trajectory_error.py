"""Errors of sub-trajectories against scipy's rotations, written as the definitions say."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.metrics.trajectory_error import (
    ALONG,
    ATTITUDE,
    CROSS,
    HEADING,
    TRAVELLED,
    VERTICAL,
    PoseRows,
    heading_rad,
    sub_trajectory_errors,
    wrapped_deg,
)

COUNT = 60


def poses(seed: int, spread: float) -> PoseRows:
    """True poses and estimates that are off by up to `spread` rad and m."""
    rng = np.random.default_rng(seed)
    truth = Rotation.random(COUNT, random_state=seed)
    estimate = truth * Rotation.from_rotvec(spread * rng.uniform(-1, 1, (COUNT, 3)))
    position = rng.normal(0, 5, (COUNT, 3))
    lengths = np.cumsum(rng.uniform(0, 1, (COUNT, 2)), axis=0)
    return PoseRows(
        position, truth.as_quat(), position + spread * rng.normal(size=(COUNT, 3)), estimate.as_quat(), lengths
    )


@pytest.mark.clause("4.1.2", "4.2.3.1", "4.2.3.2", "4.2.3.3")
@pytest.mark.parametrize("whole_pose", [True, False])
@pytest.mark.parametrize("spread", [1e-9, 0.1, 3.0])
def test_errors_are_those_of_the_definition(spread: float, whole_pose: bool) -> None:
    rows = poses(3, spread)
    starts, ends = np.arange(0, 30), np.arange(30, 60)
    got = sub_trajectory_errors(rows, starts, ends, whole_pose)
    for k, (i, j) in enumerate(zip(starts, ends, strict=True)):
        gt_i, gt_j, est_i, est_j = (
            Rotation.from_quat(q) for q in (rows.gt_quat[i], rows.gt_quat[j], rows.est_quat[i], rows.est_quat[j])
        )
        correction = gt_i * est_i.inv() if whole_pose else Rotation.identity()
        true_move = rows.gt_pos[j] - rows.gt_pos[i]
        error = correction.apply(rows.est_pos[j] - rows.est_pos[i]) - true_move
        attitude = correction * est_j
        turn = math.degrees((gt_j.inv() * attitude).magnitude())
        headings = [math.atan2(*r.apply([1.0, 0.0, 0.0])[1::-1]) for r in (attitude, gt_j)]
        forward = true_move[:2] / np.linalg.norm(true_move[:2])
        assert got[k, :3] == pytest.approx(error, abs=1e-12)
        assert got[k, ATTITUDE] == pytest.approx(turn, abs=1e-10)
        heading = math.remainder(math.degrees(headings[0] - headings[1]), 360.0)
        assert got[k, HEADING] == pytest.approx(heading, abs=1e-10)
        assert got[k, ALONG] == pytest.approx(forward @ error[:2], abs=1e-12)
        assert got[k, CROSS] == pytest.approx(forward[0] * error[1] - forward[1] * error[0], abs=1e-12)
        assert got[k, VERTICAL] == pytest.approx(error[2], abs=1e-12)
        path = rows.lengths[j].sum() - rows.lengths[i].sum()
        assert got[k, TRAVELLED] == pytest.approx(path, abs=1e-12)


@pytest.mark.clause("4.1.2")
def test_errors_do_not_depend_on_the_world_frame_of_the_estimate() -> None:
    """Re-based by the whole pose, a rotated and shifted world changes nothing."""
    rows = poses(5, 0.2)
    world = Rotation.random(random_state=9)
    moved = rows._replace(
        est_pos=world.apply(rows.est_pos) + np.array([3.0, -2.0, 1.0]),
        est_quat=(world * Rotation.from_quat(rows.est_quat)).as_quat(),
    )
    starts, ends = np.arange(0, 30), np.arange(30, 60)
    whole = [sub_trajectory_errors(each, starts, ends, True) for each in (rows, moved)]
    assert whole[0] == pytest.approx(whole[1], abs=1e-10)


def test_without_a_horizontal_displacement_the_heading_is_the_direction() -> None:
    yaw = np.array([0.0, 0.0, math.sin(0.4), math.cos(0.4)])
    still, up = np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 5.0]])
    rows = PoseRows(still, np.tile(yaw, (2, 1)), up, np.tile(yaw, (2, 1)), np.zeros((2, 2)))
    got = sub_trajectory_errors(rows, np.array([0]), np.array([1]), True)[0]
    assert got[ALONG] == pytest.approx(math.cos(0.8) + 2.0 * math.sin(0.8))
    assert got[CROSS] == pytest.approx(2.0 * math.cos(0.8) - math.sin(0.8))


@pytest.mark.clause("4.2.3.3")
@pytest.mark.parametrize(("angle", "wrapped"), [(0, 0), (180, 180), (-180, 180), (181, -179), (540, 180), (-359, 1)])
def test_angles_are_wrapped(angle: float, wrapped: float) -> None:
    assert wrapped_deg(float(angle)) == wrapped


@pytest.mark.clause("4.2.3.3")
def test_heading_is_that_of_the_forward_axis() -> None:
    for rotation in Rotation.random(50, random_state=4):
        x, y, _ = rotation.apply([1.0, 0.0, 0.0])
        assert heading_rad(tuple(rotation.as_quat())) == pytest.approx(math.atan2(y, x), abs=1e-12)
