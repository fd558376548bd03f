"""Relative covariance of two poses from the steps between them."""

import numpy as np
import pytest

from sfr_loc_map.geometry.quaternion_kernels import unit_quats
from sfr_loc_map.geometry.rotation import matrix_from_quat, matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, propagation
from sfr_loc_map.metrics.trajectory.relative_covariance import StepSums, accumulated, relative_covariance

COUNT = 30
RNG = np.random.default_rng(7)
POSITIONS = np.cumsum(RNG.normal(0.0, 0.3, (COUNT, 3)), axis=0)
QUATS = unit_quats(RNG.normal(0.0, 1.0, (COUNT, 4)))
ROOTS = RNG.normal(0.0, 0.01, (COUNT, 6, 6))
SYSTEMATIC = RNG.normal(0.0, 0.01, (COUNT, 6))
COVARIANCES = ROOTS @ ROOTS.transpose(0, 2, 1)
STEPS = np.column_stack((COVARIANCES[:, *np.triu_indices(6)], SYSTEMATIC))
NONE_LOST = np.zeros(COUNT, np.bool_)


def sums(steps: np.ndarray = STEPS, lost: np.ndarray = NONE_LOST) -> np.ndarray:
    return accumulated(steps, lost, POSITIONS, QUATS, StepSums.none())[0]


def in_ds(step: int) -> np.ndarray:
    rotation = matrix_from_quat(QUATS[step - 1])
    return np.kron(np.eye(2), rotation)


def test_steps_are_composed_as_one_after_the_other() -> None:
    composed, systematic = np.zeros((6, 6)), np.zeros(6)
    for k in range(5, 21):
        move = POSITIONS[k] - POSITIONS[k - 1] if k > 5 else np.zeros(3)
        composed = propagated_covariance(composed, move) + in_ds(k) @ COVARIANCES[k] @ in_ds(k).T
        systematic = propagation(move) @ systematic + in_ds(k) @ SYSTEMATIC[k]
    found = relative_covariance(sums()[4], sums()[20], POSITIONS[20])
    assert found is not None
    np.testing.assert_allclose(found, composed + np.outer(systematic, systematic), rtol=1e-9, atol=1e-12)


def test_errors_of_drawn_steps_have_that_covariance() -> None:
    """Sampled: each step errs by a draw of its own, and all by one draw alike; poses are composed of them."""
    random, count, first, last = np.random.default_rng(1), 400, 3, 6
    poses = [Transform.from_quat(p, q) for p, q in zip(POSITIONS, QUATS, strict=True)]
    errors = np.empty((count, 6))
    for sample in range(count):
        alike, pose = random.normal(), poses[first]
        for k in range(first + 1, last + 1):
            error = 0.1 * (ROOTS[k] @ random.normal(size=6) + alike * SYSTEMATIC[k])
            step = poses[k - 1].inverse() @ poses[k]
            rotation = matrix_from_rotvec(error[3:]) @ step.rotation
            pose = pose @ Transform(rotation, step.translation + error[:3])
        turn = pose.rotation @ poses[last].rotation.T
        errors[sample, :3] = pose.translation - poses[last].translation
        errors[sample, 3:] = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    found = relative_covariance(sums()[first], sums()[last], POSITIONS[last])
    assert found is not None
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(100.0 * np.cov(errors, rowvar=False) / scale, found / scale, atol=0.25)


@pytest.mark.parametrize("cut", [1, 13, COUNT - 1])
def test_portions_give_the_bits_of_the_whole(cut: int) -> None:
    first, between = accumulated(STEPS[:cut], NONE_LOST[:cut], POSITIONS[:cut], QUATS[:cut], StepSums.none())
    second, _ = accumulated(STEPS[cut:], NONE_LOST[cut:], POSITIONS[cut:], QUATS[cut:], between)
    assert np.concatenate((first, second)).tobytes() == sums().tobytes()


def test_a_lost_pose_has_no_step_and_an_unknown_step_has_no_covariance() -> None:
    steps = STEPS.copy()
    steps[8] = np.nan
    found = sums(steps)
    assert relative_covariance(found[7], found[12], POSITIONS[12]) is None
    assert relative_covariance(found[8], found[12], POSITIONS[12]) is not None
    lost = NONE_LOST.copy()
    lost[8] = True
    assert relative_covariance(sums(steps, lost)[7], sums(steps, lost)[12], POSITIONS[12]) is not None
