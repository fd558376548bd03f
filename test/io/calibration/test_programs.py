"""Wrong values in the files of each program are refused in words, without the terms of Python and its libraries."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.calibration.calibration_file import read_calibration

POSE = [1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
LENS = {"camera_model": "pinhole", "distortion_model": "radtan", "intrinsics": [400.0, 400.0, 320.0, 240.0]}
KALIBR_CAMERA = {**LENS, "distortion_coeffs": [0.0] * 4, "resolution": [640, 480]}
IN_CAM0 = [[1.0, 0.0, 0.0, -0.1], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
FILES: dict[str, dict[str, Any]] = {
    "camchain.yaml": {"cam0": KALIBR_CAMERA, "cam1": {**KALIBR_CAMERA, "T_cn_cnm1": IN_CAM0}},
    "cam1/sensor.yaml": {
        **LENS,
        "T_BS": {"data": POSE},
        "resolution": [640, 480],
        "distortion_coefficients": [0.0] * 4,
    },
    "orbslam.yaml": {
        **{f"Camera{n}.{name}": x for n in (1, 2) for name, x in {"fx": 400, "fy": 400, "cx": 320, "cy": 240}.items()},
        **{"Camera1.k1": 0.0, "Camera.width": 640, "Camera.height": 480, "Camera.type": "PinHole"},
        "Stereo.T_c1_c2": {"rows": 4, "cols": 4, "data": POSE},
    },
    "opencv.yaml": {
        **{"M1": [400, 0, 320, 0, 400, 240, 0, 0, 1], "M2": [400, 0, 320, 0, 400, 240, 0, 0, 1]},
        **{"D1": [0.0] * 5, "D2": [0.0] * 5, "R": [1, 0, 0, 0, 1, 0, 0, 0, 1], "T": [-0.1, 0, 0]},
        **{"image_width": 640, "image_height": 480, "fisheye": 0},
    },
}
WRONG = (None, 5, "x", [], {}, [1], [[1, 2], [3]], ["a"] * 16, {"data": "x"}, {"data": ["a"]}, -1, [1e300] * 4)
OF_PYTHON = re.compile(r"Expected|`|\$|float\(|reshape|NoneType|array|tuple|object|inhomogeneous|Traceback")


def names_in(content: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the names of the values, and those in the cameras of Kalibr."""
    cameras = [name for name in ("cam0", "cam1") if name in content]
    return [(name,) for name in content] + [(camera, name) for camera in cameras for name in content[camera]]


def write(file: Path, content: dict[str, Any]) -> Path:
    file.parent.mkdir(exist_ok=True)
    file.write_text(yaml.safe_dump(content))
    return file


def with_value(content: dict[str, Any], names: tuple[str, ...], value: object) -> dict[str, Any]:
    changed = place = copy.deepcopy(content)
    for name in names[:-1]:
        place = place[name]
    place[names[-1]] = value
    return changed


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_value_of_a_calibration_is_named_in_words(tmp_path: Path, name: str) -> None:
    content = FILES[name]
    at_origin = {"data": [*POSE[:3], 0.0, *POSE[4:]]}
    write(tmp_path / "cam0/sensor.yaml", {**FILES["cam1/sensor.yaml"], "T_BS": at_origin})
    assert read_calibration(write(tmp_path / name, content))
    for names in names_in(content):
        for value in WRONG:
            try:
                read_calibration(write(tmp_path / name, with_value(content, names, value)))
            except InputError as error:
                text = str(error).replace(str(tmp_path), "")
                assert not OF_PYTHON.search(text), (names, value, text)
                assert "\n" not in text


@pytest.mark.parametrize(("old", "new"), [("</R>", "</Q>"), ("</opencv_storage>", ""), ("<R>", "<R a=>")])
def test_xml_that_is_not_complete_is_named(tmp_path: Path, old: str, new: str) -> None:
    values = {name: value for name, value in FILES["opencv.yaml"].items() if isinstance(value, list)}
    items = "".join(f"<{name}><data>{' '.join(map(str, value))}</data></{name}>" for name, value in values.items())
    text = f"<opencv_storage>{items}<image_width>640</image_width><image_height>480</image_height></opencv_storage>"
    (tmp_path / "c.xml").write_text(text)
    assert read_calibration(tmp_path / "c.xml")
    (tmp_path / "c.xml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match="it is not complete XML: "):
        read_calibration(tmp_path / "c.xml")


@pytest.mark.parametrize(
    ("files", "is_stated"),
    [
        (("left_turn/cam0.yaml", "left_turn/cam1.yaml"), False),
        (("turn/cam0.yaml", "turn/cam1.yaml"), False),
        (("a/left.yaml", "a/right.yaml"), True),
        (("a/LeftCameraParams.yaml", "a/RightCameraParams.yaml"), True),
    ],
)
def test_only_the_names_of_the_cameras_state_which_is_left(
    tmp_path: Path, files: tuple[str, str], is_stated: bool
) -> None:
    for file, place_m in zip(files, (0.1, 0.0), strict=True):
        pose = {"data": [*POSE[:3], place_m, *POSE[4:]]}
        write(tmp_path / file, {**FILES["cam1/sensor.yaml"], "T_BS": pose})
    if is_stated:
        with pytest.raises(InputError, match="swapped"):
            read_calibration(tmp_path / files[0])
        return
    names = read_calibration(tmp_path / files[0]).pair.names
    assert names == (f"'{files[1]}'", f"'{files[0]}'")
