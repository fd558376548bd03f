"""ROS: left.yaml and right.yaml of camera_calibration, or two camera_info printed by `ros2 topic echo`."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.calibration.opened_file import OpenedFile, named_values, numbers_of, size_of
from sfr_loc_map.io.calibration.programs.shared import two_files
from sfr_loc_map.io.calibration.rectification import RectifiableCamera
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair


def read_ros(opened: OpenedFile) -> CameraPair:
    """Read two files of camera_calibration, or two messages of camera_info as `ros2 topic echo` prints them."""
    cameras = []
    files = two_files(opened, "left", "right")
    for path in files:
        with refusing(f"calibration '{path}'"):
            cameras.append(_camera(path))
    left, right = cameras
    return CameraPair(left, right, "ROS " + " and ".join(f"'{path.name}'" for path in files))


def _camera(path: Path) -> RectifiableCamera:
    values = named_values(path)
    names = (("camera_matrix", "k"), ("rectification_matrix", "r"), ("projection_matrix", "p"))
    k, r, p = (numbers_of(values, *each) for each in names)
    model = str(values.get("distortionmodel", ""))
    d = numbers_of(values, "distortion_coefficients", "d")
    return RectifiableCamera(size_of(values), model, d, k, r, p).checked(f"'{path}'")
