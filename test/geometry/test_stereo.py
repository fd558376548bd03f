"""The frames of a rig against poses computed by hand, and the checks of its values."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import transforms
from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform

RIG = StereoRig(640, 480, 500.0, 510.0, 319.5, 239.5, 0.12)


@pytest.mark.clause("3.2.3")
def test_left_camera_in_the_stereo_bench() -> None:
    # Optical z (forward) is x of SB, optical x (right) is -y, optical y (down) is -z; the left camera sits at
    # +baseline / 2 along y, as y runs from the right to the left centre [3.2.3].
    T_sb_left = RIG.T_sb_left
    np.testing.assert_array_equal(T_sb_left.translation, [0, 0.06, 0])
    np.testing.assert_array_equal(T_sb_left.apply([0, 0, 2]), [2, 0.06, 0])
    np.testing.assert_array_equal(T_sb_left.apply([1, 0, 0]), [0, 0.06 - 1, 0])
    np.testing.assert_array_equal(T_sb_left.apply([0, 1, 0]), [0, 0.06, -1])
    # The right camera, one baseline to the right of the left, sits at -baseline / 2.
    np.testing.assert_allclose(T_sb_left.apply([0.12, 0, 0]), [0, -0.06, 0], atol=1e-17)
    with pytest.raises(GeometryError, match="T_rb_locsb"):
        _ = RIG.T_rb_left


@pytest.mark.clause("3.2.3", "3.2.4")
@given(transforms, st.floats(0.05, 2.0))
def test_left_camera_in_the_rover(T_rb_sb: Transform, baseline_m: float) -> None:
    rig = replace(RIG, baseline_m=baseline_m, T_rb_sb=T_rb_sb)
    # Origin and forward direction from their definitions: half a baseline along y of SB, and x of SB.
    np.testing.assert_allclose(rig.T_rb_left.apply([0, 0, 0]), T_rb_sb.apply([0, baseline_m / 2, 0]), atol=1e-13)
    np.testing.assert_allclose(rig.T_rb_left.rotation @ [0, 0, 1], T_rb_sb.rotation @ [1, 0, 0], atol=1e-14)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": 0}, "image is 0 x 480"),
        ({"width": 20_000, "height": 20_000}, "at most 67108864 pixels in total"),
        ({"fx": 1e9}, "6.4 to 64000 px are required"),
        ({"cx": float("inf")}, "principal point"),
        ({"baseline_m": float("nan")}, "baseline is nan m"),
        ({"T_rb_sb": Transform(np.eye(3), np.array([0, 2e3, 0]))}, "in RB: at most 100 m is allowed"),
    ],
)
def test_rigs_that_cannot_be(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(GeometryError, match=words):
        replace(RIG, **changes)
