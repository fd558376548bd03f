"""Rectification: points of the world appear where the rectified rig says, for each model; what cannot be is refused."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_worlds import blob, centre_of

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.camera_info import projection
from sfr_loc_map.io.rectification import rectified_rig

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


def distorted(normalised: np.ndarray, model: str) -> np.ndarray:
    """Return the pixel of a ray by the formula of the model (OpenCV's documentation of its camera models)."""
    x, y = normalised
    d = D[model]
    r = np.hypot(x, y)
    if model == "equidistant":
        theta = np.arctan(r)
        scale = theta * (1 + d[0] * theta**2 + d[1] * theta**4 + d[2] * theta**6 + d[3] * theta**8) / r
        x, y = x * scale, y * scale
    else:
        k = (*d, *(0.0,) * (8 - len(d)))
        radial = (1 + k[0] * r**2 + k[1] * r**4 + k[4] * r**6) / (1 + k[5] * r**2 + k[6] * r**4 + k[7] * r**6)
        x, y = (
            x * radial + 2 * k[2] * x * y + k[3] * (r**2 + 2 * x**2),
            y * radial + k[2] * (r**2 + 2 * y**2) + 2 * k[3] * x * y,
        )
    return np.array([K[0] * x + K[2], K[4] * y + K[5]])


@pytest.mark.parametrize("model", D)
def test_a_point_is_where_the_rectified_rig_sees_it(model: str) -> None:
    rig, rectifier = rectified_rig([info("left", model), info("right", model)], "loc")
    assert rig.same_cameras(RIG)
    for point in ([0.2, -0.3, 1.4], [-0.5, 0.35, 1.6], [0.1, 0.1, 3.0]):
        raw, wanted = [], []
        for side, shift in (("left", 0.0), ("right", rig.baseline_m)):
            rectified = np.array(point) - [shift, 0.0, 0.0]
            ray = matrix_from_rotvec(ROTVEC[side]).T @ rectified
            raw.append(blob(distorted(ray[:2] / ray[2], model), (160, 200)))
            wanted.append(rectified[:2] / rectified[2] * 150.0 + [99.5, 79.5])
        for image, pixel in zip(rectifier.rectify(*raw), wanted, strict=True):
            assert np.abs(centre_of(image) - pixel).max() < 0.1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"distortion_model": "omni"}, "'omni': one of plumb_bob, rational_polynomial, equidistant, fisheye"),
        ({"d": (0.1, 0.2)}, "2 coefficients d: model plumb_bob needs 4 or 5"),
        ({"k": (0.0,) * 9}, "no k or p"),
        ({"p": (np.nan,) * 12}, "numbers that are not finite"),
        ({"r": (2.0, 0, 0, 0, 1, 0, 0, 0, 1)}, "r is not a rotation"),
        ({"binning_x": 2}, "binning or a region of interest"),
        ({"roi": SimpleNamespace(x_offset=8, y_offset=0, width=64, height=64)}, "region of interest"),
    ],
)
def test_what_cannot_be_rectified_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"^loc/left/camera_info[^\n]*{words}"):
        rectified_rig([info("left", **changes), info("right")], "loc")
