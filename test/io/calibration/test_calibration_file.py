"""Calibrations of other programs: all formats of one pair give one rig that sees points where they are."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from campaigns.recordings.drive import Drive
from campaigns.recordings.rows import ROWS
from helpers.made_worlds import blob, centre_of, seen_at
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.calibration_file import read_calibration
from sfr_loc_map.io.calibration.projections import with_baseline
from sfr_loc_map.io.calibration.rectification import RectifiableCamera
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, StereoCalibration, calibrated

SIZE = (200, 160)
D = {
    "plumb_bob": ((-0.2, 0.05, 0.001, -0.002), (-0.18, 0.04, -0.001, 0.001)),
    "rational_polynomial": ((0.3, 0.05, 0.0005, -0.0003, 0.002, 0.6, 0.14, 0.01),) * 2,
    "equidistant": ((-0.02, 0.004, -0.001, 0.0002), (-0.015, 0.003, 0.001, 0.0001)),
}
COLMAP_NAMES = {"plumb_bob": "OPENCV", "rational_polynomial": "FULL_OPENCV", "equidistant": "OPENCV_FISHEYE"}


KS = (
    np.array([[140.0, 0.0, 101.0], [0.0, 141.0, 78.0], [0.0, 0.0, 1.0]]),
    np.array([[143.0, 0.0, 97.5], [0.0, 142.0, 81.25], [0.0, 0.0, 1.0]]),
)
APART = Transform(matrix_from_rotvec((0.02, -0.03, 0.015)), np.array([-0.12, 0.003, -0.002]))


@dataclass
class Pair:
    """Two cameras that are not alike, and turned towards one another."""

    model: str = "plumb_bob"
    T_right_left: Transform = APART

    @property
    def ds(self) -> list[np.ndarray]:
        return [np.array(d) for d in D[self.model]]

    def rectified(self) -> tuple[np.ndarray, ...]:
        """Return R1, R2, P1, P2."""
        fisheye = self.model == "equidistant"
        values = [value for camera in zip(KS, self.ds, strict=True) for value in camera]
        turn, move = self.T_right_left.rotation, self.T_right_left.translation
        make, black = (cv2.fisheye, {"balance": 0}) if fisheye else (cv2, {"alpha": 0})
        return make.stereoRectify(*values, SIZE, turn, move, flags=cv2.CALIB_ZERO_DISPARITY, **black)[:4]


def kalibr(folder: Path, pair: Pair) -> Path:
    cameras = {}
    for name, k, d in zip(("cam0", "cam1"), KS, pair.ds, strict=True):
        camera = {"camera_model": "pinhole", "intrinsics": [float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))]}
        model = "radtan" if pair.model == "plumb_bob" else pair.model
        cameras[name] = camera | {"distortion_model": model, "distortion_coeffs": d.tolist(), "resolution": [*SIZE]}
    cameras["cam1"]["T_cn_cnm1"] = pair.T_right_left.matrix.tolist()
    (folder / "camchain.yaml").write_text(yaml.safe_dump(cameras))
    return folder / "camchain.yaml"


def storage(file: Path, values: dict[str, Any]) -> Path:
    out = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        out.write(name, value)
    out.release()
    return file


def lenses(pair: Pair, names: str = "M{} D{}") -> dict[str, Any]:
    values = {"fisheye_model": int(pair.model == "equidistant")}
    for n in (1, 2):
        of_k, of_d = (name.format(n) for name in names.split())
        values |= {of_k: KS[n - 1], of_d: pair.ds[n - 1].reshape(1, -1)}
    return values


def apart(pair: Pair) -> dict[str, Any]:
    return {"R": pair.T_right_left.rotation, "T": pair.T_right_left.translation.reshape(3, 1)}


def opencv(ending: str) -> Callable[[Path, Pair], Path]:
    names = {"yml": "M{} D{}", "xml": "K{} D{}", "json": "cameraMatrix{} distCoeffs{}"}[ending]
    return lambda folder, pair: storage(folder / f"stereo.{ending}", lenses(pair, names) | apart(pair))


def opencv_in_two_files(folder: Path, pair: Pair) -> Path:
    storage(folder / "extrinsics.yml", apart(pair))
    storage(folder / "intrinsics.yml", lenses(pair) | {"image_width": SIZE[0], "image_height": SIZE[1]})
    return folder


def opencv_rectified(folder: Path, pair: Pair) -> Path:
    values = dict(zip(("R1", "R2", "P1", "P2"), pair.rectified(), strict=True))
    return storage(folder / "stereo.yml", lenses(pair) | values)


def ros(folder: Path, pair: Pair) -> Path:
    r_and_p = pair.rectified()
    for n, side in enumerate(("left", "right")):
        matrices = {"camera_matrix": KS[n], "distortion_coefficients": pair.ds[n]}
        matrices |= {"rectification_matrix": r_and_p[n], "projection_matrix": r_and_p[2 + n]}
        content = {"image_width": SIZE[0], "image_height": SIZE[1], "distortion_model": pair.model}
        content |= {name: {"data": np.ravel(m).tolist()} for name, m in matrices.items()}
        (folder / side).mkdir()
        (folder / side / "ost.yaml").write_text(yaml.safe_dump(content))
    return folder / "right" / "ost.yaml"


def camera_info(folder: Path, pair: Pair) -> Path:
    """Write two messages of each camera as `ros2 topic echo` prints them."""
    r_and_p = pair.rectified()
    for n, side in enumerate(("left", "right")):
        matrices = {"d": pair.ds[n], "k": KS[n], "r": r_and_p[n], "p": r_and_p[2 + n]}
        content = {"height": SIZE[1], "width": SIZE[0], "distortion_model": pair.model}
        content |= {name: np.ravel(matrix).tolist() for name, matrix in matrices.items()}
        messages = ({"header": {"stamp": {"sec": sec}}, **content} for sec in (5, 6))
        (folder / f"info_{side}.yaml").write_text("".join(yaml.safe_dump(each) + "---\n" for each in messages))
    return folder / "info_left.yaml"


def colmap(folder: Path, pair: Pair) -> Path:
    """The right camera comes first, the rig is neither of them, and the list of cameras is not sorted."""
    T_left_rig = Transform(matrix_from_rotvec((0.3, 0.2, -0.1)), np.array([0.5, 0.0, 0.1]))
    rows, cameras = [], []
    for n, pose in ((2, pair.T_right_left @ T_left_rig), (1, T_left_rig)):
        k, d = KS[n - 1], pair.ds[n - 1]
        numbers = [k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5, *d]
        rows.append(
            f"{len(rows) + 1} {COLMAP_NAMES[pair.model]} {SIZE[0]} {SIZE[1]} {' '.join(map(repr, map(float, numbers)))}"
        )
        x, y, z, w = quat_from_matrix(pose.rotation).tolist()
        cameras.append({"image_prefix": f"camera{n}/", "cam_from_rig_rotation": [w, x, y, z]})
        cameras[-1]["cam_from_rig_translation"] = pose.translation.tolist()
        cameras[-1] |= {"camera_model_name": COLMAP_NAMES[pair.model], "camera_params": list(map(float, numbers))}
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(rows[::-1]) + "\n")
    (folder / "rig_config.json").write_text(json.dumps([{"cameras": cameras}]))
    return folder


FORMATS = {
    **{"kalibr": kalibr, "ros": ros, "colmap": colmap, "opencv_in_two_files": opencv_in_two_files},
    **{f"opencv_{ending}": opencv(ending) for ending in ("yml", "xml", "json")},
    "opencv_rectified": opencv_rectified,
    "camera_info": camera_info,
}


@pytest.mark.parametrize("model", D)
def test_all_formats_of_one_pair_see_a_point_where_it_is(model: str, tmp_path: Path) -> None:
    pair, point, rigs = Pair(model), np.array([0.25, -0.3, 1.3]), {}
    raw = [
        blob(seen_at(ray, model, d, k.reshape(-1)), SIZE[::-1])
        for ray, d, k in zip((point, pair.T_right_left.apply(point)), pair.ds, KS, strict=True)
    ]
    for name, write in FORMATS.items():
        if name == "kalibr" and model == "rational_polynomial":
            continue  # Kalibr has no such lens
        (tmp_path / name).mkdir()
        found = read_calibration(write(tmp_path / name, pair), SIZE)
        rig, rectifier = found.rig, found.rectifier
        assert rectifier is not None
        assert rig.T_rb_sb is None
        assert rig.baseline_m == pytest.approx(np.linalg.norm(pair.T_right_left.translation), abs=1e-6)
        rigs[name] = np.hstack([value for info in found.pair[:2] for value in (info.k, info.d, info.r, info.p)])
        assert np.abs(rigs[name] - next(iter(rigs.values()))).max() < 1e-6
        (u, v), (u_right, v_right) = map(centre_of, rectifier.rectify(*raw))
        assert abs(v - v_right) < 0.1
        depth = rig.fx * rig.baseline_m / (u - u_right)
        seen = depth * np.array([(u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, 1.0])
        wanted = np.reshape(found.pair.left.r, (3, 3)) @ point
        assert np.abs(seen - wanted).max() < 0.02, name


@pytest.mark.parametrize("name", ["kalibr_yaml", "ros_yaml", "opencv_yaml", "colmap", "rig_json"])
def test_what_the_recordings_have_beside_them_is_their_rig(name: str, tmp_path: Path) -> None:
    rig = StereoRig(64, 48, 60.0, 60.5, 30.5, 24.0, 0.12, Transform.from_quat((0.5, 0.1, 0.6), (0.0, 0.0, 0.6, 0.8)))
    still, black = np.zeros((1, 3)), np.zeros((48, 64), np.uint8)
    made = ROWS[name].make(tmp_path, Drive(rig, [(black, black)], still, np.array([[0.0, 0, 0, 1]]), rig, []))
    assert made.calibration is not None
    found = read_calibration(made.calibration, (64, 48))
    is_exact = name in ("colmap", "rig_json")
    assert (found.rectifier is None) == is_exact
    read = found.rig
    assert (read.T_rb_sb is not None) == (name == "rig_json")
    assert read.baseline_m == pytest.approx(0.12, abs=1e-9)
    if name not in ("kalibr_yaml", "opencv_yaml"):  # whose rectified images are cut so that no rim is black
        assert [*read.camera] == pytest.approx([*rig.camera], abs=1e-9)


def moved(*metres: float) -> Pair:
    return Pair(T_right_left=Transform(np.eye(3), np.array(metres)))


def colmap_rig_edited(old: str, new: str) -> Callable[[Path], Path]:
    """Return what writes a calibration of COLMAP, in the rig of which a text is replaced."""

    def make(folder: Path) -> Path:
        rig = colmap(folder, Pair()) / "rig_config.json"
        rig.write_text(rig.read_text().replace(old, new))
        return folder

    return make


def edited(write: Callable[[Path, Pair], Path], *changes: tuple[str, str]) -> Callable[[Path], Path]:
    """Return what writes a calibration, in the first file of which texts are replaced."""

    def make(folder: Path) -> Path:
        place = write(folder, Pair())
        file = place if place.is_file() else min(folder.glob("*.*"))
        text = file.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        file.write_text(text)
        return place

    return make


def text_file(text: str, name: str = "calibration.yaml") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_text(text)
        return folder / name

    return make


def without(name: str, write: Callable[[Path, Pair], Path]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        place = write(folder, Pair())
        (folder / name).unlink()
        return place

    return make


def a_list_as(name: str, write: Callable[[Path, Pair], Path]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        place = write(folder, Pair())
        (folder / name).write_text("[1, 2]\n")
        return place

    return make


def two_baselines(folder: Path) -> Path:
    """Write a calibration of OpenCV in which T is not the baseline in P2."""
    k, p = "[150, 0, 100, 0, 150, 80, 0, 0, 1]", "[150, 0, 100, {}, 0, 150, 80, 0, 0, 0, 1, 0]"
    eye = "[1, 0, 0, 0, 1, 0, 0, 0, 1]"
    lines = [f"M{n}: {k}\nD{n}: [0, 0, 0, 0, 0]\nR{n}: {eye}\n" for n in (1, 2)]
    lines += [f"P1: {p.format(0)}\nP2: {p.format(-18)}\nR: {eye}\nT: [-0.24, 0, 0]\n"]
    return text_file("".join(lines))(folder)


ORB_SLAM = "Camera.fx: 150\nCamera.fy: 150\nCamera.cx: 100\nCamera.cy: 80\nCamera.bf: 18\n"


def opencv_in_two_contradictory_files(changed: str, named: str) -> Callable[[Path], Path]:
    """Return what writes two complete calibrations of OpenCV, as intrinsics.yml and extrinsics.yml; `named` is read."""

    def make(folder: Path) -> Path:
        pair = Pair()
        values = {**lenses(pair), **apart(pair), "calibration_time": "Monday"}
        storage(folder / "intrinsics.yml", values)
        storage(folder / "extrinsics.yml", values | {changed: 2.0 * values[changed], "calibration_time": "Tuesday"})
        return folder / named

    return make


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "one camera of Kalibr": (edited(kalibr, ("cam1:", "imu0:")), "it has only cam0"),
    "an unknown lens of Kalibr": (
        edited(kalibr, ("pinhole", "omni")),
        "cam0 has the camera_model 'omni': pinhole is required",
    ),
    "an unknown distortion of Kalibr": (edited(kalibr, ("radtan", "fov")), "has the distortion_model 'fov': radtan, "),
    "a distortion of no model": (edited(kalibr, ("radtan", "none")), "the distortion_model none, but coefficients"),
    "five coefficients of a fisheye lens": (
        edited(
            lambda folder, _: kalibr(folder, Pair("equidistant")),
            ("distortion_coeffs:\n", "distortion_coeffs:\n  - 0\n"),
        ),
        "model equidistant requires 4",
    ),
    "cameras at one position": (lambda folder: kalibr(folder, moved(0.0, 0, 0)), "the right camera is at (0, "),
    "fewer numbers than rows and columns": (
        edited(opencv("yml"), ("cols: 3", "cols: 4")),
        "9 numbers for 3 rows and 4 columns",
    ),
    "a table": (text_file("[left]\nfx=400\n"), "it is not YAML, JSON or XML"),
    "a last row of a matrix that is none": (
        edited(kalibr, ("- 0.0\n    - 1.0\n", "- 0.0\n    - 2.0\n")),
        "the last row of a matrix is [0.0, 0.0, 0.0, 2.0]",
    ),
    "a matrix without numbers": (edited(opencv("yml"), ("data:", "numbers:")), "has no data"),
    "one name twice, in upper and lower case": (
        edited(opencv("yml"), ("M1:", "m1: 5\nM1:")),
        "it has two values of M1",
    ),
    "a size that is not whole": (
        text_file(ORB_SLAM + "Camera.width: 200.5\nCamera.height: 160\n"),
        "the image size is 200.5 x 160",
    ),
    "two baselines of ORB-SLAM": (
        text_file(ORB_SLAM + "Stereo.b: 0.2\nCamera.width: 200\nCamera.height: 160\n"),
        "Stereo.b states a baseline of 0.2 m, but Camera.bf states 0.12 m",
    ),
    "two baselines of OpenCV": (two_baselines, "T states a baseline of 0.24"),
    "no extrinsics": (edited(kalibr, ("T_cn_cnm1", "T_cam_imu")), "cam1 has no T_cn_cnm1"),
    "a rotation that is none": (edited(opencv("yml"), ("R: !!opencv", "R0: !!opencv")), "it has no R"),
    "millimetres": (
        lambda folder: kalibr(folder, moved(-60.0, 0, 0)),
        "the baseline is 60 m: 0.001 to 5 m is required",
    ),
    "many millimetres": (lambda folder: kalibr(folder, moved(-120.0, 0, 0)), "120"),
    "swapped sides": (lambda folder: opencv("xml")(folder, moved(0.12, 0, 0)), "swapped, or"),
    "one above the other": (lambda folder: kalibr(folder, moved(0, -0.12, 0)), "one above the other"),
    "images of another size": (edited(kalibr, ("200", "640"), ("160", "480")), "differ in size, 200 x 160 and 640"),
    "no principal point of ORB-SLAM": (
        text_file("Camera.fx: 5\nCamera.fy: 5\nCamera.cx: 5\nCamera.bf: 1\nCamera.width: 10\nCamera.height: 10\n"),
        "it has no Camera.cy",
    ),
    "another file of ROS that is a list": (
        a_list_as("left/ost.yaml", ros),
        "left/ost.yaml': the file has no mapping of names to values",
    ),
    "another file of OpenCV that is a list": (
        a_list_as("intrinsics.yml", opencv_in_two_files),
        "intrinsics.yml': the file has no mapping of names to values",
    ),
    "one camera of ROS": (
        without("left/ost.yaml", ros),
        "add the file of the other camera at the same path, with right in place of left",
    ),
    "no size of ROS": (without("cameras.txt", colmap), "(cam0, cam1), EuRoC, ORB-SLAM, OpenCV (M1"),
    "an unknown lens of COLMAP": (
        colmap_rig_edited("OPENCV", "FOV"),
        "camera model FOV is not supported; supported are SIMPLE_PINHOLE",
    ),
    "a rig of COLMAP that is not a list": (
        colmap_rig_edited("cameras", "lenses"),
        "'rig_config.json' has no list of rigs, each with a list of 'cameras'",
    ),
    "a short row of COLMAP": (edited(colmap, ("200 160", "200")), "'cameras.txt' line"),
    "a translation that is a text": (edited(opencv("yml"), ("T: !!opencv", "T: far\nT0: !!opencv")), "T is "),
    "a focal length in a list": (text_file(ORB_SLAM.replace("Camera.fx: 150", "Camera.fx: [1]")), "Camera.fx is [1]"),
    "no baseline": (
        text_file(ORB_SLAM.replace("bf: 18", "bf: 0") + "Camera.width: 200\nCamera.height: 160\n"),
        "Camera.bf is 0: a positive baseline is required",
    ),
    "different cameras of COLMAP without a name": (
        colmap_rig_edited("camera_params", "params"),
        "the cameras of 'cameras.txt' differ",
    ),
    "a foreign file": (text_file("a: 1\nb: 2\n"), "the file has a, b; a file of"),
    "a second complete calibration of OpenCV": (
        opencv_in_two_contradictory_files("M1", "intrinsics.yml"),
        "m1 differs between",
    ),
    "another baseline of OpenCV": (opencv_in_two_contradictory_files("T", "extrinsics.yml"), "t differs between"),
    "a matrix with two names": (
        edited(opencv("yml"), ("M1: !!opencv", "K1: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nM1: !!opencv")),
        "M1 and K1 differ",
    ),
    "a matrix of XML twice": (edited(opencv("xml"), ("<K1 ", "<K1>1 0 0 0 1 0 0 0 1</K1>\n<K1 ")), "it has 'K1' twice"),
    "the numbers of a matrix of XML twice": (
        edited(opencv("xml"), ("</data></K1>", "</data><data>1</data></K1>")),
        "it has 'data' twice",
    ),
    "no file": (lambda folder: folder / "left.yaml", "No such file or directory"),
    "an empty folder": (lambda folder: folder, "the folder has no calibration file; give the path"),
    "an empty file": (text_file(""), "the file has no known structure"),
    "no text": (lambda folder: storage(folder / "a.yml.gz", lenses(Pair())), "it is compressed by gzip"),
    "XML with entities": (text_file('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "a.xml"), "XML with a DOCTYPE"),
    "half an XML": (text_file("<?xml version='1.0'?><opencv_storage><M1>", "a.xml"), "no element found"),
    "another rig.json": (text_file('{"baseline_m": 0.1, "fx": 3}', "rig.json"), "rig.json"),
}


@pytest.mark.parametrize(
    ("left", "right"),
    [((1000.0, 0.0), (1000.0, 0.0)), ((1000.0, -100.0), (1000.0, -220.0)), ((1000.0, -100.0), (900.0, -198.0))],
)
def test_a_baseline_is_the_distance_of_the_cameras_also_if_a_third_camera_is_the_reference(
    left: tuple[float, float], right: tuple[float, float]
) -> None:
    p_left, p_right = (
        np.array((fx, 0.0, 99.0, shift, 0.0, fx, 79.0, 0.0, 0.0, 0.0, 1.0, 0.0)) for fx, shift in (left, right)
    )
    cameras = [RectifiableCamera.of_rectified(SIZE, p) for p in (p_left, with_baseline(p_left, p_right, 0.12, "P"))]
    found = calibrated(CameraPair(*cameras, "P"), "P")
    assert found.rig.baseline_m == pytest.approx(0.12, abs=1e-12)
    if any((left[1], right[1])):
        with pytest.raises(InputError, match=r"states 0\.12 m"):
            with_baseline(p_left, p_right, 0.22, "P")


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_calibration_of_a_pair_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    make, words = REFUSED[what]
    with pytest.raises(InputError) as caught:
        read_calibration(make(tmp_path), SIZE)
    assert words in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def chain_of_eleven(folder: Path) -> Path:
    file = kalibr(folder, Pair())
    cameras = yaml.safe_load(file.read_text())
    cameras |= {f"cam{number}": cameras["cam1"] for number in range(2, 11)}
    file.write_text(yaml.safe_dump(cameras))
    return file


def contradictory_poses(folder: Path) -> Path:
    file = kalibr(folder, Pair())
    cameras = yaml.safe_load(file.read_text())
    twice_as_far = np.array(cameras["cam1"]["T_cn_cnm1"]) * np.array([1.0, 1.0, 1.0, 2.0])
    twice_as_far[3, 3] = 1.0
    cameras["cam0"]["T_cam_imu"] = np.eye(4).tolist()
    cameras["cam1"]["T_cam_imu"] = twice_as_far.tolist()
    file.write_text(yaml.safe_dump(cameras))
    return file


REPORTED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "further cameras": (chain_of_eleven, "cam0 and cam1 are used, not cam10, cam2"),
    "poses that differ": (
        contradictory_poses,
        "differs from the camera poses in the IMU frame (baselines of 0.1201 and 0.2401 m)",
    ),
    "four coefficients": (edited(opencv("yml"), ("fisheye_model: 0", "made: 2026")), "are read as k1, k2, p1, p2"),
}


@pytest.mark.parametrize("what", REPORTED)
def test_what_is_not_used_of_a_calibration_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, what: str
) -> None:
    make, words = REPORTED[what]
    path = make(tmp_path)
    rig = read_calibration(path, SIZE).rig
    assert rig.baseline_m == pytest.approx(np.linalg.norm(APART.translation), abs=1e-9)
    assert f"calibration '{path}': " in caplog.text
    assert words in caplog.text


def test_a_rotation_vector_of_opencv_is_a_rotation(tmp_path: Path) -> None:
    values = lenses(Pair()) | apart(Pair())
    by_matrix = read_calibration(storage(tmp_path / "a.yml", values), SIZE)
    values["R"] = cv2.Rodrigues(values["R"])[0]
    by_vector = read_calibration(storage(tmp_path / "b.yml", values), SIZE)
    assert by_vector.pair.left.is_same(by_matrix.pair.left)


def test_the_p_of_the_right_camera_may_have_another_principal_point(tmp_path: Path) -> None:
    """As OpenCV computes P without CALIB_ZERO_DISPARITY, and as messages are accepted."""
    pair = Pair()
    lens_values = [value for camera in zip(KS, pair.ds, strict=True) for value in camera]
    turn, move = pair.T_right_left.rotation, pair.T_right_left.translation
    matrices = cv2.stereoRectify(*lens_values, SIZE, turn, move, flags=0, alpha=0)[:4]
    assert abs(matrices[2][0, 2] - matrices[3][0, 2]) > 1.0
    file = storage(tmp_path / "stereo.yml", lenses(pair) | dict(zip(("R1", "R2", "P1", "P2"), matrices, strict=True)))
    found = read_calibration(file, SIZE)
    assert found.rectifier is not None
    assert found.rig.cx == matrices[2][0, 2]
    assert found.rig.baseline_m == pytest.approx(np.linalg.norm(move))


def test_without_a_size_it_must_be_in_the_file(tmp_path: Path) -> None:
    file = opencv("json")(tmp_path, Pair())
    with pytest.raises(InputError, match="the image size is missing"):
        read_calibration(file)
    content = json.loads(file.read_text()) | {"imageSize": [*SIZE]}
    file.write_text(json.dumps(content, indent="\t"))
    assert read_calibration(file).pair.left.size[0] == SIZE[0]


@pytest.mark.parametrize(
    ("name", "text", "model"), [("note", "not fisheye", "plumb_bob"), ("model", "fisheye", "equidistant")]
)
def test_only_a_flag_or_a_model_states_a_fisheye_lens(name: str, text: str, model: str, tmp_path: Path) -> None:
    values = {key: value for key, value in lenses(Pair(model)).items() if key != "fisheye_model"}
    path = storage(tmp_path / "stereo.yml", values | apart(Pair(model)) | {name: text})
    assert read_calibration(path, SIZE).pair.left.model == model


@pytest.mark.parametrize(("old", "new"), [(f">{SIZE[0]}<", f">{SIZE[0]}.0<"), (" 0. ", " 0.0e0 "), (">0<", ">0.<")])
def test_equal_numbers_of_two_files_may_be_written_differently(old: str, new: str, tmp_path: Path) -> None:
    values = {**lenses(Pair()), **apart(Pair()), "image_width": SIZE[0], "image_height": SIZE[1]}
    for name in ("intrinsics.xml", "extrinsics.xml"):
        storage(tmp_path / name, values)
    expected = read_calibration(tmp_path / "intrinsics.xml", SIZE)
    text = (tmp_path / "extrinsics.xml").read_text()
    assert old in text
    (tmp_path / "extrinsics.xml").write_text(text.replace(old, new))
    found = read_calibration(tmp_path / "intrinsics.xml", SIZE)
    np.testing.assert_array_equal(found.pair.right.p, expected.pair.right.p)


@pytest.mark.parametrize("write", [ros, camera_info, opencv_in_two_files, colmap])
@pytest.mark.parametrize("letters", [str.upper, str.capitalize])
def test_two_files_are_found_by_names_in_any_case(
    write: Callable[[Path, Pair], Path], letters: Callable[[str], str], tmp_path: Path
) -> None:
    path = write(tmp_path, Pair())
    expected = read_calibration(path, SIZE)
    for item in sorted(tmp_path.rglob("*"), reverse=True):  # files before their folders
        item.rename(item.with_name(letters(item.name)))
    named = {str(file).lower(): file for file in (tmp_path, *tmp_path.rglob("*"))}
    found = read_calibration(named[str(path).lower()], SIZE)
    for camera, of_lower_case in zip(found.pair[:2], expected.pair[:2], strict=True):
        np.testing.assert_array_equal(camera.p, of_lower_case.p)


@pytest.mark.parametrize("write", [ros, camera_info])
def test_files_named_left_and_right_are_not_exchanged(write: Callable[[Path, Pair], Path], tmp_path: Path) -> None:
    path = write(tmp_path, Pair())
    right = next(file for file in tmp_path.rglob("*.yaml") if "right" in str(file.relative_to(tmp_path)))
    content = yaml.safe_load(right.read_text().partition("---\n")[0])
    p = content["projection_matrix"]["data"] if "projection_matrix" in content else content["p"]
    p[3] = -p[3]
    right.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match="left and right swapped"):
        read_calibration(path)


def test_a_pair_whose_second_camera_is_the_left_one_is_turned_round(tmp_path: Path) -> None:
    found = read_calibration(kalibr(tmp_path, moved(0.12, 0, 0))).pair
    assert found.text == "Kalibr 'camchain.yaml', cam1 and cam0"
    assert found.left.k[0] == KS[1][0, 0]
    found.check_images("/cam1/image_raw", "/cam0/image_raw", "")
    found.check_images("/cam1/left/image_raw", "/cam1/right/image_raw", "")
    with pytest.raises(InputError, match="left and right swapped"):
        found.check_images("/cam0/image_raw", "/cam1/image_raw", "")


@given(
    st.sampled_from([*FORMATS]),
    st.integers(0, 3000),
    st.integers(0, 40),
    st.sampled_from(["", "1e999", "{", "[]", "- x"]),
)
@example("colmap", 0, 0, "[{}]")
def test_a_broken_file_is_read_or_refused(name: str, start: int, count: int, put: str) -> None:
    with TemporaryDirectory() as place:
        path = FORMATS[name](Path(place), Pair())
        file = path if path.is_file() else max(Path(place).glob("*.*"))
        text = file.read_text()
        at = start % len(text)
        file.write_text(text[:at] + put + text[at + count :])
        with suppress(InputError):
            assert isinstance(read_calibration(path, SIZE), StereoCalibration)
