"""Kalibr: camchain.yaml with cam0 and cam1, and T_cn_cnm1, T_cam_imu or T_imu_cam."""

from __future__ import annotations

import logging
import re

import msgspec
import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.opened_file import OpenedFile
from sfr_loc_map.io.calibration.programs.shared import four_intrinsics, pinhole_lens, side_by_side
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, PosedCamera
from sfr_loc_map.json_yaml import converted

_log = logging.getLogger(__name__)
SAME_POSE = 1e-3  #: Largest difference, m and rad, between two stated poses of the right camera that is not reported.


_Row = tuple[float, float, float, float]
_Matrix = tuple[_Row, _Row, _Row, _Row]


def _transform(rows: _Matrix) -> Transform:
    return Transform.from_matrix(np.array(rows, np.float64))


class _KalibrCamera(msgspec.Struct):
    camera_model: str
    intrinsics: tuple[float, ...]
    distortion_model: str
    distortion_coeffs: tuple[float, ...]
    resolution: tuple[int, int]
    T_cn_cnm1: _Matrix | None = None
    T_cam_imu: _Matrix | None = None
    T_imu_cam: _Matrix | None = None

    def calibrated(self, name: str, T_body_cam: Transform) -> PosedCamera:
        """Return the camera with its pose."""
        d, lens = pinhole_lens(name, self.camera_model, self.distortion_model, self.distortion_coeffs)
        return PosedCamera(self.resolution, four_intrinsics(self.intrinsics), d, T_body_cam, lens)

    def pose_in_imu(self) -> Transform | None:
        """Return the pose of the camera in the IMU; None if the file does not give it."""
        if self.T_imu_cam is not None:
            return _transform(self.T_imu_cam)
        return None if self.T_cam_imu is None else _transform(self.T_cam_imu).inverse()


def _pose_of_right(one: _KalibrCamera, other: _KalibrCamera, where: str) -> Transform:
    """Return the pose of cam1 in cam0 from T_cn_cnm1 of cam1, else from the poses of both cameras in the IMU.

    If both are given and differ, a warning that begins with `where` reports this.
    """
    in_imu = one.pose_in_imu()
    other_in_imu = other.pose_in_imu()
    by_imu = None if in_imu is None or other_in_imu is None else in_imu.inverse() @ other_in_imu
    if other.T_cn_cnm1 is None:
        if by_imu is None:
            raise ValueError("cam1 has no T_cn_cnm1, and cam0 and cam1 do not both have T_cam_imu or T_imu_cam")
        return by_imu
    pose = _transform(other.T_cn_cnm1).inverse()
    if by_imu is not None and np.abs(by_imu.matrix - pose.matrix).max() > SAME_POSE:
        baselines = " and ".join(f"{np.linalg.norm(each.translation):.4g}" for each in (pose, by_imu))
        _log.warning(
            f"{where}: T_cn_cnm1 of cam1 differs from the camera poses in the IMU frame (baselines of {baselines} m); "
            "T_cn_cnm1 is used"
        )
    return pose


def read_kalibr(opened: OpenedFile) -> CameraPair:
    """Read cam0 and cam1 of a chain; a warning reports further cameras."""
    content = opened.content
    where = f"calibration '{opened.file}'"
    if "cam1" not in content:
        names = ", ".join(name for name in opened.shown_names if name.startswith("cam"))
        raise ValueError(f"it has only {names}: cam0 and cam1 are required")
    one, other = (converted(content.get(name), _KalibrCamera, name) for name in ("cam0", "cam1"))
    if further := [name for name in opened.shown_names if re.fullmatch(r"cam(?:[2-9]|[1-9][0-9]+)", name)]:
        _log.warning(f"{where}: cam0 and cam1 are used, not {', '.join(further)}")
    poses = Transform.identity(), _pose_of_right(one, other, where)
    cameras = [one.calibrated("cam0", poses[0]), other.calibrated("cam1", poses[1])]
    return side_by_side(f"Kalibr '{opened.file.name}'", cameras, ["cam0", "cam1"])
