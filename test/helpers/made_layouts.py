"""Small sequences in the layouts of other data sets, written after their published descriptions."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix

# Columns of P: fx = fy = 700, cx = 10, cy = 8, and -fx b with b = 0.54 m; camera 2 is 0.06 m left of camera 0.
KITTI_CALIB = """P0: 7.0e+02 0 1.0e+01 0 0 7.0e+02 8 0 0 0 1 0
P1: 7.0e+02 0 1.0e+01 -3.78e+02 0 7.0e+02 8 0 0 0 1 0
P2: 7.0e+02 0 1.0e+01 4.2e+01 0 7.0e+02 8 0 0 0 1 0
P3: 7.0e+02 0 1.0e+01 -3.36e+02 0 7.0e+02 8 0 0 0 1 0
"""
EUROC_STAMPS = (1403636579763555584, 1403636579813555456, 1403636579863555584)
EUROC_K, EUROC_D = np.array([[60.0, 0, 31.0], [0, 61.0, 24.5], [0, 0, 1]]), np.array([-0.28, 0.07, 0.0002, 1.8e-05])
EUROC_CAMERAS_M = {"cam0": np.array([0.05, -0.02, 0.5]), "cam1": np.array([0.16, -0.02, 0.5])}
"""Places of the cameras in B, whose z they look along."""
EUROC_ROTVEC = [0.1, 0.2, 0.3]
REST = ",".join(["0.0"] * 9)
"""Velocities and biases."""


def write_images(folder: Path, names: Iterable[str], shape: tuple[int, ...] = (48, 64), first: int = 0) -> None:
    """Write images of one grey value, 10 more for each."""
    folder.mkdir(parents=True)
    for n, name in enumerate(names):
        cv2.imwrite(str(folder / f"{name}.png"), np.full(shape, first + 10 * n, np.uint8))


def write_kitti(folder: Path, cameras: tuple[int, int] = (0, 1)) -> Path:
    for i, camera in enumerate(cameras):
        write_images(folder / f"image_{camera}", ("000000", "000001", "000002"), (16, 20), i)
    (folder / "calib.txt").write_text(KITTI_CALIB)
    (folder / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072911e-01\n")
    turn = matrix_from_rotvec([0, -0.5, 0])  # about y of the camera (down) by -0.5: a turn to the left
    poses = [np.eye(3, 4), np.c_[np.eye(3), [0.0, 0.0, 2.0]], np.c_[turn, [-1.0, -0.25, 4.0]]]
    (folder / "poses.txt").write_text("\n".join(" ".join(map(repr, p.reshape(-1).tolist())) for p in poses) + "\n")
    return folder


def write_euroc(folder: Path) -> Path:
    for camera, place in EUROC_CAMERAS_M.items():
        stamps = [stamp + (camera == "cam1" and i == 1) for i, stamp in enumerate(EUROC_STAMPS)]
        data = folder / "mav0" / camera / "data"
        write_images(data, map(str, stamps))
        pose = np.c_[np.eye(4, 3), [*place, 1.0]].reshape(-1).tolist()
        (data.parent / "sensor.yaml").write_text(
            f"%YAML:1.0\n# a comment\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {pose}\n"
            f"resolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [60.0, 61.0, 31.0, 24.5]\n"
            f"distortion_model: radial-tangential\ndistortion_coefficients: {EUROC_D.tolist()}\n"
        )
        rows = "".join(f"{stamp},{stamp}.png\r\n" for stamp in stamps)
        (data.parent / "data.csv").write_text(f"#timestamp [ns],filename\r\n{rows}")
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    x, y, z, w = quat_from_matrix(matrix_from_rotvec(EUROC_ROTVEC)).tolist()
    (truth / "data.csv").write_text(
        f"#timestamp, p_RS_R_x [m], ...\n1403636579763555585,1,2,3,{w!r},{x!r},{y!r},{z!r},{REST}\n"
        f"1403636579768555585,1,2,4,1,0,0,0,{REST}\n"
    )
    return folder
