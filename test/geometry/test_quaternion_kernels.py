"""Compiled quaternions against scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sfr_loc_map.geometry.quaternion_kernels import (
    conjugate,
    product,
    rotated,
    row_difference,
    row_quat,
    slerp,
    unit_quats,
)

A, B = (Rotation.random(200, random_state=seed) for seed in (1, 2))


def test_products_rotate_by_the_second_first_and_rows_are_those_of_arrays() -> None:
    vectors = np.random.default_rng(3).normal(size=(200, 3))
    for a, b, vector, i in zip(A.as_quat(), B.as_quat(), vectors, range(200), strict=True):
        assert Rotation.from_quat(product(tuple(a), tuple(b))).as_matrix() == pytest.approx(
            A[i].as_matrix() @ B[i].as_matrix(), abs=1e-13
        )
        assert product(tuple(a), conjugate(tuple(a))) == pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-14)
        assert rotated(tuple(a), tuple(vector)) == pytest.approx(A[i].apply(vector), abs=1e-13)
    quats = 3.0 * A.as_quat()
    assert row_quat(quats, 7) == tuple(quats[7])
    assert row_difference(quats[:, :3].copy(), 5, quats[:, 1:].copy(), 2) == tuple(quats[5, :3] - quats[2, 1:])
    assert unit_quats(quats) == pytest.approx(A.as_quat(), abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slerp_takes_the_shortest_rotation(sign: float) -> None:
    shares = np.linspace(0.0, 1.0, 200)
    got = Rotation.from_quat(slerp(A.as_quat(), sign * B.as_quat(), shares))
    wanted = [Slerp([0, 1], Rotation.concatenate([A[k], B[k]]))(share).as_quat() for k, share in enumerate(shares)]
    assert (got * Rotation.from_quat(wanted).inv()).magnitude().max() < 1e-12
