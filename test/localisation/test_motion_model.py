"""Initial guesses of the next pose."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.motion_model import MAX_MISSED_PAIRS, MotionModel

T_RB_LEFT = Transform.from_quat([0.3, 0.1, 0.2], [0.5, -0.5, 0.5, -0.5])
START = Transform.from_quat([1.0, 2.0, 3.0], [0.1, 0.3, 0.3, 0.9])
STEP = Transform(matrix_from_rotvec([0.01, -0.02, 0.03]), np.array([0.05, 0.01, 0.2]))
PERIOD_NS = 100_000_000


def path(count: int) -> list[Transform]:
    poses = [START]
    for _ in range(count - 1):
        poses.append(poses[-1] @ STEP)
    return poses


@pytest.fixture
def driven() -> MotionModel:
    """A model that has seen three poses one period apart."""
    model = MotionModel(T_RB_LEFT)
    model.restart(0)
    for index in (1, 2):
        model.update(index * PERIOD_NS, STEP)
    return model


def guesses(model: MotionModel, stamp_ns: int, motion: Transform | None = None) -> list[np.ndarray]:
    return [guess.matrix for guess in model.predictions(path(3)[-1], stamp_ns, motion)]


def test_constant_velocity_first_then_standstill(driven: MotionModel) -> None:
    first, second = guesses(driven, 3 * PERIOD_NS)
    np.testing.assert_allclose(first, path(4)[-1].matrix, atol=1e-12)
    np.testing.assert_array_equal(second, path(3)[-1].matrix)


@pytest.mark.parametrize("missed", [1, MAX_MISSED_PAIRS])
def test_missed_pairs_are_counted_by_the_stamps(driven: MotionModel, missed: int) -> None:
    found = guesses(driven, (3 + missed) * PERIOD_NS)
    assert len(found) == 3
    np.testing.assert_allclose(found[2], path(4 + missed)[-1].matrix, atol=1e-12)


@pytest.mark.parametrize("stamp_ns", [3 * PERIOD_NS, round(3.4 * PERIOD_NS), (4 + MAX_MISSED_PAIRS) * PERIOD_NS, 0])
def test_no_extrapolation_over_no_pair_nor_over_too_many(driven: MotionModel, stamp_ns: int) -> None:
    assert len(guesses(driven, stamp_ns)) == 2


def test_wheel_odometry_is_a_motion_of_the_rover(driven: MotionModel) -> None:
    poses = path(4)
    before, now = (pose @ T_RB_LEFT.inverse() for pose in poses[2:])
    found = guesses(driven, 3 * PERIOD_NS, before.inverse() @ now)
    np.testing.assert_allclose(found[-1], poses[3].matrix, atol=1e-12)
    assert len(found) == 3


def test_a_stopped_model_predicts_rest_and_knows_the_period(driven: MotionModel) -> None:
    driven.stop()
    for guess in guesses(driven, 5 * PERIOD_NS):
        np.testing.assert_array_equal(guess, path(3)[-1].matrix)
    driven.update(5 * PERIOD_NS, STEP)
    assert len(guesses(driven, 8 * PERIOD_NS)) == 2  # that is the period now
    assert len(guesses(driven, 11 * PERIOD_NS)) == 3


def test_a_restarted_model_does_not_know_the_period(driven: MotionModel) -> None:
    driven.restart(10 * PERIOD_NS)
    assert len(guesses(driven, 13 * PERIOD_NS)) == 2
