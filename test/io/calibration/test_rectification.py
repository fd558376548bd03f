"""Rectification: points of the world appear where the rectified rig says, for each model; what cannot be is refused."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.made_worlds import blob, centre_of, seen_at
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.calibration.projections import projection
from sfr_loc_map.io.calibration.rectification import rig_of_infos

RIG = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
K = (140.0, 0.0, 101.0, 0.0, 141.0, 78.0, 0.0, 0.0, 1.0)
D = {
    "plumb_bob": (-0.2, 0.05, 0.001, -0.002, -0.01),
    "rational_polynomial": (0.3, 0.05, 0.0005, -0.0003, 0.002, 0.6, 0.14, 0.01),
    "equidistant": (-0.02, 0.004, -0.001, 0.0002),
}
ROTVEC = {"left": (0.01, -0.02, 0.015), "right": (-0.012, 0.01, -0.008)}


def info(side: Any, model: str = "plumb_bob", **changes: Any) -> SimpleNamespace:
    r = matrix_from_rotvec(ROTVEC[side]).reshape(-1)
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    fields = {"width": 200, "height": 160, "distortion_model": model, "d": D.get(model, ()), "k": K, "r": r}
    fields |= {"p": projection(RIG, side), "roi": roi, "binning_x": 0, "binning_y": 0}
    return SimpleNamespace(**fields | changes)


@pytest.mark.parametrize("model", D)
def test_a_point_is_where_the_rectified_rig_sees_it(model: str) -> None:
    rig, rectifier = rig_of_infos([info("left", model), info("right", model)], "loc", raw=True)
    assert rig.same_cameras(RIG)
    for point in ([0.2, -0.3, 1.4], [-0.5, 0.35, 1.6], [0.1, 0.1, 3.0]):
        raw, wanted = [], []
        for side, shift in (("left", 0.0), ("right", rig.baseline_m)):
            rectified = np.array(point) - [shift, 0.0, 0.0]
            ray = matrix_from_rotvec(ROTVEC[side]).T @ rectified
            raw.append(blob(seen_at(ray, model, D[model], K), (160, 200)))
            wanted.append(rectified[:2] / rectified[2] * 150.0 + [99.5, 79.5])
        for image, pixel in zip(rectifier.rectify(*raw), wanted, strict=True):
            assert np.abs(centre_of(image) - pixel).max() < 0.1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"distortion_model": "omni"}, "'omni': one of plumb_bob, rational_polynomial, equidistant, fisheye"),
        ({"d": (0.1, 0.2)}, "2 coefficients d: model plumb_bob requires 4 or 5"),
        ({"k": (0.0,) * 9}, "no k or p"),
        ({"p": (np.nan,) * 12}, "a non-finite number"),
        ({"r": (2.0, 0, 0, 0, 1, 0, 0, 0, 1)}, "r is not a rotation"),
        ({"r": (1.0, 0, 0, 0, -1, 0, 0, 0, 1)}, "r is not a rotation"),
        ({"binning_x": 2}, "binning or a region of interest"),
        ({"roi": SimpleNamespace(x_offset=8, y_offset=0, width=64, height=64)}, "region of interest"),
    ],
)
def test_what_cannot_be_rectified_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"^loc/left/camera_info[^\n]*{words}"):
        rig_of_infos([info("left", **changes), info("right")], "loc", raw=True)
