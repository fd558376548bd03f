"""The calibrations of other programs: one function for each program, and how its files are recognised."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.io.calibration.opened_file import (
    HEIGHTS,
    WIDTHS,
    OpenedFile,
    are_equal,
    content_of,
    is_colmap_list,
    named_values,
    number_of,
    numbers_of,
    parse_opencv_yaml,
    plain_name,
    size_of,
    stated_size,
    whole_size,
)
from sfr_loc_map.io.calibration.projections import check_centre, projection
from sfr_loc_map.io.calibration.rectification import RectifiableCamera, check_camera_matrix
from sfr_loc_map.io.calibration.rig_file import read_rig
from sfr_loc_map.io.calibration.stereo_calibration import (
    CameraPair,
    PosedCamera,
    check_one_baseline,
    with_rectification,
)
from sfr_loc_map.json_yaml import converted
from sfr_loc_map.message_text import alternatives, counted
from sfr_loc_map.suite_names import SIDES

_log = logging.getLogger(__name__)
PINHOLE_MODELS = ("radtan", "radial-tangential", "plumb_bob", "equidistant", "equi", "none")
"""Distortion models of Kalibr and EuRoC."""
MODEL_NAMES = ("model", "distortionmodel", "cameramodel", "lensmodel")
"""Plain names (`plain_name`) of the lens model in files of OpenCV."""
OPENCV_MATRICES = ("m", "k", "cameramatrix", "d", "distcoeffs", "distortioncoefficients", "r", "p", "t")
"""Plain names (`plain_name`) of the matrices in files of OpenCV, without the number of the camera."""
IMAGE_SIZES = ("imagesize", *map(plain_name, (*WIDTHS, *HEIGHTS)))
"""Plain names of the image size in files of OpenCV."""
SAME_POSE = 1e-3  #: Largest difference, m and rad, between two stated poses of the right camera that is not reported.
ONE_FOCAL = {"SIMPLE_PINHOLE": 3, "SIMPLE_RADIAL": 4, "RADIAL": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5}
TWO_FOCALS = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}
"""Numbers of parameters of COLMAP's models (colmap.github.io, "Camera Models"), by the number of focal lengths.
Principal point and distortion in OpenCV's order follow the focal lengths."""


class ProgramReader(NamedTuple):
    """The reader of the files of a program, and how they are recognised."""

    shown: str  #: Program, with names in its files or of its files, for messages.
    read: Callable[[OpenedFile], CameraPair]
    recognises: Callable[[OpenedFile], bool]  #: Whether a file belongs to this program.


def _side_by_side(name: str, cameras: list[PosedCamera], names: list[str]) -> CameraPair:
    """Return the pair of two cameras; their poses determine which of them is left, unless `names` state it.

    Names state the left camera if they differ in the word `left`, in upper or lower case; a common folder may have it.
    """
    one, other = (each.lower().count(SIDES[0]) for each in names)
    if other > one:
        cameras, names = cameras[::-1], names[::-1]
    if one == other and (cameras[0].T_body_cam.inverse() @ cameras[1].T_body_cam).translation[0] < 0:
        cameras, names = cameras[::-1], names[::-1]
        _log.warning(
            f"{name}: {names[1]} is to the right of {names[0]}: the images of {names[0]} must be the left ones"
        )
    left, right = names
    return CameraPair(
        *with_rectification(name, *cameras),
        f"{name}, {left} and {right}",
        T_body_left=cameras[0].T_body_cam,
        names=(left, right),
    )


def _two_files(opened: OpenedFile, one: str, other: str) -> list[Path]:
    """Return the files of the two cameras, whose paths differ in a word; raise InputError if there is only one file."""
    if opened.other is None:
        names = f"{opened.file.parent.name}/{opened.file.name}".lower()
        advice = f"with {other} in place of {one} or {one} in place of {other}"
        if one not in names and other not in names:
            advice = f"and name the files by {one} and {other}"
        raise InputError(
            f"calibration '{opened.file}' has one camera: add the file of the other camera at the same path, {advice}"
        )
    return opened.files


def _lens(d: Sequence[float], is_fisheye: bool) -> str:
    """Return the name of the distortion model of coefficients, a key of `rectification.COEFFICIENTS`."""
    return "equidistant" if is_fisheye else "plumb_bob" if len(d) <= 5 else "rational_polynomial"


def _pinhole_lens(
    name: str, camera_model: str, model: str, coefficients: Sequence[float]
) -> tuple[tuple[float, ...], str]:
    """Return coefficients and distortion model of a pinhole camera of Kalibr or EuRoC.

    Raises ValueError for other cameras.
    """
    if camera_model != "pinhole":
        raise ValueError(f"{name} has the camera_model '{camera_model[:40]}': pinhole is required")
    if model not in PINHOLE_MODELS:
        raise ValueError(f"{name} has the distortion_model '{model[:40]}': {alternatives(PINHOLE_MODELS)} is required")
    if model == "none" and any(coefficients):
        raise ValueError(f"{name} has the distortion_model none, but coefficients that are not 0: name the model")
    d = tuple(coefficients) or (0.0,) * 4
    return d, _lens(d, model.startswith("equi"))


def _four(intrinsics: Sequence[float]) -> tuple[float, float, float, float]:
    if len(intrinsics) != 4:
        raise ValueError(f"it has {len(intrinsics)} intrinsics: fx, fy, cx, cy are required")
    fx, fy, cx, cy = intrinsics
    return fx, fy, cx, cy


_Row = tuple[float, float, float, float]
_Matrix = tuple[_Row, _Row, _Row, _Row]


def _transform(rows: _Matrix) -> Transform:
    return Transform.from_matrix(np.array(rows, np.float64))


# ---- Kalibr


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
        d, lens = _pinhole_lens(name, self.camera_model, self.distortion_model, self.distortion_coeffs)
        return PosedCamera(self.resolution, _four(self.intrinsics), d, T_body_cam, lens)

    def pose_in_imu(self) -> Transform | None:
        """Return the pose of the camera in the IMU; None if the file does not give it."""
        if self.T_imu_cam is not None:
            return _transform(self.T_imu_cam)
        return None if self.T_cam_imu is None else _transform(self.T_cam_imu).inverse()


def _pose_of_right(one: _KalibrCamera, other: _KalibrCamera, where: str) -> Transform:
    """Return the pose of cam1 in cam0 from T_cn_cnm1 of cam1, else from the poses of both cameras in the IMU.

    If both are given and differ, a warning that begins with `where` reports this.
    """
    in_imu, other_in_imu = one.pose_in_imu(), other.pose_in_imu()
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


def _kalibr(opened: OpenedFile) -> CameraPair:
    content, where = opened.content, f"calibration '{opened.file}'"
    if "cam1" not in content:
        names = ", ".join(name for name in opened.shown_names if name.startswith("cam"))
        raise ValueError(f"it has only {names}: cam0 and cam1 are required")
    one, other = (converted(content.get(name), _KalibrCamera, name) for name in ("cam0", "cam1"))
    if further := [name for name in opened.shown_names if re.fullmatch(r"cam(?:[2-9]|[1-9][0-9]+)", name)]:
        _log.warning(f"{where}: cam0 and cam1 are used, not {', '.join(further)}")
    poses = Transform.identity(), _pose_of_right(one, other, where)
    cameras = [one.calibrated("cam0", poses[0]), other.calibrated("cam1", poses[1])]
    return _side_by_side(f"Kalibr '{opened.file.name}'", cameras, ["cam0", "cam1"])


# ---- EuRoC


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
    return _side_by_side("EuRoC", cameras, [f"'{path.parent.name}/{path.name}'" for path in files])


def _euroc_camera(path: Path) -> PosedCamera:
    with refusing(f"'{path}' is not a sensor.yaml of an EuRoC camera"):
        content = parse_opencv_yaml(read_text(path))
        camera = converted(content, _SensorYaml)
        d, lens = _pinhole_lens("it", camera.camera_model, camera.distortion_model, camera.distortion_coefficients)
        return PosedCamera(camera.resolution, _four(camera.intrinsics), d, camera.T_BS.transform, lens)


def _euroc(opened: OpenedFile) -> CameraPair:
    return euroc_pair(_two_files(opened, "cam0", "cam1"))


# ---- ORB-SLAM


def _orbslam(opened: OpenedFile) -> CameraPair:
    """Read settings of ORB-SLAM: R and P of raw images (LEFT.K, ...), two raw cameras, or one rectified camera."""
    text = f"ORB-SLAM '{opened.file.name}'"
    if "left.k" in opened.content:
        left, right = (_orbslam_side(opened.content, side.upper()).checked(text) for side in SIDES)
        return CameraPair(left, right, f"{text}, LEFT and RIGHT")
    first = "Camera1" if "camera1.fx" in opened.content else "Camera"
    if "camera2.fx" in opened.content:
        return _orbslam_raw(opened, first, text)
    return _orbslam_rectified(opened, first, text)


def _orbslam_side(content: Mapping[str, Any], side: str) -> RectifiableCamera:
    """Return the camera of `LEFT` or `RIGHT` in older settings."""
    k, d, r, p = (numbers_of(content, f"{side}.{name}") for name in "KDRP")
    size = whole_size(number_of(content, f"{side}.width"), number_of(content, f"{side}.height"))
    return RectifiableCamera(size, _lens(d, False), d, k, r, p)


def _orbslam_raw(opened: OpenedFile, first: str, text: str) -> CameraPair:
    """Return two raw cameras with the pose Stereo.T_c1_c2 of the right camera, which older files call Tlr."""
    content, size = opened.content, _orbslam_size(opened, first)
    numbers = numbers_of(content, "Stereo.T_c1_c2", "Tlr")
    if len(numbers) not in (12, 16):
        raise ValueError(f"Stereo.T_c1_c2 has {counted(len(numbers), 'number')}: 12 or 16 are required")
    T_left_right = np.eye(4)
    T_left_right[:3] = np.array(numbers[:12]).reshape(3, 4)
    is_fisheye = _is_kannala_brandt(content)
    cameras = []
    for name, pose in ((first, np.eye(4)), ("Camera2", T_left_right)):
        d = _orbslam_distortion(content, name)
        intrinsics = _orbslam_intrinsics(content, name)
        cameras.append(PosedCamera(size, intrinsics, d, Transform.from_matrix(pose), _lens(d, is_fisheye)))
    return CameraPair(*with_rectification(text, *cameras), f"{text}, {first} and Camera2")


def _orbslam_rectified(opened: OpenedFile, name: str, text: str) -> CameraPair:
    """Return a pair of rectified images: one camera without distortion, and a baseline from Camera.bf or Stereo.b."""
    content, size = opened.content, _orbslam_size(opened, name)
    if _is_kannala_brandt(content) or any(_orbslam_distortion(content, name)):
        raise ValueError(
            f"{name} has a distortion but there is no Camera2: the settings are of one raw camera, not "
            "of a stereo pair; give the calibration of both cameras"
        )
    fx, fy, cx, cy = _orbslam_intrinsics(content, name)
    shifts = {"Stereo.b": fx * number_of(content, "Stereo.b")} if "stereo.b" in content else {}
    if "camera.bf" in content or not shifts:
        shifts["Camera.bf"] = number_of(content, "Camera.bf")
    if not fx > 0.0:
        raise ValueError(f"{name}.fx is {fx:g}: a positive focal length is required")
    check_one_baseline({origin: shift / fx for origin, shift in shifts.items()})
    for origin, shift in shifts.items():
        if not shift > 0.0:
            raise ValueError(f"{origin} is {number_of(content, origin):g}: a positive baseline is required")
    ps = [(fx, 0.0, cx, -move, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0) for move in (0.0, next(iter(shifts.values())))]
    left, right = (RectifiableCamera.of_rectified(size, np.array(p)) for p in ps)
    return CameraPair(left, right, f"{text}, rectified")


def _orbslam_size(opened: OpenedFile, name: str) -> tuple[int, int]:
    """Return the size in the settings, or that of the images if the settings have no size."""
    if opened.size is not None and "camera.width" not in opened.content:
        cx, cy = _orbslam_intrinsics(opened.content, name)[2:]
        check_centre(cx, cy, opened.size, f"calibration '{opened.file}'")
        return opened.size
    return whole_size(number_of(opened.content, "Camera.width"), number_of(opened.content, "Camera.height"))


def _orbslam_intrinsics(content: Mapping[str, Any], name: str) -> tuple[float, float, float, float]:
    return _four([number_of(content, f"{name}.{item}") for item in ("fx", "fy", "cx", "cy")])


def _orbslam_distortion(content: Mapping[str, Any], name: str) -> tuple[float, ...]:
    """Return the coefficients in OpenCV's order; missing coefficients are 0."""
    names = ("k1", "k2", "k3", "k4") if _is_kannala_brandt(content) else ("k1", "k2", "p1", "p2", "k3")
    items = (f"{name}.{item}" for item in names)
    return tuple(number_of(content, item) if plain_name(item) in content else 0.0 for item in items)


def _is_kannala_brandt(content: Mapping[str, Any]) -> bool:
    return "kannala" in str(content.get("camera.type", "")).lower()


# ---- OpenCV


def _opencv(opened: OpenedFile) -> CameraPair:
    """Read M1, D1, M2, D2 with R1, P1, R2, P2, or else with R and T, from one file or two."""
    where = f"calibration '{opened.file}'"
    files = [opened.file, *([opened.other] if opened.other else [])]
    values = _opencv_values(files)
    text = "OpenCV " + " and ".join(f"'{file.name}'" for file in files)
    ks = [numbers_of(values, f"M{n}", f"K{n}", f"cameraMatrix{n}") for n in (1, 2)]
    for k in ks:
        check_camera_matrix(k, where)
    size = size_of(values, opened.size)
    if stated_size(values) is None:
        check_centre(ks[0][2], ks[0][5], size, where)
    ds = [numbers_of(values, f"D{n}", f"distCoeffs{n}", f"distortion_coefficients_{n}") for n in (1, 2)]
    is_fisheye = _is_fisheye(values, ds, where)
    lenses = [_OpenCvLens(size, _lens(d, is_fisheye), k, d) for k, d in zip(ks, ds, strict=True)]
    if values.keys() >= {"r1", "r2", "p1", "p2"}:
        return _opencv_rectified(values, lenses, text)
    return _opencv_posed(values, lenses, text)


class _OpenCvLens(NamedTuple):
    """A camera of a file of OpenCV without its pose: size of the images, model, camera matrix and distortion."""

    size: tuple[int, int]
    model: str
    k: tuple[float, ...]
    d: tuple[float, ...]


def _opencv_rectified(values: Mapping[str, Any], lenses: Sequence[_OpenCvLens], text: str) -> CameraPair:
    """Return the pair whose file has R and P of both cameras, as stereoRectify gives them."""
    left, right = (
        RectifiableCamera(size, model, d, k, numbers_of(values, f"R{n}"), numbers_of(values, f"P{n}")).checked(text)
        for n, (size, model, k, d) in enumerate(lenses, 1)
    )
    if "t" in values:
        of_p_m = (left.p[3] - right.p[3]) / right.p[0]
        check_one_baseline({"T": float(np.linalg.norm(numbers_of(values, "T"))), "P2": of_p_m})
    return CameraPair(left, right, text)


def _opencv_posed(values: Mapping[str, Any], lenses: Sequence[_OpenCvLens], text: str) -> CameraPair:
    """Return the pair whose file has R and T between the cameras, as stereoCalibrate gives them."""
    rotation, translation = (np.array(numbers_of(values, name)) for name in ("R", "T"))
    for name, numbers, counts in (("R", rotation, (3, 9)), ("T", translation, (3,))):
        if len(numbers) not in counts:
            raise ValueError(
                f"{name} has {counted(len(numbers), 'number')}: {alternatives(map(str, counts))} are required"
            )
    matrix = matrix_from_rotvec(rotation) if len(rotation) == 3 else rotation.reshape(3, 3)
    T_right_left = Transform.from_matrix(np.c_[matrix, translation])
    left, right = (
        PosedCamera(size, (k[0], k[4], k[2], k[5]), d, pose, model)
        for (size, model, k, d), pose in zip(lenses, (Transform.identity(), T_right_left.inverse()), strict=True)
    )
    return CameraPair(*with_rectification(text, left, right), text)


def _opencv_values(files: Sequence[Path]) -> dict[str, Any]:
    """Return the values of one file or two by their plain names; ValueError if two files contradict each other."""
    values: dict[str, Any] = {}
    for file in files:
        with refusing(f"calibration '{file}'"):
            found = named_values(file)
        for name in sorted(values.keys() & found.keys()):
            if _is_read(name) and not are_equal(values[name], found[name]):
                raise ValueError(f"{name} differs between '{files[0]}' and '{file}': rename or remove one of the files")
        values |= found
    return values


def _is_read(name: str) -> bool:
    """Return whether the value with this plain name (`plain_name`) is read from files of OpenCV.

    Two files of one calibration may differ in other values, such as dates.
    """
    is_matrix = name.rstrip("12") in OPENCV_MATRICES
    return is_matrix or name in (*MODEL_NAMES, *IMAGE_SIZES) or "fisheye" in name


def _is_fisheye(values: Mapping[str, Any], ds: Sequence[Sequence[float]], where: str) -> bool:
    """Return whether a flag (`fisheye: 1`) or a model in a file of OpenCV states a fisheye lens.

    A warning reports coefficients `ds` of both cameras that may be those of either lens, if the file has neither.
    """
    stated = [value for name, value in values.items() if "fisheye" in name]
    flags = [not are_equal(value, 0) and not are_equal(value, "false") for value in stated]
    models = [str(values[name]).lower() for name in MODEL_NAMES if name in values]
    found = [*flags, *(True for model in models if re.search(r"fisheye|\bequi", model))]
    if not found and all(len(d) == 4 and any(d) for d in ds):
        _log.warning(
            f"{where}: 4 distortion coefficients are read as k1, k2, p1, p2: if they are those of cv::fisheye, add "
            "'fisheye: 1' to the file; if not, add 'fisheye: 0'"
        )
    return any(found)


# ---- ROS


def _ros(opened: OpenedFile) -> CameraPair:
    """Read two files of camera_calibration, or two messages of camera_info as `ros2 topic echo` prints them."""
    cameras, files = [], _two_files(opened, "left", "right")
    for path in files:
        with refusing(f"calibration '{path}'"):
            cameras.append(_ros_camera(path))
    left, right = cameras
    return CameraPair(left, right, "ROS " + " and ".join(f"'{path.name}'" for path in files))


def _ros_camera(path: Path) -> RectifiableCamera:
    values = named_values(path)
    names = (("camera_matrix", "k"), ("rectification_matrix", "r"), ("projection_matrix", "p"))
    k, r, p = (numbers_of(values, *each) for each in names)
    model, d = str(values.get("distortionmodel", "")), numbers_of(values, "distortion_coefficients", "d")
    return RectifiableCamera(size_of(values), model, d, k, r, p).checked(f"'{path}'")


# ---- COLMAP


def _colmap(opened: OpenedFile) -> CameraPair:
    file, rig_file = opened.files
    of_rig, rows = _colmap_rig(rig_file), _colmap_rows(file)
    rows.sort(key=lambda row: int(row[0]))  # order by CAMERA_ID, because COLMAP writes cameras in any order
    if len(of_rig) != 2 or len(rows) not in (1, 2):
        raise ValueError(f"the first rig has {len(of_rig)} cameras and '{file.name}' has {len(rows)}: two are required")
    is_complete = all({"camera_model_name", "camera_params"} <= camera.keys() for camera in of_rig)
    if rows[0][1:] != rows[-1][1:] and not is_complete:
        raise ValueError(
            f"the cameras of '{file.name}' differ, and '{rig_file.name}' does not state which is the left camera: "
            f"give camera_model_name and camera_params of each camera in '{rig_file.name}'"
        )
    found, names = [], []
    for row, camera in zip((rows[0], rows[-1]), of_rig, strict=True):
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
        size, model = (int(row[2]), int(row[3])), _lens(d, "FISHEYE" in lens)
        found.append(PosedCamera(size, intrinsics, tuple(d), T_cam_rig.inverse(), model))
        names.append(str(camera.get("image_prefix", f"camera {row[0]}")))
    return _side_by_side(f"COLMAP '{file.parent.name}'", found, names)


def _colmap_rig(file: Path) -> list[dict[str, Any]]:
    """Return the cameras of the first rig in a file; raise ValueError if its form is not that of COLMAP."""
    content = content_of(file)
    rig = content[0] if isinstance(content, list) and content else None
    cameras = rig.get("cameras") if isinstance(rig, dict) else None
    if not isinstance(cameras, list) or not all(isinstance(camera, dict) for camera in cameras):
        raise ValueError(f"'{file.name}' has no list of rigs, each with a list of 'cameras': one rig is required")
    return cameras


def _colmap_rows(file: Path) -> list[list[str]]:
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
    """Return `count` numbers; raise ValueError if the list has another length or other values."""
    try:
        numbers = [float(value) for value in values] if isinstance(values, list | tuple) else []
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count:
        raise ValueError(f"{name} is {values!r:.60}: {count} numbers are required")
    return numbers


# ---- rig.json


def _rig(opened: OpenedFile) -> CameraPair:
    rig = read_rig(opened.file)
    left, right = (RectifiableCamera.of_rectified((rig.width, rig.height), projection(rig, side)) for side in SIDES)
    return CameraPair(left, right, f"rig '{opened.file.name}'", rig.T_rb_sb)


# ---- recognition


def _has(*alternatives: str) -> Callable[[OpenedFile], bool]:
    """Return a test whether the content has all names of one alternative, such as `T_BS intrinsics`."""
    sets = [{plain_name(name) for name in names.split()} for names in alternatives]

    def is_named(opened: OpenedFile) -> bool:
        return isinstance(opened.content, dict) and any(names <= opened.content.keys() for names in sets)

    return is_named


def _is_colmap(opened: OpenedFile) -> bool:
    """Return whether two files have the names of COLMAP."""
    return opened.other is not None and is_colmap_list(opened.files[0])


READERS = (
    ProgramReader("Kalibr (cam0, cam1)", _kalibr, _has("cam0")),
    ProgramReader("EuRoC", _euroc, _has("T_BS intrinsics")),
    ProgramReader("ORB-SLAM", _orbslam, _has("LEFT.K", "Camera.fx", "Camera1.fx")),
    ProgramReader("OpenCV (M1, D1, M2, D2, R, T)", _opencv, _has("M1", "K1", "cameraMatrix1", "R1", "T")),
    ProgramReader("ROS (camera_matrix, projection_matrix)", _ros, _has("projection_matrix", "k r p")),
    ProgramReader("COLMAP (cameras.txt and rig_config.json)", _colmap, _is_colmap),
    ProgramReader("a rig.json", _rig, _has("baseline_m")),
)
"""The readers of calibrations. The first reader that recognises a file reads it."""
