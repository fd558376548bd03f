"""The path that a node publishes has a bounded number of evenly spaced poses."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.localisation.thinned_path import ThinnedPath


def along(x: float, turn: float = 0.0) -> Transform:
    return Transform(matrix_from_rotvec([0.0, 0.0, turn]) if turn else np.eye(3), np.array([x, 0.0, 0.0]))


def test_a_long_drive_stays_bounded_and_even() -> None:
    path: ThinnedPath[float] = ThinnedPath(100)
    for index in range(1500):
        path.add(index, along(0.05 * index), 0.05 * index)
        assert len(path.poses) <= 100
    assert (path.poses[0], path.poses[-1]) == (0.0, pytest.approx(0.05 * 1499))
    gaps = np.diff(path.poses[:-1])
    assert len(path.poses) >= 40
    assert gaps.max() <= 2.5 * gaps.min()
