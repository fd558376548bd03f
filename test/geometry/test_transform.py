"""Properties of rigid motions, and the difference between an orientation of ROS and `att_q`."""

from math import cos, radians, sin

import numpy as np
import pytest
from hypothesis import given

from helpers.strategies import matrices, transforms, vectors
from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_conjugate, quat_from_matrix
from sfr_loc_map.geometry.transform import Transform

CLOSE = 1e-11


@given(transforms, transforms, vectors)
def test_products_and_inverses_are_those_of_homogeneous_matrices(
    T_a_b: Transform, T_b_c: Transform, point: np.ndarray
) -> None:
    np.testing.assert_allclose((T_a_b @ T_a_b.inverse()).matrix, np.eye(4), atol=CLOSE)
    wanted = (T_a_b.matrix @ T_b_c.matrix @ [*point, 1.0])[:3]
    np.testing.assert_allclose(T_a_b.apply(T_b_c.apply(np.stack([point] * 2)))[1], wanted, atol=CLOSE)
    np.testing.assert_allclose((T_a_b @ T_b_c).apply(point), wanted, atol=CLOSE)


@pytest.mark.clause("3.1.2")
@given(matrices, vectors)
def test_origin_and_attitude_of_the_source_document(matrix: np.ndarray, origin: np.ndarray) -> None:
    # att_q_AToB turns components in A into components in B: it rotates as the transpose of T_a_b does.
    T_a_b = Transform.from_origin_and_attitude(origin, quat_from_matrix(matrix.T))
    np.testing.assert_allclose(T_a_b.rotation, matrix, atol=1e-14)
    np.testing.assert_array_equal(T_a_b.apply([0, 0, 0]), origin)


@pytest.mark.clause("3.1.1", "3.1.2")
def test_golden_conjugate_trap() -> None:
    # The rover at (1, 2, 0) m looks along the y axis of DS: turned left by 90 deg about z, seen from above.
    # A rock 3 m ahead of it, at (3, 0, 0) in RB, lies at (1, 5, 0) in DS.
    # ROS orientation of RB in DS: +90 deg about z = (0, 0, sin 45, cos 45).
    # att_q_DsToRb takes the direction "y of DS" to "x of RB": -90 deg about z = (0, 0, -sin 45, cos 45).
    s, c = sin(radians(45)), cos(radians(45))
    ros = Transform.from_quat([1, 2, 0], [0, 0, s, c])
    att = Transform.from_origin_and_attitude([1, 2, 0], [0, 0, -s, c])
    wrong = Transform.from_quat([1, 2, 0], [0, 0, -s, c])
    np.testing.assert_allclose(ros.apply([3, 0, 0]), [1, 5, 0], atol=1e-15)
    np.testing.assert_allclose(att.apply([3, 0, 0]), [1, 5, 0], atol=1e-15)
    np.testing.assert_allclose(wrong.apply([3, 0, 0]), [1, -1, 0], atol=1e-15)
    np.testing.assert_allclose(quat_conjugate(att.quat_xyzw), [0, 0, -s, c], atol=1e-15)
    np.testing.assert_allclose(ros.inverse().rotation @ [0, 1, 0], [1, 0, 0], atol=1e-15)


def test_quaternion_given_is_written_again_and_none_is_made_up() -> None:
    given_quat = [0.1, -0.2, 0.3, -0.93]
    assert Transform.from_quat([0, 0, 0], given_quat).file_quat_xyzw.tolist() == given_quat
    att = Transform.from_origin_and_attitude([0, 0, 0], given_quat)
    assert quat_conjugate(att.file_quat_xyzw).tolist() == given_quat
    product = Transform.identity() @ att
    assert product.file_quat_xyzw.tolist() == product.quat_xyzw.tolist()


@pytest.mark.parametrize("scale", [-1.0, 1.1, np.nan, 1e300])
def test_what_is_no_rotation_is_refused_and_one_of_a_few_digits_is_taken(scale: float) -> None:
    rotation = matrix_from_rotvec([0.3, -2.0, 0.5])
    Transform.from_matrix(np.c_[np.round(rotation, 4), np.zeros(3)])
    with pytest.raises(GeometryError, match="not a rotation"):
        Transform.from_matrix(np.c_[scale * rotation, np.zeros(3)])
    with pytest.raises(GeometryError, match="is not a rotation"):
        Transform.from_quat([0, 0, 0], [0, 0, 0, scale + 1.0])


def test_a_transposed_matrix_is_refused() -> None:
    pose = Transform.from_quat([1.0, 2.0, 3.0], [0.0, 0.0, 0.6, 0.8])
    assert np.array_equal(Transform.from_matrix(pose.matrix).matrix, pose.matrix)
    with pytest.raises(GeometryError, match="last row"):
        Transform.from_matrix(pose.matrix.T)
