"""Layouts of MADMAX, Katwijk and LuSNAR with known answers; no file of the data sets themselves was at hand."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_rovers import (
    KATWIJK_DISTORTION,
    KATWIJK_K,
    LUSNAR_STAMPS,
    MADMAX_BASELINE_M,
    MADMAX_STAMPS,
    MADMAX_T_IMU_B,
    MADMAX_T_IMU_LEFT,
    write_katwijk,
    write_lusnar,
    write_madmax,
)
from scipy.io import savemat

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.rover_data_sets import _load_struct, load_cameras
from sfr_loc_map.io.sequence import LocSequence


def opened(path: Path, name: str) -> LocSequence:
    source = open_source(path)
    assert (source.format, source.nav, source.left_out) == (name, None, 0)
    return source.loc


@pytest.mark.parametrize("inverse", [False, True])
def test_madmax_has_the_known_answer_whichever_way_its_transforms_are_written(tmp_path: Path, inverse: bool) -> None:
    loc = opened(write_madmax(tmp_path / "A-0", inverse=inverse), "madmax")
    assert [(p.stamp_ns, p.left[0, 0], p.right[0, 0]) for p in loc.pairs()] == [
        (MADMAX_STAMPS[0], 0, 1),
        (MADMAX_STAMPS[1], 10, 11),
    ]
    assert (loc.rig.width, loc.rig.height, loc.rig.fx, loc.rig.cx, loc.rig.cy) == (64, 48, 868.246, 31, 23)
    assert loc.rig.baseline_m == pytest.approx(MADMAX_BASELINE_M, abs=1e-12)
    np.testing.assert_allclose(
        loc.rig.T_rb_left.matrix, (MADMAX_T_IMU_B.inverse() @ MADMAX_T_IMU_LEFT).matrix, atol=1e-12
    )
    truth = loc.ground_truth
    assert truth.stamps_ns.tolist() == [1544000000120000000, 1544000000220000000]
    assert truth.positions.tolist() == [[1, 2, 3], [1.5, 2, 3]]
    np.testing.assert_allclose(truth.pose(1).rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-15)


def test_madmax_as_other_archives_unpack_it(tmp_path: Path) -> None:
    run = write_madmax(tmp_path / "A-0")
    (run / "img_rect_left").rename(run / "rect_left")
    (run / "img_rect_right").rename(run / "rect_right")
    (run / "ground_truth").rename(run / "A-0_ground_truth")
    (tmp_path / "calibration").rename(run / "calibration")
    (run / "calibration" / "tf__imu_to_B.csv").unlink()
    loc = opened(run, "madmax")
    assert loc.ground_truth is not None
    assert loc.rig.T_rb_sb is None


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("calibration/camera_rect_left_info.txt", "P:", "Q:", "no camera_info with P"),
        ("calibration/camera_rect_left_info.txt", "P: [868.246", "P: [nan", "differ in more than"),
        ("calibration/camera_rect_right_info.txt", "-78", "78", "swapped"),
        ("calibration/tf__camera_left_to_camera_right.csv", "0.09", "0.9", "0.9 m apart along x, by P 0.09 m"),
        ("calibration/tf__imu_to_B.csv", "0.1", "x", "'x' is not a finite number"),
        ("A-0/ground_truth/gt_6DoF_gnss_and_imu.csv", "x-enu(m)", "lat", r"no column x-enu\(m\)"),
        ("A-0/ground_truth/gt_6DoF_gnss_and_imu.csv", "1544000000.22", "1543000000.22", "in order"),
        ("A-0/ground_truth/gt_6DoF_gnss_and_imu.csv", "0.0, 0.0, 0.0, 1.0", "0.0", "columns found"),
    ],
)
def test_broken_madmax(tmp_path: Path, name: str, old: str, new: str, words: str) -> None:
    run = write_madmax(tmp_path / "A-0")
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1) if name.endswith("csv") else text.replace(old, new))
    with pytest.raises(InputError, match=words):
        open_source(run)


def test_madmax_pairs_by_stamp_and_needs_its_calibration(tmp_path: Path) -> None:
    run = write_madmax(tmp_path / "A-0")
    left = run / "img_rect_left" / f"img_rect_left_{MADMAX_STAMPS[0]}.png"
    left.unlink()
    source = open_source(run)
    assert (len(source.loc), source.left_out) == (1, 1)
    (run / "img_rect_left" / "img_rect_left_1.5.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"is not whole nanoseconds.*; rename or remove it"):
        open_source(run)
    (run / "img_rect_left" / "img_rect_left_1.5.png").unlink()
    (tmp_path / "calibration" / "camera_rect_left_info.txt").unlink()
    with pytest.raises(InputError, match=r"has no calibration/camera_rect_left_info\.txt"):
        open_source(run)


@pytest.mark.parametrize("compressed", [True, False])
def test_katwijk_has_the_known_answer(tmp_path: Path, compressed: bool) -> None:
    """A point put where the distorted cameras see it must have one row in both images, and its distance."""
    rotation = matrix_from_rotvec([0.01, -0.02, 0.015])
    part = write_katwijk(tmp_path / "Traverse1" / "Part1", compressed=compressed, rotation=rotation)
    first = np.array([0.3, 0.2, 2.0])
    second = first @ rotation + [-0.12, 0.0005, -0.0003]  # as MATLAB writes it, for rows
    rows, columns = np.mgrid[:48, :64]
    for side, point in enumerate((first, second)):
        u, v = cv2.projectPoints(point, np.zeros(3), np.zeros(3), KATWIJK_K, KATWIJK_DISTORTION)[0].reshape(2)
        blob = np.round(250 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8.0)).astype(np.uint8)
        for path in (part / "LocCam").glob(f"*_{side}.png"):
            cv2.imwrite(str(path), cv2.merge([blob] * 3))
    loc = opened(part, "katwijk")
    assert loc.rig.baseline_m == pytest.approx(np.linalg.norm([0.12, 0.0005, 0.0003]), abs=1e-9)
    assert loc.ground_truth is None
    (pair, other) = loc.pairs()
    moment = datetime(2015, 11, 26, 12, 53, 35, tzinfo=UTC).timestamp()
    assert [pair.stamp_ns, other.stamp_ns] == [int(moment) * 10**9 + ms * 10**6 for ms in (149, 349)]
    centres = []
    for image in (pair.left, pair.right):
        weights = np.where(image > 20, image, 0).astype(float)
        centres.append([(weights * columns).sum() / weights.sum(), (weights * rows).sum() / weights.sum()])
    (u, v), (u_right, v_right) = centres
    assert v == pytest.approx(v_right, abs=0.1)
    depth = loc.rig.fx * loc.rig.baseline_m / (u - u_right)
    ray = np.array([(u - loc.rig.cx) / loc.rig.fx, (v - loc.rig.cy) / loc.rig.fy, 1.0])
    assert depth * np.linalg.norm(ray) == pytest.approx(np.linalg.norm(first), rel=0.05)


def test_matlab_counts_pixels_from_one_and_may_write_matrices_for_rows(tmp_path: Path) -> None:
    write_katwijk(tmp_path / "Part1")
    file = tmp_path / "LocCam_calibstruct.mat"
    np.testing.assert_array_equal(load_cameras(file, (64, 48))[0].k, KATWIJK_K)
    parameters = _load_struct(file)
    for number in (1, 2):
        camera = parameters[f"CameraParameters{number}"]
        camera["IntrinsicMatrix"] = camera.pop("IntrinsicMatrixInternal").T
    savemat(file, {"stereoParams": parameters})
    np.testing.assert_array_equal(load_cameras(file, (64, 48))[1].k, KATWIJK_K)


def test_broken_katwijk(tmp_path: Path) -> None:
    part = write_katwijk(tmp_path / "Traverse1" / "Part1")
    calibration = tmp_path / "Traverse1" / "LocCam_calibstruct.mat"
    whole = calibration.read_bytes()
    for data, words in (
        (b"MATLAB 5.0", "no header of a little-endian file"),
        (whole[: len(whole) // 2], "cut off"),
        (whole[:130], "no struct 'stereoParams'"),
    ):
        calibration.write_bytes(data)
        with pytest.raises(InputError, match=words):
            open_source(part)
    savemat(calibration, {"stereoParams": {"RotationOfCamera2": np.eye(2)}})
    with pytest.raises(InputError, match="'RotationOfCamera2' has the shape"):
        open_source(part)
    savemat(calibration, {"stereoParams": {"x": np.zeros(5_000_000)}}, do_compression=True)
    with pytest.raises(InputError, match="holds more than"):
        open_source(part)
    calibration.rename(calibration.with_name("LocCam_calibration.mat"))
    with pytest.raises(InputError, match=r"LocCam_calibration\.mat holds an object of MATLAB, save it again"):
        open_source(part)
    (part / "LocCam" / "LocCam_2015_11_26_12_53_35_5_0.png").write_bytes(b"")
    with pytest.raises(InputError, match="its name has another form"):
        open_source(part)


@pytest.mark.parametrize("described", [False, True])
def test_lusnar_has_the_known_answer(tmp_path: Path, described: bool) -> None:
    loc = opened(write_lusnar(tmp_path / "Moon_1", described=described), "lusnar")
    assert [(p.stamp_ns, p.left[5, 5], p.right[5, 5]) for p in loc.pairs()] == [
        (LUSNAR_STAMPS[0], 0, 1),
        (LUSNAR_STAMPS[1], 10, 11),
    ]
    assert (loc.rig.width, loc.rig.fx, loc.rig.cx, loc.rig.baseline_m) == (1024, 610.17784, 511.5, 0.31)
    np.testing.assert_allclose(loc.rig.T_rb_left.translation, [1.0, 0.155, 1.5], atol=1e-12)
    down = np.radians(20)  # the cameras look down
    np.testing.assert_allclose(loc.rig.T_rb_left.rotation @ [0, 0, 1], [np.cos(down), 0, -np.sin(down)], atol=1e-12)
    np.testing.assert_allclose(loc.rig.T_rb_left.rotation @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    truth = loc.ground_truth
    np.testing.assert_allclose(truth.pose(0).matrix, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(truth.positions[1], [1, -2, 3])  # three metres up, two to the right
    np.testing.assert_allclose(truth.pose(1).rotation @ [1, 0, 0], [0, -1, 0], atol=1e-15)  # turned to the right


def test_lusnar_of_another_size_and_without_a_right_image(tmp_path: Path) -> None:
    scene = write_lusnar(tmp_path / "Moon_1")
    (scene / "image1" / "color" / f"{LUSNAR_STAMPS[1]}.png").unlink()
    assert open_source(scene).left_out == 1
    cv2.imwrite(str(scene / "image0" / "color" / f"{LUSNAR_STAMPS[0]}.png"), np.zeros((16, 16), np.uint8))
    with pytest.raises(InputError, match="is 16 x 16: the published cameras of LuSNAR have 1024 x 1024"):
        open_source(scene)
    for file in (scene / "image0" / "color").iterdir():
        file.unlink()
    with pytest.raises(InputError, match="has no image"):
        open_source(scene)
