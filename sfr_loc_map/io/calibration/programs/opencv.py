"""OpenCV: FileStorage (YAML, XML, JSON) with M1 D1 M2 D2 R T, or R1 R2 P1 P2, in one file or two."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.calibration.opened_file import (
    HEIGHTS,
    WIDTHS,
    OpenedFile,
    are_equal,
    named_values,
    numbers_of,
    plain_name,
    size_of,
    stated_size,
)
from sfr_loc_map.io.calibration.programs.shared import lens_model
from sfr_loc_map.io.calibration.projections import check_centre
from sfr_loc_map.io.calibration.rectification import RectifiableCamera, check_camera_matrix
from sfr_loc_map.io.calibration.stereo_calibration import (
    CameraPair,
    PosedCamera,
    check_one_baseline,
    with_rectification,
)
from sfr_loc_map.message_text import alternatives, counted

_log = logging.getLogger(__name__)
MODEL_NAMES = ("model", "distortionmodel", "cameramodel", "lensmodel")
"""Plain names (`plain_name`) of the lens model."""
MATRICES = ("m", "k", "cameramatrix", "d", "distcoeffs", "distortioncoefficients", "r", "p", "t")
"""Plain names (`plain_name`) of the matrices, without the number of the camera."""
IMAGE_SIZES = ("imagesize", *map(plain_name, (*WIDTHS, *HEIGHTS)))
"""Plain names of the image size."""


def read_opencv(opened: OpenedFile) -> CameraPair:
    """Read M1, D1, M2, D2 with R1, P1, R2, P2, or else with R and T, from one file or two."""
    where = f"calibration '{opened.file}'"
    files = [opened.file, *([opened.other] if opened.other else [])]
    values = _values(files)
    text = "OpenCV " + " and ".join(f"'{file.name}'" for file in files)
    if omnidirectional := [name for name in ("xi", "xi1", "xi2") if name in values]:
        raise ValueError(
            f"it has {omnidirectional[0]}, which belongs to cv::omnidir: omnidirectional cameras are not supported; "
            "rectify the images, or calibrate with a pinhole or fisheye model"
        )
    ks = [numbers_of(values, f"M{n}", f"K{n}", f"cameraMatrix{n}") for n in (1, 2)]
    for k in ks:
        check_camera_matrix(k, where)
    size = size_of(values, opened.size)
    if stated_size(values) is None:
        check_centre(ks[0][2], ks[0][5], size, where)
    ds = [numbers_of(values, f"D{n}", f"distCoeffs{n}", f"distortion_coefficients_{n}") for n in (1, 2)]
    is_fisheye = _is_fisheye(values, ds, where)
    lenses = [_Lens(size, lens_model(d, is_fisheye), k, d) for k, d in zip(ks, ds, strict=True)]
    if values.keys() >= {"r1", "r2", "p1", "p2"}:
        return _rectified_pair(values, lenses, text)
    return _posed_pair(values, lenses, text)


class _Lens(NamedTuple):
    """A camera in an OpenCV file without its pose: size of the images, model, camera matrix and distortion."""

    size: tuple[int, int]
    model: str
    k: tuple[float, ...]
    d: tuple[float, ...]


def _rectified_pair(values: Mapping[str, Any], lenses: Sequence[_Lens], text: str) -> CameraPair:
    """Return the pair whose file has R and P of both cameras, as stereoRectify gives them."""
    left, right = (
        RectifiableCamera(size, model, d, k, numbers_of(values, f"R{n}"), numbers_of(values, f"P{n}")).checked(text)
        for n, (size, model, k, d) in enumerate(lenses, 1)
    )
    if "t" in values:
        of_p_m = (left.p[3] - right.p[3]) / right.p[0]
        check_one_baseline({"T": float(np.linalg.norm(numbers_of(values, "T"))), "P2": of_p_m})
    return CameraPair(left, right, text)


def _posed_pair(values: Mapping[str, Any], lenses: Sequence[_Lens], text: str) -> CameraPair:
    """Return the pair whose file has R and T between the cameras, as stereoCalibrate gives them."""
    rotation, translation = (np.array(numbers_of(values, name)) for name in ("R", "T"))
    for name, numbers, counts in (("R", rotation, (3, 9)), ("T", translation, (3,))):
        if len(numbers) not in counts:
            raise ValueError(
                f"{name} has {counted(len(numbers), 'number')}: {alternatives(map(str, counts))} are required"
            )
    matrix = matrix_from_rotvec(rotation) if len(rotation) == 3 else rotation.reshape(3, 3)
    T_right_left = Transform.from_matrix(np.c_[matrix, translation])
    left, right = (
        PosedCamera(size, (k[0], k[4], k[2], k[5]), d, pose, model)
        for (size, model, k, d), pose in zip(lenses, (Transform.identity(), T_right_left.inverse()), strict=True)
    )
    return CameraPair(*with_rectification(text, left, right), text)


def _values(files: Sequence[Path]) -> dict[str, Any]:
    """Return the values of one file or two by their plain names; ValueError if two files contradict each other."""
    values: dict[str, Any] = {}
    for file in files:
        with refusing(f"calibration '{file}'"):
            of_file = named_values(file)
        for name in sorted(values.keys() & of_file.keys()):
            if _is_read(name) and not are_equal(values[name], of_file[name]):
                raise ValueError(f"{name} differs between '{files[0]}' and '{file}': rename or remove one of the files")
        values |= of_file
    return values


def _is_read(name: str) -> bool:
    """Return whether the value with this plain name (`plain_name`) is read from OpenCV files.

    Two files of one calibration may differ in other values, such as dates.
    """
    is_matrix = name.rstrip("12") in MATRICES
    return is_matrix or name in (*MODEL_NAMES, *IMAGE_SIZES) or "fisheye" in name


def _is_fisheye(values: Mapping[str, Any], ds: Sequence[Sequence[float]], where: str) -> bool:
    """Return whether a flag (`fisheye: 1`) or a model in an OpenCV file states a fisheye lens.

    A warning reports coefficients `ds` of both cameras that may be those of either lens, if the file has neither.
    """
    stated = [value for name, value in values.items() if "fisheye" in name]
    flags = [not are_equal(value, 0) and not are_equal(value, "false") for value in stated]
    models = [str(values[name]).lower() for name in MODEL_NAMES if name in values]
    found = [*flags, *(True for model in models if re.search(r"fisheye|\bequi", model))]
    if not found and all(len(d) == 4 and any(d) for d in ds):
        _log.warning(
            f"{where}: 4 distortion coefficients are read as k1, k2, p1, p2: if they are those of cv::fisheye, add "
            "'fisheye: 1' to the file; if not, add 'fisheye: 0'"
        )
    return any(found)
