"""What the readers of several programs share: the left camera of a pair, the second file, and the lens model."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.calibration.opened_file import OpenedFile
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, PosedCamera, with_rectification
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.suite_names import SIDES

_log = logging.getLogger(__name__)
PINHOLE_MODELS = ("radtan", "radial-tangential", "plumb_bob", "equidistant", "equi", "none")
"""Distortion models of Kalibr and EuRoC."""


def side_by_side(name: str, cameras: list[PosedCamera], names: list[str]) -> CameraPair:
    """Return the pair of two cameras; their poses determine which of them is left, unless `names` state it.

    The name with more occurrences of the word `left`, in upper or lower case, is that of the left camera. Both names
    may contain the word in a common folder.
    """
    one, other = (each.lower().count(SIDES[0]) for each in names)
    if other > one:
        cameras, names = cameras[::-1], names[::-1]
    if one == other and (cameras[0].T_body_cam.inverse() @ cameras[1].T_body_cam).translation[0] < 0:
        cameras, names = cameras[::-1], names[::-1]
        _log.warning(
            f"{name}: {names[1]} is to the right of {names[0]}: the images of {names[0]} must be the left ones"
        )
    left, right = names
    return CameraPair(
        *with_rectification(name, *cameras),
        f"{name}, {left} and {right}",
        T_body_left=cameras[0].T_body_cam,
        names=(left, right),
    )


def two_files(opened: OpenedFile, one: str, other: str) -> list[Path]:
    """Return the files of the two cameras; raise InputError if there is only one file.

    The paths of the two files differ in one word.
    """
    if opened.other is None:
        names = f"{opened.file.parent.name}/{opened.file.name}".lower()
        advice = f"with {other} in place of {one} or {one} in place of {other}"
        if one not in names and other not in names:
            advice = f"and name the files by {one} and {other}"
        raise InputError(
            f"calibration '{opened.file}' has one camera:",
            f"add the file of the other camera at the same path, {advice}",
        )
    return opened.files


def lens_model(d: Sequence[float], is_fisheye: bool) -> str:
    """Return the name of the distortion model of coefficients, a key of `rectification.COEFFICIENTS`."""
    return "equidistant" if is_fisheye else "plumb_bob" if len(d) <= 5 else "rational_polynomial"


def pinhole_lens(
    name: str, camera_model: str, model: str, coefficients: Sequence[float]
) -> tuple[tuple[float, ...], str]:
    """Return coefficients and distortion model of a pinhole camera of Kalibr or EuRoC.

    Raises ValueError for other cameras.
    """
    if camera_model != "pinhole":
        raise ValueError(f"{name} has the camera_model '{camera_model[:40]}': pinhole is required")
    if model not in PINHOLE_MODELS:
        raise ValueError(f"{name} has the distortion_model '{model[:40]}': {alternatives(PINHOLE_MODELS)} is required")
    if model == "none" and any(coefficients):
        raise ValueError(f"{name} has the distortion_model none, but coefficients that are not 0: name the model")
    d = tuple(coefficients) or (0.0,) * 4
    return d, lens_model(d, model.startswith("equi"))


def four_intrinsics(intrinsics: Sequence[float]) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy; ValueError if there are not four numbers."""
    if len(intrinsics) != 4:
        raise ValueError(f"it has {len(intrinsics)} intrinsics: fx, fy, cx, cy are required")
    fx, fy, cx, cy = intrinsics
    return fx, fy, cx, cy
