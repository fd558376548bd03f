"""Properties of rotations, compared with SciPy and with the defining formulas."""

from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation, Slerp

from helpers.strategies import matrices, rotvecs, vectors
from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    matrix_from_rotvec,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
    rotvec_from_matrix,
    slerp,
    unit_quats,
)

TIGHT = 1e-14


@given(rotvecs)
def test_matrix_quaternion_and_log_keep_the_precision_of_small_and_of_half_turns(rotvec: np.ndarray) -> None:
    angle = float(np.linalg.norm(rotvec))
    axis = rotvec / angle if angle else np.zeros(3)
    wanted = np.array([*(axis * sin(angle / 2)), cos(angle / 2)])
    matrix = matrix_from_rotvec(rotvec)
    np.testing.assert_allclose(matrix, Rotation.from_rotvec(rotvec).as_matrix(), atol=TIGHT)
    found = quat_from_matrix(matrix)
    assert found[3] >= 0
    np.testing.assert_allclose(matrix_from_quat(-3.0 * found), matrix, atol=TIGHT)  # any length, either sign
    found = found if found @ wanted > 0 else -found
    np.testing.assert_allclose(found, wanted, atol=2e-15, rtol=0)
    if 0 < angle < 1e-3:  # relative to the angle: nothing may be lost near the identity
        np.testing.assert_allclose(found[:3], wanted[:3], atol=1e-15 * angle + 1e-300, rtol=0)
    again = rotvec_from_matrix(matrix)
    assert np.linalg.norm(again) <= pi + 1e-15
    near_half = angle > pi - 1e-7  # axis and its opposite mean nearly the same
    again = -again if near_half and again @ rotvec < 0 else again
    np.testing.assert_allclose(again, rotvec, atol=3e-7 if near_half else 1e-14 + 1e-14 * angle)


@pytest.mark.clause("3.1.1")
@given(matrices, matrices, vectors)
def test_products_inverses_and_rotations_are_those_of_matrices(
    a: np.ndarray, b: np.ndarray, vector: np.ndarray
) -> None:
    p, q = quat_from_matrix(a), quat_from_matrix(b)
    np.testing.assert_allclose(matrix_from_quat(quat_multiply(p, q)), a @ b, atol=TIGHT)
    np.testing.assert_allclose(matrix_from_quat(quat_conjugate(p)), a.T, atol=TIGHT)
    assert quat_conjugate(quat_conjugate(p)).tobytes() == p.tobytes()
    np.testing.assert_allclose(quat_rotate(p, vector), a @ vector, atol=1e-12)


@pytest.mark.clause("3.1.1")
def test_golden_quarter_turn() -> None:
    # A quarter turn about z takes x to y; its quaternion is sin 45 deg about z, cos 45 deg, scalar last.
    half = sqrt(0.5)
    np.testing.assert_allclose(matrix_from_quat([0, 0, half, half]) @ [1, 0, 0], [0, 1, 0], atol=TIGHT)
    np.testing.assert_allclose(matrix_from_rotvec([0, 0, pi / 2]), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=TIGHT)
    np.testing.assert_allclose(quat_from_matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), [0, 0, half, half], atol=TIGHT)


@pytest.mark.parametrize("quat", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1], [1e-20, 0, 0, 0]])
def test_no_rotation_in_these_numbers(quat: list[float]) -> None:
    for numbers in (quat, [[0, 0, 0, 1], quat]):
        with pytest.raises(GeometryError, match="is zero or not finite"):
            matrix_from_quat(numbers)


def test_slerp_takes_the_shortest_rotation_whatever_the_signs_of_the_quaternions() -> None:
    rng = np.random.default_rng(3)
    turns = Rotation.random(40, random_state=3)
    nearby = turns * Rotation.from_rotvec(rng.normal(0.0, 0.4, (40, 3)))
    share = rng.uniform(0.0, 1.0, 40)
    a, b = turns.as_quat(), nearby.as_quat() * rng.choice([-1.0, 1.0], (40, 1))
    for found, first, last, at in zip(slerp(a, b, share), turns, nearby, share, strict=True):
        expected = Slerp([0.0, 1.0], Rotation.concatenate([first, last]))(at)
        assert (Rotation.from_quat(found).inv() * expected).magnitude() == pytest.approx(0.0, abs=1e-7)
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(slerp(a, -a, share), a, atol=1e-15)  # one rotation in two ways
    np.testing.assert_allclose(np.linalg.norm(unit_quats(3.0 * a), axis=1), 1.0, atol=1e-15)
    assert np.isnan(unit_quats(np.zeros((1, 4)))).all(), "an attitude that is unknown"
