"""Small sequences in the layouts of rover data sets, made by their published descriptions."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.io import savemat

from sfr_loc_map.geometry.transform import Transform

MADMAX_STAMPS = (1544000000123456789, 1544000000223456789)
MADMAX_P = "[868.246, 0.0, 31.0, {shift}, 0.0, 868.246, 23.0, 0.0, 0.0, 0.0, 1.0, 0.0]"
MADMAX_T_IMU_B = Transform(np.eye(3), np.array([0.1, -0.2, 0.3]))
MADMAX_T_IMU_LEFT = Transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.5, 0.1, 0.2])
)
MADMAX_BASELINE_M = 0.09
KATWIJK_K = np.array([[80.0, 0.0, 33.0], [0.0, 81.0, 25.0], [0.0, 0.0, 1.0]])
KATWIJK_DISTORTION = np.array([-0.2, 0.05, 0.001, -0.0005])
KATWIJK_NAMES = ("2015_11_26_12_53_35_149", "2015_11_26_12_53_35_349")
LUSNAR_STAMPS = (1700000000100000000, 1700000000200000000)


def tf_text(T_a_b: Transform, *, inverse: bool) -> str:
    pose = T_a_b.inverse() if inverse else T_a_b
    numbers = ", ".join(map(repr, (*pose.translation.tolist(), *pose.quat_xyzw.tolist())))
    names = [f"position.{axis}" for axis in "xyz"] + [f"orientation.{axis}" for axis in "xyzw"]
    return f"#{', '.join(names)}\n{numbers}\n"


def write_madmax(folder: Path, *, inverse: bool = False) -> Path:
    """Write a run and, beside it, its calibration."""
    for i, side in enumerate(("left", "right")):
        (folder / f"img_rect_{side}").mkdir(parents=True)
        for n, stamp in enumerate(MADMAX_STAMPS):
            file = folder / f"img_rect_{side}" / f"img_rect_{side}_{stamp}.png"
            cv2.imwrite(str(file), np.full((48, 64), 10 * n + i, np.uint8))
    calibration = folder.parent / "calibration"
    calibration.mkdir(exist_ok=True)
    for side, shift in (("left", 0.0), ("right", -868.246 * MADMAX_BASELINE_M)):
        (calibration / f"camera_rect_{side}_info.txt").write_text(
            f'header: \n  seq: 0\n  frame_id: "camera_{side}"\nheight: 48\nwidth: 64\ndistortion_model: "plumb_bob"\n'
            "D: [0.0, 0.0, 0.0, 0.0, 0.0]\nK: [868.246, 0.0, 31.0, 0.0, 868.246, 23.0, 0.0, 0.0, 1.0]\n"
            f"R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\nP: {MADMAX_P.format(shift=shift)}\n---\n"
        )
    T_left_right = Transform(np.eye(3), np.array([MADMAX_BASELINE_M, 0.0, 0.0]))
    for name, pose in (
        ("tf__imu_to_B", MADMAX_T_IMU_B),
        ("tf__imu_to_camera_left", MADMAX_T_IMU_LEFT),
        ("tf__camera_left_to_camera_right", T_left_right),
    ):
        (calibration / f"{name}.csv").write_text(tf_text(pose, inverse=inverse))
    (folder / "ground_truth").mkdir()
    comments = "".join(f"% comment {n}\n" for n in range(13))
    (folder / "ground_truth" / "gt_6DoF_gnss_and_imu.csv").write_text(
        comments + "% UNIX time, x-enu(m), y-enu(m), z-enu(m), sdx, sdy, sdz, orientation.w, orientation.x, "
        "orientation.y, orientation.z\n1544000000.1200, 1.0, 2.0, 3.0, 0, 0, 0, 1.0, 0.0, 0.0, 0.0\n"
        "1544000000.2200, 1.5, 2.0, 3.0, 0, 0, 0, 0.0, 0.0, 0.0, 1.0\n"
    )
    return folder


def write_katwijk(folder: Path, *, compressed: bool = True, rotation: np.ndarray | None = None) -> Path:
    """Write a part of a traverse whose images are all 90."""
    (folder / "LocCam").mkdir(parents=True)
    for name in KATWIJK_NAMES:
        for side in (0, 1):
            cv2.imwrite(str(folder / "LocCam" / f"LocCam_{name}_{side}.png"), np.full((48, 64, 3), 90, np.uint8))
    k = KATWIJK_K.copy()
    k[:2, 2] += 1.0  # MATLAB's first pixel is 1, 1
    camera = {
        "IntrinsicMatrixInternal": k,
        "RadialDistortion": KATWIJK_DISTORTION[:2],
        "TangentialDistortion": KATWIJK_DISTORTION[2:],
    }
    parameters = {
        "CameraParameters1": camera,
        "CameraParameters2": camera,
        "RotationOfCamera2": np.eye(3) if rotation is None else rotation,
        "TranslationOfCamera2": [-120.0, 0.5, -0.3],
    }
    savemat(folder.parent / "LocCam_calibstruct.mat", {"stereoParams": parameters}, do_compression=compressed)
    return folder


def write_lusnar(folder: Path, *, described: bool = False) -> Path:
    """Write a scene; `described`: with the names of the data set's description."""
    left, right, truth = (
        ("image1/RGB", "image2/RGB", "Rover_pose.txt") if described else ("image0/color", "image1/color", "gt.txt")
    )
    for i, name in enumerate((left, right)):
        (folder / name).mkdir(parents=True)
        for n, stamp in enumerate(LUSNAR_STAMPS):
            image = np.full((1024, 1024, 4), 10 * n + i, np.uint8)
            image[..., 3] = 255
            cv2.imwrite(str(folder / name / f"{stamp}.png"), image)
    rest = ",".join(["0.0"] * 9)
    half = 0.5**0.5
    (folder / truth).write_text(
        f"#timestamp [ns],p_RS_R_x [m],...\n{LUSNAR_STAMPS[0]},0,0,0,1,0,0,0,{rest}\n"
        f"{LUSNAR_STAMPS[1]},1.0,2.0,-3.0,{half!r},0,0,{half!r},{rest}\n"
    )
    return folder
