"""The frames of the rover: places worked out by hand."""

from __future__ import annotations

from math import cos, pi, radians, sin

import numpy as np
import pytest

from sfr_loc_map.simulation.rover import GROUND_HEIGHT_RB_M, mast_head_in_rb

AXIS = np.array([0.451, 0.317, 0.594])
"""Where the tilt axis meets the x-z plane of the mast [3.2.6]: on the pan axis, so it stays there."""


@pytest.mark.clause("3.2.2", "3.2.6")
@pytest.mark.parametrize(
    ("pan", "tilt", "forward", "left"),
    [
        (0, 0, (1, 0, 0), (0, 1, 0)),
        (pi / 2, 0, (0, 1, 0), (-1, 0, 0)),  # to the left: forward becomes left, left becomes back
        (-pi / 2, 0, (0, -1, 0), (1, 0, 0)),
        (0, pi / 2, (0, 0, -1), (0, 1, 0)),  # straight down; the tilt axis does not move
        (pi / 2, pi / 2, (0, 0, -1), (-1, 0, 0)),
        (pi, 0, (-1, 0, 0), (0, -1, 0)),
        # 30 deg left, then 20 deg down about the carried axis
        (
            radians(30),
            radians(20),
            (cos(radians(20)) * cos(radians(30)), cos(radians(20)) * sin(radians(30)), -sin(radians(20))),
            (-sin(radians(30)), cos(radians(30)), 0),
        ),
    ],
)
def test_mast_head(pan: float, tilt: float, forward: tuple[float, ...], left: tuple[float, ...]) -> None:
    T_rb_head = mast_head_in_rb(pan, tilt)
    np.testing.assert_allclose(T_rb_head.apply([2, 0, 0]), AXIS + 2 * np.array(forward), atol=1e-15)
    np.testing.assert_allclose(T_rb_head.apply([0, 2, 0]), AXIS + 2 * np.array(left), atol=1e-15)
    np.testing.assert_array_equal(T_rb_head.translation, AXIS)


@pytest.mark.clause("3.2.1", "3.2.6")
def test_a_point_ahead_of_the_head_falls_on_the_ground_where_triangles_say() -> None:
    # The tilt axis is 0.594 + 0.540 = 1.134 m above the ground; 45 deg down it is reached 1.134 m ahead.
    distance = (0.594 + 0.540) * 2**0.5
    point = mast_head_in_rb(0.0, radians(45)).apply([distance, 0, 0])
    np.testing.assert_allclose(point, [0.451 + 1.134, 0.317, GROUND_HEIGHT_RB_M], atol=1e-12)
