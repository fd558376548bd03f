"""Rigs through camera_info; what is not of a rectified pair is refused."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.made_worlds import START_NS
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.bag.messages import camera_info
from sfr_loc_map.io.calibration.projections import baseline_from_projection, check_centre, projection
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.suite_names import SIDES

focal = st.floats(10, 5000)
RIG = StereoRig(24, 16, 20.1, 20.3, 11.7, 7.9, 0.12)


@given(focal, focal, st.floats(0.0011, 4.9))
def test_rigs_of_files_come_through_messages_unchanged(fx: float, fy: float, baseline: float) -> None:
    rig = StereoRig(80, 60, fx, fy, 33.3, 22.2, baseline_from_projection(fx, -(fx * baseline)))
    assert abs(rig.baseline_m - baseline) <= 4e-16 * baseline
    infos = [camera_info(START_NS, rig, "loc", side) for side in SIDES]
    assert rig_of_infos(infos, "loc", raw=False)[0].same_cameras(rig)


def test_p_alone_describes_rectified_images() -> None:
    infos = [camera_info(START_NS, RIG, "loc", side) for side in SIDES]
    for info in infos:
        object.__setattr__(info, "d", np.array([-0.3, 0.1, 0.0, 0.0, 0.0]))
        object.__setattr__(info, "r", np.eye(3)[[1, 0, 2]])
        object.__setattr__(info, "k", 2 * RIG.camera_matrix)
    assert rig_of_infos(infos, "loc", raw=False)[0].same_cameras(RIG)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("p", np.zeros(12), "no projection"),
        ("p", np.full(12, np.nan), "is non-rectified"),
        ("p", projection(RIG, "right") * np.append(-1, np.ones(11)), "is non-rectified"),
        ("p", projection(RIG, "right") * np.tile([1, 1, 1, -1], 3), "swapped"),
        ("p", projection(RIG, "left"), "baseline"),
        ("width", 25, "24 x 16 and 25 x 16"),
    ],
)
def test_camera_info_that_is_not_of_a_rectified_pair(field: str, value: Any, words: str) -> None:
    left, right = (camera_info(START_NS, RIG, "loc", side) for side in SIDES)
    object.__setattr__(right, field, value)
    with pytest.raises(InputError, match=words):
        rig_of_infos((left, right), "loc", raw=False)


@pytest.mark.parametrize(
    ("ratios", "is_refused"),
    [
        ((0.5, 0.5), False),
        ((0.1, 0.5), False),
        ((0.25, 0.25), True),
        ((0.28, 0.2), True),
        ((0.28, 0.1), False),
        ((0.0, 0.0), True),
        ((-0.1, 0.2), True),
        ((0.1, 0.9), False),
        ((1.0, 1.0), True),
        ((0.71, 0.98), True),
    ],
)
def test_a_principal_point_of_another_image_size_is_refused_and_that_of_a_crop_is_not(
    ratios: tuple[float, float], is_refused: bool
) -> None:
    """Another size moves the point by one factor along both axes, for a lens whose point is near the centre."""
    size = (640, 480)
    cx, cy = (ratio * pixels for ratio, pixels in zip(ratios, size, strict=True))
    with pytest.raises(InputError, match="principal point") if is_refused else nullcontext():
        check_centre(cx, cy, size, "camera")
