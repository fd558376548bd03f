"""Calibrations as other programs write them: one description of a pair, a rectification that keeps what both see."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from helpers.kalibr_chains import CHAINS, LENSES, T_CAM1_CAM0, T_IMU_CAM0, T_IMU_CAM1, kalibr, matrix
from helpers.made_worlds import START_NS, blob, centre_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag.messages import camera_info
from sfr_loc_map.io.calibration.calibration_file import read_calibration
from sfr_loc_map.io.calibration.projections import projection
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.tables.pose_columns import TrajectoryFormat
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.suite_names import SIDES


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("chain", CHAINS)
def test_a_fisheye_pair_keeps_its_scale_and_its_centre(tmp_path: Path, chain: str, lens: str) -> None:
    (tmp_path / "camchain.yaml").write_text(kalibr(lens, *CHAINS[chain]))
    found = read_calibration(tmp_path / "camchain.yaml")
    rig, rectifier = found.rig, found.rectifier
    assert rectifier is not None
    (fx, _, _, _), coefficients, (width, height) = LENSES[lens]
    assert rig.baseline_m == pytest.approx(np.linalg.norm(T_CAM1_CAM0[:3, 3]), rel=1e-9)
    assert 0.5 < rig.fx / fx < 2.0
    assert 0.25 * width < rig.cx < 0.75 * width
    images = rectifier.rectify(*(np.full((height, width), 255, np.uint8),) * 2)
    assert min(float((image > 0).mean()) for image in images) > 0.9
    point = np.array([0.2, -0.1, 1.5])  # in the left camera
    raw = []
    for T_cam_left in (np.eye(4), T_CAM1_CAM0):
        seen = (T_cam_left @ [*point, 1.0])[:3]
        k = np.array([[fx, 0, LENSES[lens][0][2]], [0, LENSES[lens][0][1], LENSES[lens][0][3]], [0, 0, 1.0]])
        pixel = cv2.fisheye.projectPoints(seen.reshape(1, 1, 3), np.zeros(3), np.zeros(3), k, np.array(coefficients))
        raw.append(blob(pixel[0].reshape(2), (height, width)))
    (left_u, left_v), (right_u, right_v) = (centre_of(image) for image in rectifier.rectify(*raw))
    assert right_v == pytest.approx(left_v, abs=0.1)
    depth = rig.fx * rig.baseline_m / (left_u - right_u)
    assert depth == pytest.approx(1.5, rel=0.03)


def test_a_rectification_that_shows_nothing_is_refused() -> None:
    rig = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
    infos = []
    for side in SIDES:
        p = projection(rig, side)
        p[[2, 6]] += [2000.0, 0.0]
        k = (150.0, 0.0, 99.5, 0.0, 150.0, 79.5, 0.0, 0.0, 1.0)
        fields = {"d": (-0.1, 0.01, 0.0, 0.0, 0.0), "k": k, "r": np.eye(3).reshape(-1), "p": p}
        roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
        rest = {"distortion_model": "plumb_bob", "roi": roi, "binning_x": 0, "binning_y": 0}
        infos.append(SimpleNamespace(width=200, height=160, **fields, **rest))
    with pytest.raises(InputError, match="the raw image covers 0 % of the rectified image"):
        rig_of_infos(infos, "loc", raw=True)


@pytest.mark.parametrize(("fx", "cx", "cy"), [(1.0, 0.0, 0.0), (1.0, 1e-3, 0.0), (1.02, 6.5, 0.0), (1.0, 0.0, 2.0)])
def test_rectified_cameras_that_differ_are_made_equal(fx: float, cx: float, cy: float) -> None:
    rig = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
    left, right = (camera_info(START_NS, rig, "loc", side) for side in SIDES)
    p = projection(rig, "right")
    p[[0, 3, 5]] *= fx
    p[[2, 6]] += [cx, cy]
    object.__setattr__(right, "p", p)
    found, rectifier = rig_of_infos((left, right), "loc", raw=False)
    assert found.same_cameras(rig)
    assert (rectifier is None) == (max(fx - 1.0, cx, cy) < 0.01)
    if rectifier is None:
        return
    x, y, z = 0.1, -0.05, 1.2
    seen = [blob(np.array([150.0 * x / z + 99.5, 150.0 * y / z + 79.5]), (160, 200))]
    seen.append(blob(np.array([p[0] * (x - 0.12) / z + p[2], p[5] * y / z + p[6]]), (160, 200)))
    (left_u, left_v), (right_u, right_v) = (centre_of(image) for image in rectifier.rectify(*seen))
    assert left_u - right_u == pytest.approx(150.0 * 0.12 / z, abs=0.1)
    assert right_v == pytest.approx(left_v, abs=0.1)


def test_raw_cameras_with_different_projections_are_rectified_to_that_of_the_left() -> None:
    rig = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
    left, right = (camera_info(START_NS, rig, "loc", side) for side in SIDES)
    p = projection(rig, "right")
    p[[0, 3, 5]] *= 1.02
    p[[2, 6]] += [6.5, 2.0]
    object.__setattr__(right, "p", p)
    found, rectifier = rig_of_infos((left, right), "loc", raw=True)
    assert found.same_cameras(rig)
    x, y, z = 0.1, -0.05, 1.2
    pixels = ([150.0 * (x - shift) / z + 99.5, 150.0 * y / z + 79.5] for shift in (0.0, 0.12))
    seen = rectifier.rectify(*(blob(np.array(pixel), (160, 200)) for pixel in pixels))
    (left_u, left_v), (right_u, right_v) = (centre_of(image) for image in seen)
    assert left_u - right_u == pytest.approx(150.0 * 0.12 / z, abs=0.1)
    assert right_v == pytest.approx(left_v, abs=0.1)
    object.__setattr__(right, "p", p + 1e-7)
    assert rig_of_infos((left, right), "loc", raw=True, before=rectifier)[1] is rectifier


@pytest.mark.parametrize("raw", [True, False])
def test_a_shift_in_the_left_projection_is_named(raw: bool) -> None:
    rig = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
    left, right = (camera_info(START_NS, rig, "loc", side) for side in SIDES)
    object.__setattr__(left, "p", projection(rig, "right"))
    with pytest.raises(InputError, match=r"P\[3\] of the left camera is -18, of the right camera -18"):
        rig_of_infos((left, right), "loc", raw=raw)


OPENCV = """%YAML:1.0
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data:[420., 0., 370., 0., 420., 240., 0., 0., 1.]
D1: !!opencv-matrix {rows: 1, cols: 5, dt: d, data: [-0.1, 0.01, 0., 0., 0.]}
M2: {rows: 3, cols: 3, dt: d, data: [421., 0., 372., 0., 421., 242., 0., 0., 1.]}
D2: {rows: 1, cols: 5, dt: d, data: [-0.1, 0.01, 0., 0., 0.]}
R: {rows: 3, cols: 3, dt: d, data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]}
T: {rows: 3, cols: 1, dt: d, data: [-0.11, 0., 0.]}
image_width:752
image_height:480
"""
SETTINGS = {
    "camera.bf": "Camera.fx: 435.2\nCamera.fy: 435.2\nCamera.cx: 367.4\nCamera.cy: 252.2\nCamera.bf: 47.872\n",
    "Stereo.b": 'Camera.type: "Rectified"\nCamera1.fx:435.2\nCamera1.fy: 435.2\nCamera1.cx: 367.4\n'
    "Camera1.cy: 252.2\nStereo.b: 0.11\n",
    "Stereo.T_c1_c2": 'Camera.type: "KannalaBrandt8"\n'
    + "".join(
        f"Camera{n}.{name}: {value}\n"
        for n in (1, 2)
        for name, value in zip(("fx", "fy", "cx", "cy", "k1"), (435.2, 435.2, 367.4, 252.2, 0.01), strict=True)
    )
    + "Stereo.T_c1_c2: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n"
    "  data: [1,0,0,0.11, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n",
    "Tlr": 'Camera.type: "KannalaBrandt8"\n'
    + "".join(
        f"Camera{n}.{name}: {value}\n"
        for n in ("", "2")
        for name, value in zip(("fx", "fy", "cx", "cy", "k1"), (435.2, 435.2, 367.4, 252.2, 0.01), strict=True)
    )
    + "Camera.bf: 19.3\nTlr: !!opencv-matrix\n  rows: 3\n  cols: 4\n  dt: f\n"
    "  data: [1,0,0,0.11, 0,1,0,0, 0,0,1,0]\n",
}
MONOCULAR = {
    "distorted": (SETTINGS["camera.bf"] + "Camera.k1: 0.26\n", "Camera has a distortion but there is no Camera2"),
    "fisheye": ('Camera.type: "KannalaBrandt8"\n' + SETTINGS["camera.bf"], "there is no Camera2"),
    "Kalibr": (kalibr("TUM-VI", ""), "it has only cam0: cam0 and cam1 are required"),
}


@pytest.mark.parametrize(
    "matrix",
    ["420., 0., 0., 0., 420., 0., 370., 240., 1.", "420., 3., 370., 0., 420., 240., 0., 0., 1."],
    ids=["column by column", "with skew"],
)
def test_a_camera_matrix_of_another_form_is_refused(tmp_path: Path, matrix: str) -> None:
    (tmp_path / "c.yaml").write_text(OPENCV.replace("420., 0., 370., 0., 420., 240., 0., 0., 1.", matrix))
    with pytest.raises(InputError, match="the camera matrix is 420"):
        read_calibration(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{OPENCV}xi1: 1.2\nxi2: 1.2\n", "has xi1, which belongs to cv::omnidir"),
        (f"%YAML:1.0\n{SETTINGS['Stereo.T_c1_c2']}Stereo.b: 0.2\n", "Stereo.b states a baseline of 0.2 m"),
        ("camera_name: left\nd: [0]\n---\ncamera_name: right\nd: [0]\n---\n", "2 different YAML documents"),
    ],
)
def test_values_that_contradict_what_is_read_are_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=words):
        read_calibration(tmp_path / "c.yaml", (752, 480))


@pytest.mark.parametrize("factor", [0.5, 1.5, 2.0])
def test_a_camera_matrix_of_another_image_size_is_refused(tmp_path: Path, factor: float) -> None:
    fx, cx, cy = 421.0 * factor, 372.0 * factor, 242.0 * factor
    of_right = "[421., 0., 372., 0., 421., 242., 0., 0., 1.]"
    assert of_right in OPENCV
    (tmp_path / "c.yaml").write_text(OPENCV.replace(of_right, f"[{fx}, 0., {cx}, 0., {fx}, {cy}, 0., 0., 1.]"))
    with pytest.raises(InputError, match="as of another image size"):
        read_calibration(tmp_path / "c.yaml")


@pytest.mark.parametrize("size", [(376, 240), (1504, 960)])
@pytest.mark.parametrize("name", ["OpenCV", "camera.bf"])
def test_a_stated_size_that_does_not_fit_the_principal_point_is_refused(
    tmp_path: Path, name: str, size: tuple[int, int]
) -> None:
    width, height = size
    text = {
        "OpenCV": OPENCV.replace("image_width:752", f"image_width: {width}").replace("height:480", f"height: {height}"),
        "camera.bf": f"{SETTINGS['camera.bf']}Camera.width: {width}\nCamera.height: {height}\n",
    }
    (tmp_path / "c.yaml").write_text(text[name])
    with pytest.raises(InputError, match=r"far from the centre|cannot be rectified"):
        read_calibration(tmp_path / "c.yaml", size)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(("raw", "scaled"), [(True, ("left", "right")), (True, ("left",)), (False, ("right",))])
def test_a_projection_of_another_image_size_is_refused(raw: bool, scaled: tuple[str, ...], factor: float) -> None:
    rig = StereoRig(200, 160, 150.0, 150.0, 99.5, 79.5, 0.12)
    infos = {side: camera_info(START_NS, rig, "loc", side) for side in SIDES}
    for side in scaled:
        p = projection(rig, side)
        p[[0, 2, 3, 5, 6]] *= factor
        object.__setattr__(infos[side], "p", p)
    with pytest.raises(InputError, match="as of another image size"):
        rig_of_infos(tuple(infos.values()), "loc", raw=raw)


@pytest.mark.parametrize("bf", [0.11, 47872.0])
def test_a_baseline_in_another_unit_is_refused(tmp_path: Path, bf: float) -> None:
    (tmp_path / "c.yaml").write_text(SETTINGS["camera.bf"].replace("47.872", str(bf)))
    with pytest.raises(InputError, match=r"baseline is .* m: .* m is required"):
        read_calibration(tmp_path / "c.yaml", (752, 480))


def test_a_factory_calibration_of_a_zed_camera_is_named(tmp_path: Path) -> None:
    (tmp_path / "SN1.conf").write_text("[LEFT_CAM_HD]\nfx=700\n[STEREO]\nBaseline=120\n")
    with pytest.raises(InputError, match="factory calibration of a ZED camera"):
        read_calibration(tmp_path / "SN1.conf")


@pytest.mark.parametrize("size", [(376, 240), (1504, 960)])
@pytest.mark.parametrize("name", ["OpenCV", "camera.bf", "Tlr"])
def test_a_calibration_without_a_size_is_refused_for_scaled_images(
    tmp_path: Path, name: str, size: tuple[int, int]
) -> None:
    text = OPENCV.partition("image_width")[0] if name == "OpenCV" else f"%YAML:1.0\n{SETTINGS[name]}"
    (tmp_path / "c.yaml").write_text(text)
    assert read_calibration(tmp_path / "c.yaml", (752, 480))
    with pytest.raises(InputError, match="scale the calibration"):
        read_calibration(tmp_path / "c.yaml", size)


@pytest.mark.parametrize("name", ["OpenCV", *SETTINGS])
def test_files_of_opencv_and_orb_slam_give_the_baseline(tmp_path: Path, name: str) -> None:
    text = OPENCV if name == "OpenCV" else f"%YAML:1.0\n{SETTINGS[name]}Camera.width: 752\nCamera.height: 480\n"
    (tmp_path / "c.yaml").write_text(text)
    left, right = read_calibration(tmp_path / "c.yaml").pair[:2]
    assert -right.p[3] / right.p[0] == pytest.approx(0.11, abs=1e-9)
    assert 0.5 < left.p[0] / 430.0 < 2.0


@pytest.mark.parametrize("size", [None, (752, 480)])
def test_the_size_of_settings_without_one_is_that_of_the_images(tmp_path: Path, size: tuple[int, int] | None) -> None:
    (tmp_path / "c.yaml").write_text(f"%YAML:1.0\n{SETTINGS['Tlr']}")
    if size is None:
        with pytest.raises(InputError, match=r"it has no Camera\.width"):
            read_calibration(tmp_path / "c.yaml")
    else:
        assert read_calibration(tmp_path / "c.yaml", size).pair.left.size[0] == size[0]


@pytest.mark.parametrize("name", MONOCULAR)
def test_a_calibration_of_one_raw_camera_is_none_of_a_stereo_pair(tmp_path: Path, name: str) -> None:
    text, words = MONOCULAR[name]
    (tmp_path / "c.yaml").write_text(f"%YAML:1.0\n{text}" if name != "Kalibr" else text)
    with pytest.raises(InputError, match=words):
        read_calibration(tmp_path / "c.yaml", (752, 480))


def euroc_sequence(path: Path, truth: str, lever: list[float]) -> Trajectory:
    """Write a sequence in EuRoC's layout whose truth is of a marker on a lever; return the poses of the marker."""
    intrinsics, coefficients, (width, height) = LENSES["TUM-VI"]
    for number, late_ns in ((0, 0), (1, 1000)):
        folder = path / "mav0" / f"cam{number}"
        (folder / "data").mkdir(parents=True)
        pose = T_IMU_CAM0 if number == 0 else T_IMU_CAM1
        (folder / "sensor.yaml").write_text(
            f"%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data:{pose.reshape(-1).tolist()}\n"
            f"resolution: [{width}, {height}]\ncamera_model: pinhole\nintrinsics: {intrinsics}\n"
            f"distortion_model: equidistant\ndistortion_coefficients: {coefficients}\n"
        )
        rows = ["#timestamp [ns],filename"]
        for stamp in (1000 + START_NS, START_NS + 10**8):
            (folder / "data" / f"{stamp}.png").write_bytes(encode_png(np.zeros((height, width), np.uint8)))
            rows.append(f"{stamp + late_ns},{stamp}.png")
        (folder / "data.csv").write_text("\n".join(rows) + "\n")
    stamps = START_NS + np.arange(5, dtype=np.int64) * 10**8
    turns = np.array([[0.0, 0.0, np.sin(angle), np.cos(angle)] for angle in 0.3 * np.arange(5)])
    poses = Trajectory(stamps, np.arange(15.0).reshape(5, 3), turns)
    (path / "mav0" / truth).mkdir()
    save_trajectory(path / "mav0" / truth / "data.csv", poses, TrajectoryFormat.EUROC)
    pose = matrix([0.0, 0.0, 0.0], lever)
    (path / "mav0" / truth / "sensor.yaml").write_text(f"T_BS:\n  data: {pose.reshape(-1).tolist()}\n")
    return poses


@pytest.mark.parametrize("truth", ["state_groundtruth_estimate0", "mocap0", "vicon0"])
def test_sequences_in_the_layout_of_euroc_by_others(tmp_path: Path, truth: str) -> None:
    lever = [0.5, 0.0, 0.0] if truth == "vicon0" else [0.0, 0.0, 0.0]
    poses = euroc_sequence(tmp_path, truth, lever)
    loc = open_source(tmp_path, SourceConfig()).loc
    assert loc is not None
    assert len(loc) == 2
    assert loc.ground_truth is not None
    moved = np.linalg.norm(loc.ground_truth.positions - poses.positions, axis=1)
    np.testing.assert_allclose(moved, lever[0], atol=1e-9)


@pytest.mark.parametrize("truth", ["state_groundtruth_estimate0", "mocap0", "vicon0", "leica0"])
def test_the_configuration_applies_to_each_truth_of_euroc(tmp_path: Path, truth: str) -> None:
    """The marker of `T_BS` keeps its place unless the configuration has one."""
    poses = euroc_sequence(tmp_path, truth, [0.5, 0.0, 0.0])

    def truth_by(**settings: Any) -> Truth:
        found = open_source(tmp_path, SourceConfig(truth=TruthConfig(**settings))).truth
        assert isinstance(found, Truth)
        return found

    has_marker = truth != "state_groundtruth_estimate0"
    late = truth_by(clock_offset_s=0.25)
    assert late.stamps_ns.tolist() == (poses.stamps_ns + 250_000_000).tolist()
    moved = np.linalg.norm(late.positions - poses.positions, axis=1)
    np.testing.assert_allclose(moved, 0.5 if has_marker else 0.0, atol=1e-9)
    assert not truth_by(unknown="height").has_height
    alone = truth_by(attitude="no")
    assert not alone.has_attitude
    assert alone.lever_arm_m == ((0.5, 0.0, 0.0) if has_marker else (0.0, 0.0, 0.0))
    assert truth_by(attitude="no", lever_arm_m=(0.0, 0.0, 2.0)).lever_arm_m == (0.0, 0.0, 2.0)


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("fault", ["double size", "region", "binning", "millimetres", "micrometres", "kilometres"])
def test_camera_info_of_other_images_or_units_is_refused(raw: bool, fault: str) -> None:
    size = 2.0 if fault == "double size" else 1.0
    unit = {"millimetres": 1e3, "micrometres": 1e6, "kilometres": 1e-3}.get(fault, 1.0)
    rig = StereoRig(160, 120, 100.0, 100.0, 79.5, 59.5, 0.12)
    infos = [camera_info(START_NS, rig, "loc", side) for side in SIDES]
    for info in infos:
        object.__setattr__(info, "k", info.k * np.where(info.k == 1.0, 1.0, size))
        object.__setattr__(
            info, "p", info.p * np.where(info.p == 1.0, 1.0, size) * np.where(np.arange(12) == 3, unit, 1)
        )
        if fault == "region":
            object.__setattr__(info, "roi", replace(info.roi, x_offset=40, y_offset=30))
        if fault == "binning":
            object.__setattr__(info, "binning_x", 2)
    with pytest.raises(InputError, match=r"principal point|region of interest|baseline"):
        rig_of_infos(infos, "loc", raw=raw)
