"""EuRoC: cam0/sensor.yaml and cam1/sensor.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.io.calibration.opened_file import OpenedFile, parse_opencv_yaml
from sfr_loc_map.io.calibration.programs.shared import four_intrinsics, pinhole_lens, side_by_side, two_files
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, PosedCamera
from sfr_loc_map.json_yaml import converted


class _PoseMatrix(msgspec.Struct):
    data: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]

    @property
    def transform(self) -> Transform:
        return Transform.from_matrix(np.array(self.data).reshape(4, 4))


class SensorPose(msgspec.Struct):
    """The pose in the sensor.yaml of any EuRoC sensor."""

    T_BS: _PoseMatrix  #: Pose of the sensor in the body.


class _SensorYaml(SensorPose):
    resolution: tuple[int, int]
    camera_model: str
    intrinsics: tuple[float, ...]
    distortion_model: str
    distortion_coefficients: Annotated[tuple[float, ...], msgspec.Meta(max_length=8)] = (0.0,) * 4


def euroc_pair(files: Sequence[Path]) -> CameraPair:
    """Read the two sensor.yaml of EuRoC cameras."""
    cameras = [_euroc_camera(path) for path in files]
    return side_by_side("EuRoC", cameras, [f"'{path.parent.name}/{path.name}'" for path in files])


def _euroc_camera(path: Path) -> PosedCamera:
    with refusing(f"'{path}' is not a sensor.yaml of an EuRoC camera"):
        content = parse_opencv_yaml(read_text(path))
        camera = converted(content, _SensorYaml)
        d, lens = pinhole_lens("it", camera.camera_model, camera.distortion_model, camera.distortion_coefficients)
        return PosedCamera(camera.resolution, four_intrinsics(camera.intrinsics), d, camera.T_BS.transform, lens)


def read_euroc(opened: OpenedFile) -> CameraPair:
    """Read a sensor.yaml and that of the other camera."""
    return euroc_pair(two_files(opened, "cam0", "cam1"))
