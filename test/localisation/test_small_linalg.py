"""Small linear algebra against numpy and scipy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from sfr_loc_map.localisation.small_linalg import cholesky, fill_inverse_3, fill_inverse_4, retract, solve

SEEDS = st.integers(0, 2**32 - 1)


def positive_definite(seed: int, size: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, size))
    return root @ root.T + 0.1 * size * np.eye(size)


@settings(max_examples=50)
@given(SEEDS, st.integers(1, 8))
def test_factor_and_solution_are_those_of_numpy(seed: int, size: int) -> None:
    matrix = positive_definite(seed, size)
    rhs = np.random.default_rng(seed + 1).normal(size=size)
    np.testing.assert_allclose(cholesky(matrix), np.linalg.cholesky(matrix), atol=1e-12)
    np.testing.assert_allclose(solve(matrix, rhs), np.linalg.solve(matrix, rhs), rtol=1e-9, atol=1e-12)


@settings(max_examples=50)
@given(SEEDS, st.sampled_from([0.0, 1.0, 1e8]), st.sampled_from([1e-6, 1.0, 1e6]))
def test_inverses_of_fixed_size_are_those_of_numpy(seed: int, unobserved: float, unit: float) -> None:
    """An image that was not observed adds a large variance to its two rows; the last of 3 may have another unit."""
    matrix, out = positive_definite(seed, 4) + np.diag([0.0, 0.0, unobserved, unobserved]), np.full((4, 4), np.nan)
    fill_inverse_4(matrix, out)
    np.testing.assert_allclose(out, np.linalg.inv(matrix), rtol=1e-6, atol=1e-12)
    matrix, out, scale = positive_definite(seed, 3), np.full((3, 3), np.nan), np.outer([1, 1, unit], [1, 1, unit])
    fill_inverse_3(matrix * scale, out)
    np.testing.assert_allclose(out * scale, np.linalg.inv(matrix), rtol=1e-9)


@settings(max_examples=50)
@given(SEEDS, st.sampled_from([0.0, 1e-9, 1e-5, 1e-4, 1e-3, 0.1, 3.0]))
def test_retraction_is_the_matrix_exponential_from_the_left(seed: int, angle: float) -> None:
    random = np.random.default_rng(seed)
    axis = random.normal(size=3)
    w = angle * axis / np.linalg.norm(axis)
    rotation = np.linalg.qr(random.normal(size=(3, 3)))[0]
    cross = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    np.testing.assert_allclose(retract(rotation, *w), expm(cross) @ rotation, atol=1e-13)
    for _ in range(30):
        rotation = retract(rotation, *w)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
