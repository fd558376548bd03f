"""COLMAP: cameras.txt and rig_config.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_text
from sfr_loc_map.io.calibration.opened_file import OpenedFile, content_of
from sfr_loc_map.io.calibration.programs.shared import lens_model, side_by_side
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, PosedCamera

ONE_FOCAL = {"SIMPLE_PINHOLE": 3, "SIMPLE_RADIAL": 4, "RADIAL": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5}
TWO_FOCALS = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}
"""Numbers of parameters of COLMAP's models (colmap.github.io, "Camera Models"), by the number of focal lengths.
Principal point and distortion in OpenCV's order follow the focal lengths."""


def read_colmap(opened: OpenedFile) -> CameraPair:
    """Read the cameras of a list of one camera, which both images have, or of two cameras, and their poses in a rig."""
    file, rig_file = opened.files
    of_rig = _cameras_of_rig(rig_file)
    rows = _rows_of(file)
    rows.sort(key=lambda row: int(row[0]))  # order by CAMERA_ID, because COLMAP writes cameras in any order
    if len(of_rig) != 2 or len(rows) not in (1, 2):
        raise ValueError(f"the first rig has {len(of_rig)} cameras and '{file.name}' has {len(rows)}: two are required")
    is_complete = all({"camera_model_name", "camera_params"} <= camera.keys() for camera in of_rig)
    if rows[0][1:] != rows[-1][1:] and not is_complete:
        raise ValueError(
            f"the cameras of '{file.name}' differ, and '{rig_file.name}' does not state which is the left camera: "
            f"give camera_model_name and camera_params of each camera in '{rig_file.name}'"
        )
    both = [*zip((rows[0], rows[-1]), of_rig, strict=True)]
    names = [str(camera.get("image_prefix", f"camera {row[0]}")) for row, camera in both]
    cameras = [_posed_camera(row, camera) for row, camera in both]
    return side_by_side(f"COLMAP '{file.parent.name}'", cameras, names)


def _posed_camera(row: Sequence[str], camera: Mapping[str, Any]) -> PosedCamera:
    """Return a camera from the words of its row in cameras.txt and from its entry in the rig, which has priority."""
    lens = str(camera.get("camera_model_name", row[1]))
    counts = ONE_FOCAL | TWO_FOCALS
    if lens not in counts:
        raise ValueError(f"camera model {lens} is not supported; supported are {', '.join(counts)}")
    fx, *rest = _numbers(camera.get("camera_params", row[4:]), f"the parameters of a {lens} camera", counts[lens])
    fy, cx, cy, *d = (fx, *rest) if lens in ONE_FOCAL else rest
    d += [0.0] * (4 - len(d))
    w, x, y, z = _numbers(camera.get("cam_from_rig_rotation", (1, 0, 0, 0)), "cam_from_rig_rotation", 4)
    position = _numbers(camera.get("cam_from_rig_translation", (0, 0, 0)), "cam_from_rig_translation", 3)
    T_cam_rig = Transform.from_quat(position, (x, y, z, w))
    intrinsics = (fx, fy, cx - 0.5, cy - 0.5)  # the centre of COLMAP's first pixel is (0.5, 0.5)
    size = int(row[2]), int(row[3])
    return PosedCamera(size, intrinsics, tuple(d), T_cam_rig.inverse(), lens_model(d, "FISHEYE" in lens))


def _cameras_of_rig(file: Path) -> list[dict[str, Any]]:
    """Return the cameras of the first rig in a file; raise ValueError if its form is not that of COLMAP."""
    content = content_of(file)
    rig = content[0] if isinstance(content, list) and content else None
    cameras = rig.get("cameras") if isinstance(rig, dict) else None
    if not isinstance(cameras, list) or not all(isinstance(camera, dict) for camera in cameras):
        raise ValueError(f"'{file.name}' has no list of rigs, each with a list of 'cameras': one rig is required")
    return cameras


def _rows_of(file: Path) -> list[list[str]]:
    """Return the words of each camera in a file; raise ValueError, which names the line, for an incomplete row."""
    rows: list[list[str]] = []
    for number, line in enumerate(read_text(file).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 5 or not all(words[column].isdecimal() for column in (0, 2, 3)):
            raise ValueError(
                f"'{file.name}' line {number} is '{line[:40]}': CAMERA_ID, MODEL, WIDTH, HEIGHT and PARAMS are required"
            )
        rows.append(words)
    return rows


def _numbers(values: object, name: str, count: int) -> list[float]:
    """Return `count` numbers; raise ValueError if the value is not a list of so many numbers."""
    try:
        numbers = [float(value) for value in values] if isinstance(values, list | tuple) else []
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count:
        raise ValueError(f"{name} is {values!r:.60}: {count} numbers are required")
    return numbers
