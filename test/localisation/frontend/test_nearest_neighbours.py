import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from sfr_loc_map.localisation.frontend.nearest_neighbours import nearest


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 80),
    st.integers(0, 80),
    st.integers(1, 9),
    st.sampled_from([1.0, 0.01, 1e4]),
)
def test_the_same_as_a_search_tree(seed: int, points: int, others: int, count: int, flat: float) -> None:
    """Compared with scipy's k-d tree; a flat cloud (along u or along v) is the hard case of a walk along u."""
    random = np.random.default_rng(seed)
    uv = random.uniform(0.0, 1.0, (points, 2)) * [flat, 1.0]
    support = np.concatenate((uv, random.uniform(0.0, 1.0, (others, 2)) * [flat, 1.0]))
    count = min(count, len(support))
    distance, index = nearest(uv, support, count)
    expected, which = (np.reshape(part, (points, count)) for part in cKDTree(support).query(uv, k=count))
    assert np.array_equal(distance, expected)
    assert np.array_equal(index, which)


@pytest.mark.parametrize("count", [1, 3, 7])
def test_equal_points_are_all_found(count: int) -> None:
    support = np.array([[1.0, 1.0]] * 4 + [[2.0, 1.0]] * 3)
    distance, index = nearest(np.array([[1.0, 1.0], [9.0, 1.0]]), support, count)
    assert distance.tolist() == [
        [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0][:count],
        [7.0, 7.0, 7.0, 8.0, 8.0, 8.0, 8.0][:count],
    ]
    assert all(len(set(row)) == count for row in index.tolist())


def test_nothing_to_look_for() -> None:
    distance, index = nearest(np.zeros((0, 2)), np.zeros((3, 2)), 2)
    assert distance.shape == index.shape == (0, 2)
