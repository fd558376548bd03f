"""Values of geometry refuse other objects than arrays of their shape and type by a GeometryError."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform

IMAGE = np.zeros((4, 6), np.uint8)
ONE = np.ones(1, np.float32)
PIXEL = np.ones(1, np.uint16)
XYZ = np.zeros((1, 3), np.float32)
POSE = (np.zeros(1, np.int64), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
CONSTRUCTORS: dict[str, Callable[[Any], object]] = {
    "left image": lambda wrong: StereoPair(0, wrong, IMAGE),
    "right image": lambda wrong: StereoPair(0, IMAGE, wrong),
    "rotation": lambda wrong: Transform(wrong, np.zeros(3)),
    "translation": lambda wrong: Transform(np.eye(3), wrong),
    "xyz": lambda wrong: PointCloud(wrong, ONE, ONE, PIXEL, PIXEL, np.zeros(1, np.uint8)),
    "pair": lambda wrong: PointCloud(XYZ, ONE, ONE, PIXEL, PIXEL, wrong),
    "stamps": lambda wrong: Trajectory(wrong, *POSE[1:]),
    "positions": lambda wrong: Trajectory(POSE[0], wrong, POSE[2]),
}


@pytest.mark.parametrize("name", CONSTRUCTORS)
@pytest.mark.parametrize("wrong", [None, 3, "abc", [[0, 0, 0]], [0], np.zeros(7), np.float32(1.0), np.array(2)])
def test_a_value_that_is_not_an_array_of_the_shape_is_refused(name: str, wrong: Any) -> None:
    with pytest.raises(GeometryError, match=name if name != "positions" else "stamps, positions"):
        CONSTRUCTORS[name](wrong)


@pytest.mark.parametrize("rows", [3, 4])
def test_a_matrix_may_be_nested_lists(rows: int) -> None:
    pose = Transform.from_matrix(np.eye(4)[:rows].tolist())
    np.testing.assert_array_equal(pose.matrix, np.eye(4))
