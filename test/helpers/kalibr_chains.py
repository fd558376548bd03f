"""Camera chains of Kalibr: three fisheye lenses, and the three ways in which a chain states the poses."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.rotation import matrix_from_rotvec

LENSES = {
    "T265": ([282.0, 280.7, 416.0, 396.7], [-0.0033, 0.0541, -0.0516, 0.0107], (848, 800)),
    "TUM-VI": ([190.98, 190.97, 254.93, 256.9], [0.0034, 0.0007, -0.0021, 0.0002], (512, 512)),
    "UZH-FPV": ([276.48, 276.48, 313.04, 245.0], [-0.0128, -0.0117, 0.0202, -0.0109], (640, 480)),
}


def matrix(rotvec: list[float], translation: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix_from_rotvec(rotvec), translation
    return pose


def kalibr(lens: str, *poses: str) -> str:
    """Return the text of a camera chain of equal cameras, each with a line that states its pose."""
    intrinsics, coefficients, size = LENSES[lens]
    lines = []
    for number, pose in enumerate(poses):
        lines += [f"cam{number}:", "  camera_model: pinhole", "  distortion_model: equidistant"]
        lines += [f"  intrinsics: {intrinsics}", f"  distortion_coeffs: {coefficients}", f"  resolution: {list(size)}"]
        lines += [f"  {pose}"] if pose else []
    return "\n".join(lines) + "\n"


T_CAM1_CAM0 = matrix([0.01, -0.02, 0.005], [-0.12, 0.001, 0.002])
T_IMU_CAM0 = matrix([1.2, -1.1, 1.3], [0.05, 0.06, 0.01])
T_IMU_CAM1 = T_IMU_CAM0 @ np.linalg.inv(T_CAM1_CAM0)
CHAINS = {
    "T_cn_cnm1": ("", f"T_cn_cnm1: {T_CAM1_CAM0.tolist()}"),
    "T_imu_cam": (f"T_imu_cam: {T_IMU_CAM0.tolist()}", f"T_imu_cam: {T_IMU_CAM1.tolist()}"),
    "T_cam_imu": (
        f"T_cam_imu: {np.linalg.inv(T_IMU_CAM0).tolist()}",
        f"T_cam_imu: {np.linalg.inv(T_IMU_CAM1).tolist()}",
    ),
}
