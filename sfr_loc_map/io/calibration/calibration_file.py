"""The calibration of a stereo pair from files of other programs, detected from the content.

    Kalibr       camchain.yaml with cam0 and cam1 (pinhole; radtan, equidistant) and T_cn_cnm1, T_cam_imu or T_imu_cam
    EuRoC        cam0/sensor.yaml and cam1/sensor.yaml
    ORB-SLAM     settings with LEFT.K, RIGHT.K, ..., with Camera1, Camera2 and Stereo.T_c1_c2, or with Camera.bf
    OpenCV       FileStorage (YAML, XML, JSON) with M1 D1 M2 D2 R T or R1 R2 P1 P2, in one file or two
    ROS          left.yaml and right.yaml of camera_calibration
    COLMAP       cameras.txt and rig_config.json
    rig.json     of the suite

If a calibration has two files, the second is found by its name (`PARTNERS`). A folder with one calibration is accepted.
"""

from __future__ import annotations

import logging
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
import yaml

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES, parse_yaml, read_text, refusing
from sfr_loc_map.io.calibration.camera_info import projection, rig_from_projections
from sfr_loc_map.io.calibration.rectification import RawCamera, common_projection
from sfr_loc_map.io.calibration.rig_file import read_rig
from sfr_loc_map.io.calibration.stereo_calibration import CalibratedCamera, Calibration, rectified_cameras

_log = logging.getLogger(__name__)
ENDINGS = (".yaml", ".yml", ".xml", ".json", ".txt")
PARTNERS = (("left", "right"), ("cam0", "cam1"), ("intrinsics", "extrinsics"), ("cameras.txt", "rig_config.json"))
"""Words in which the names of the two files of a calibration, or of their folders, differ."""
COLMAP_FILE = "cameras.txt"  #: Name of the file of COLMAP with intrinsics; the other file has the poses in the rig.
PINHOLE_MODELS = ("radtan", "radial-tangential", "plumb_bob", "equidistant", "equi", "none")
"""Distortion models of Kalibr and EuRoC."""
LARGEST_BASELINE_M = 5.0  #: Largest baseline, m; larger numbers are in millimetres.
ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")
"""Models of COLMAP by number of focal lengths; principal point and distortion in OpenCV's order follow."""


class CalibrationError(InputError):
    """A calibration file cannot be used."""


def read_calibration(path: Path, size: tuple[int, int] | None = None) -> Calibration:
    """Read a calibration from a file or a folder; `size`: width and height of the images, if known.

    CalibrationError if it is not a calibration, is corrupt, is not of a side-by-side pair, or is of another image size.
    """
    try:
        return _calibration(path, size)
    except InputError as error:
        raise CalibrationError(str(error)) from error


def _calibration(path: Path, size: tuple[int, int] | None) -> Calibration:
    where = f"calibration '{path}'"
    with naming(path), refusing(where):
        opened = _opened(_only_file(path) if path.is_dir() else path, size)
        reader = next((reader for reader in READERS if reader.recognises(opened)), None)
        if reader is None:
            *known, last = (reader.shown for reader in READERS)
            names = ", ".join(opened.shown_names[:8]) or "none of these names"
            raise InputError(f"{where}: a file of {', '.join(known)} or {last} is required, it has {names}")
        left, right, text, T_rb_sb = reader.read(opened)
    if len(sizes := {left.size, right.size, size or left.size}) > 1:
        shown = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise InputError(f"{where} and the images differ in size, {shown} px: calibrate both cameras at the image size")
    rig = rig_from_projections(np.array(left.p), common_projection(left, right), left.size, where)
    if rig.baseline_m > LARGEST_BASELINE_M:
        raise InputError(f"{where}: the baseline is {rig.baseline_m:g} m: give it in metres")
    return Calibration((left, right), left.is_rectified and right.is_rectified, T_rb_sb, text)


@dataclass(frozen=True, slots=True, eq=False)
class _OpenedFile:
    """A calibration file with its content, and the second file of the calibration."""

    file: Path
    other: Path | None  #: The second file, found by its name; None if there is none.
    content: Any  #: YAML, JSON or XML; a mapping has plain names (`_plain`).
    shown_names: list[str]  #: The names in the content as written, in alphabetical order.
    size: tuple[int, int] | None  #: Width and height of the images, if known.

    @property
    def files(self) -> list[Path]:
        """The one or two files of the calibration, in the order of their names."""
        return sorted([self.file.absolute(), *([self.other] if self.other else [])])


class _CameraPair(NamedTuple):
    """The cameras in a calibration, with R and P."""

    left: RawCamera
    right: RawCamera
    text: str  #: Program, file, left and right camera.
    T_rb_sb: Transform | None = None  #: Pose of the rig in RB, if the file has it.


class _Reader(NamedTuple):
    """The reader of the files of a program, and how they are recognised."""

    shown: str  #: Program, and names of its files for messages.
    read: Callable[[_OpenedFile], _CameraPair]
    recognises: Callable[[_OpenedFile], bool]  #: Whether a file is of this program.


def _opened(file: Path, size: tuple[int, int] | None) -> _OpenedFile:
    """Open a calibration file; COLMAP's list of cameras is neither YAML nor JSON, and is read later."""
    content = None if file.name.endswith(COLMAP_FILE) else _content(file)
    names = sorted(str(name) for name in content) if isinstance(content, dict) else []
    plain = _with_plain_names(content) if isinstance(content, dict) else content
    return _OpenedFile(file, _partner(file), plain, names, size)


def _plain(name: str) -> str:
    """Return a name in lower case without underscores; programs and their versions differ in both."""
    return name.lower().replace("_", "")


def _with_plain_names(content: Mapping[Any, Any]) -> dict[str, Any]:
    return {_plain(str(name)): value for name, value in content.items()}


def _only_file(folder: Path) -> Path:
    """Return the only calibration file in a folder, or the first file if the calibration has two."""
    files = [*folder.absolute().glob("*.*"), *folder.absolute().glob("*/*.*")]
    files = sorted(file for file in files if file.suffix.lower() in ENDINGS)
    found = [file for file in files if (other := _partner(file)) and file < other] or files
    if len(found) != 1:
        names = ", ".join(str(file.relative_to(folder.absolute())) for file in found[:8]) or "none"
        raise InputError(f"calibration '{folder}': one calibration is required, it has {names}; name the file")
    return found[0]


def _partner(file: Path) -> Path | None:
    """Return the second file of the calibration to which a file belongs; None if there is no second file."""
    file, places = file.absolute(), []
    for one, other in (*PARTNERS, *(pair[::-1] for pair in PARTNERS)):
        places.append(file.with_name(file.name.replace(one, other)))
        places.append(file.parent.with_name(file.parent.name.replace(one, other)) / file.name)
    return next((place for place in places if place != file and place.is_file()), None)


def _content(file: Path) -> Any:  # noqa: ANN401 - any YAML or JSON
    """Return the content of YAML, JSON (which is YAML, except for tabs) or OpenCV's XML."""
    text = read_text(file).strip()
    if text.startswith("<"):
        if "<!" in text.replace("<!--", ""):
            raise ValueError("XML with declarations is not supported")
        root = ET.fromstring(text)
        return {item.tag: {part.tag: part.text for part in item} if len(item) else item.text for item in root}
    try:
        return parse_opencv_yaml(text.removesuffix("---"))  # `ros2 topic echo` ends messages by `---`
    except yaml.YAMLError as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        place = "" if line is None else f" (line {line + 1})"
        reason = "" if line is not None else f": {error}"
        raise ValueError(f"it is not YAML, JSON or XML{place}{reason}") from error


def _named_values(file: Path) -> dict[str, Any]:
    """Return the values in a file by their plain names (`_plain`); ValueError if it has no names."""
    content = _content(file)
    if not isinstance(content, dict):
        raise ValueError("it has no names of values")
    return _with_plain_names(content)


def parse_opencv_yaml(text: str) -> Any:  # noqa: ANN401 - any YAML
    """Return the value of a YAML text as cv::FileStorage reads it: `%YAML:1.0`, `data:[`, tags and tabs."""
    text = re.sub(r"^%.*$|!!opencv-\S+|\t", " ", text, flags=re.MULTILINE)
    return parse_yaml(re.sub(r"^(\s*[A-Za-z][\w.]*):(?=[\[\d.+-])", r"\1: ", text, flags=re.MULTILINE))


def _numbers(content: Mapping[str, Any], *names: str) -> tuple[float, ...]:
    """Return the numbers, row by row, of the first matrix of `names` in the content; ValueError if there is none."""
    name = next((name for name in names if _plain(name) in content), None)
    if name is None:
        raise ValueError(f"it has no {' or '.join(names)}")
    item = content[_plain(name)]
    value = item["data"] if isinstance(item, dict) else item
    numbers = np.array(value.split() if isinstance(value, str) else value, np.float64).reshape(-1)
    if isinstance(item, dict) and {"rows", "cols"} <= item.keys():
        rows, columns = int(item["rows"]), int(item["cols"])
        if rows * columns != len(numbers):
            raise ValueError(f"{name} has {len(numbers)} numbers for {rows} rows and {columns} columns")
    return tuple(numbers.tolist())


def _size(content: Mapping[str, Any]) -> tuple[int, int]:
    """Return the width and height of the images, in the file or `given`; ValueError if unknown."""
    names = ("image_size", "image_width", "width", "image_height", "height", "given")
    found = [number for name in names if _plain(name) in content for number in _numbers(content, name)]
    if len(found) < 2:
        raise ValueError("it has no image_width and image_height")
    return int(found[0]), int(found[1])


def _lens(d: Sequence[float], fisheye: bool) -> str:
    return "equidistant" if fisheye else "plumb_bob" if len(d) <= 5 else "rational_polynomial"


class _KalibrCamera(msgspec.Struct):
    camera_model: str
    intrinsics: tuple[float, ...]
    distortion_model: str
    distortion_coeffs: tuple[float, ...]
    resolution: tuple[int, int]
    T_cn_cnm1: list[list[float]] | None = None
    T_cam_imu: list[list[float]] | None = None
    T_imu_cam: list[list[float]] | None = None

    def calibrated(self, name: str, T_body_cam: Transform) -> CalibratedCamera:
        """Return the camera with its pose."""
        d, lens = _pinhole_lens(name, self.camera_model, self.distortion_model, self.distortion_coeffs)
        return CalibratedCamera(self.resolution, _four(self.intrinsics), d, T_body_cam, lens)

    def pose_in_imu(self) -> Transform | None:
        """Return the pose of the camera in the IMU; None if the file does not give it."""
        if self.T_imu_cam is not None:
            return _matrix(self.T_imu_cam)
        return None if self.T_cam_imu is None else _matrix(self.T_cam_imu).inverse()


def _pinhole_lens(
    name: str, camera_model: str, model: str, coefficients: Sequence[float]
) -> tuple[tuple[float, ...], str]:
    """Return coefficients and distortion model of a pinhole camera of Kalibr or EuRoC; ValueError for other cameras."""
    if camera_model != "pinhole":
        raise ValueError(f"{name} has the camera_model '{camera_model[:40]}': pinhole is required")
    if model not in PINHOLE_MODELS:
        raise ValueError(f"{name} has the distortion_model '{model[:40]}': {' or '.join(PINHOLE_MODELS)} is required")
    if model == "none" and any(coefficients):
        raise ValueError(f"{name} has the distortion_model none, but coefficients that are not 0: name the model")
    d = tuple(coefficients) or (0.0,) * 4
    return d, _lens(d, model.startswith("equi"))


def _four(intrinsics: Sequence[float]) -> tuple[float, float, float, float]:
    if len(intrinsics) != 4:
        raise ValueError(f"{len(intrinsics)} intrinsics found where fx, fy, cx, cy are required")
    fx, fy, cx, cy = intrinsics
    return fx, fy, cx, cy


def _matrix(rows: list[list[float]]) -> Transform:
    return Transform.from_matrix(np.array(rows, np.float64).reshape(4, 4))


def _pose_of_right(one: _KalibrCamera, other: _KalibrCamera) -> Transform:
    """Return the pose of cam1 in cam0 from T_cn_cnm1 of cam1, else from the poses of both cameras in the IMU."""
    if other.T_cn_cnm1 is not None:
        return _matrix(other.T_cn_cnm1).inverse()
    in_imu, other_in_imu = one.pose_in_imu(), other.pose_in_imu()
    if in_imu is None or other_in_imu is None:
        raise ValueError("cam1 has no T_cn_cnm1, and cam0 and cam1 do not both have T_cam_imu or T_imu_cam")
    return in_imu.inverse() @ other_in_imu


def _kalibr(opened: _OpenedFile) -> _CameraPair:
    content = opened.content
    if "cam1" not in content:
        raise ValueError("it has only cam0: a stereo pair needs cam0 and cam1")
    one, other = (msgspec.convert(content.get(name), _KalibrCamera, strict=False) for name in ("cam0", "cam1"))
    if further := [name for name in opened.shown_names if re.fullmatch(r"cam[2-9]", name)]:
        _log.warning(f"calibration '{opened.file}': cam0 and cam1 are used, not {', '.join(further)}")
    poses = Transform.identity(), _pose_of_right(one, other)
    cameras = [one.calibrated("cam0", poses[0]), other.calibrated("cam1", poses[1])]
    return _side_by_side(f"Kalibr '{opened.file.name}'", cameras, ["cam0", "cam1"])


class _SensorPose(msgspec.Struct):
    data: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class _SensorYaml(msgspec.Struct):
    T_BS: _SensorPose
    resolution: tuple[int, int]
    camera_model: str
    intrinsics: tuple[float, ...]
    distortion_model: str
    distortion_coefficients: Annotated[tuple[float, ...], msgspec.Meta(max_length=8)] = (0.0,) * 4


def read_sensor_yaml(path: Path) -> CalibratedCamera:
    """Read the sensor.yaml of an EuRoC camera."""
    with refusing(f"'{path}' is not a sensor.yaml of an EuRoC camera"):
        content = parse_opencv_yaml(read_text(path))
        camera = msgspec.convert(content, _SensorYaml, strict=False)  # YAML reads 1e-5 as text
        pose = Transform.from_matrix(np.array(camera.T_BS.data).reshape(4, 4))
        d, lens = _pinhole_lens("it", camera.camera_model, camera.distortion_model, camera.distortion_coefficients)
        return CalibratedCamera(camera.resolution, _four(camera.intrinsics), d, pose, lens)


def _euroc(opened: _OpenedFile) -> _CameraPair:
    files = _two_files(opened, "cam0 and cam1")
    cameras = [read_sensor_yaml(path) for path in files]
    return _side_by_side("EuRoC", cameras, [f"'{path.parent.name}/{path.name}'" for path in files])


def _two_files(opened: _OpenedFile, names: str) -> list[Path]:
    """Return the files of the two cameras; InputError if there is only one."""
    if opened.other is None:
        raise InputError(
            f"calibration '{opened.file}' has one camera: add the file of the other camera beside it, named as {names}"
        )
    return opened.files


def _rig(opened: _OpenedFile) -> _CameraPair:
    rig = read_rig(opened.file)
    left, right = (RawCamera.of_rectified((rig.width, rig.height), projection(rig, side)) for side in SIDES)
    return _CameraPair(left, right, f"rig '{opened.file.name}'", rig.T_rb_sb)


def _orbslam(opened: _OpenedFile) -> _CameraPair:
    """Read the settings of ORB-SLAM: LEFT.K, RIGHT.K, ... or two cameras for raw images, one camera for rectified ones.

    Two raw cameras are given by Camera1, Camera2 and Stereo.T_c1_c2, in older files by Camera, Camera2 and Tlr. One
    camera with Camera.bf or Stereo.b is that of rectified images without distortion.
    """
    content, size, text = opened.content, opened.size, f"ORB-SLAM '{opened.file.name}'"
    if "left.k" in content:
        left, right = (_orbslam_raw(content, side.upper()).checked(text) for side in SIDES)
        return _CameraPair(left, right, f"{text}, LEFT and RIGHT")
    if size is None or "camera.width" in content:
        size = (int(_one(content, "Camera.width")), int(_one(content, "Camera.height")))
    first = "Camera1" if "camera1.fx" in content else "Camera"
    fisheye = "kannala" in str(content.get("camera.type", "")).lower()
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if "camera2.fx" in content:
        pose = np.eye(4)
        pose[:3] = np.array(_numbers(content, "Stereo.T_c1_c2", "Tlr")[:12]).reshape(3, 4)
        cameras = []
        for name, T_left in ((first, Transform.identity()), ("Camera2", Transform.from_matrix(pose))):
            d = tuple(float(content.get(_plain(f"{name}.{item}"), 0.0)) for item in names)
            fx, fy, cx, cy = (_one(content, f"{name}.{item}") for item in ("fx", "fy", "cx", "cy"))
            cameras.append(CalibratedCamera(size, (fx, fy, cx, cy), d, T_left, _lens(d, fisheye)))
        return _CameraPair(*rectified_cameras(text, *cameras), f"{text}, {first} and Camera2")
    if fisheye or any(float(content.get(_plain(f"{first}.{item}"), 0.0)) for item in names):
        raise ValueError(
            f"{first} has a distortion but there is no Camera2: the settings are of one raw camera, not "
            "of a stereo pair; give the calibration of both cameras"
        )
    fx, fy, cx, cy = (_one(content, f"{first}.{item}") for item in ("fx", "fy", "cx", "cy"))
    baseline = content.get("stereo.b")
    shift = fx * float(baseline) if baseline is not None else _one(content, "Camera.bf")
    ps = [(fx, 0.0, cx, -move, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0) for move in (0.0, shift)]
    left, right = (RawCamera.of_rectified(size, np.array(p)) for p in ps)
    return _CameraPair(left, right, f"{text}, rectified")


def _orbslam_raw(content: Mapping[str, Any], side: str) -> RawCamera:
    """Return the camera of `LEFT` or `RIGHT` in older settings of ORB-SLAM."""
    k, d, r, p = (_numbers(content, f"{side}.{name}") for name in "KDRP")
    size = (int(_one(content, f"{side}.width")), int(_one(content, f"{side}.height")))
    return RawCamera(size, _lens(d, False), d, k, r, p)


def _one(content: Mapping[str, Any], name: str) -> float:
    if _plain(name) not in content:
        raise ValueError(f"it has no {name}")
    return float(content[_plain(name)])


def _side_by_side(name: str, cameras: list[CalibratedCamera], names: list[str]) -> _CameraPair:
    """Return the pair of two cameras; their poses determine which camera is the left one."""
    if (cameras[0].T_body_cam.inverse() @ cameras[1].T_body_cam).translation[0] < 0:
        cameras, names = cameras[::-1], names[::-1]
    return _CameraPair(*rectified_cameras(name, *cameras), f"{name}, {names[0]} and {names[1]}")


def _ros(opened: _OpenedFile) -> _CameraPair:
    """Read two files of camera_calibration, or two messages of camera_info as `ros2 topic echo` prints them."""
    cameras = []
    for path in _two_files(opened, "left and right"):
        with refusing(f"calibration '{path}'"):
            cameras.append((_ros_camera(path), path))
    (left, one), (right, two) = sorted(cameras, key=lambda item: -item[0].p[3])
    return _CameraPair(left, right, f"ROS '{one.name}' and '{two.name}'")


def _ros_camera(path: Path) -> RawCamera:
    values = _named_values(path)
    names = (("camera_matrix", "k"), ("rectification_matrix", "r"), ("projection_matrix", "p"))
    k, r, p = (_numbers(values, *each) for each in names)
    model, d = str(values.get("distortionmodel", "")), _numbers(values, "distortion_coefficients", "d")
    return RawCamera(_size(values), model, d, k, r, p).checked(f"'{path}'")


def _opencv(opened: _OpenedFile) -> _CameraPair:
    values: dict[str, Any] = {"given": opened.size or ()}
    files = [opened.file, *([opened.other] if opened.other else [])]
    for file in reversed(files):
        with refusing(f"calibration '{file}'"):
            values |= _named_values(file)
    ks = [_numbers(values, f"M{n}", f"K{n}", f"cameraMatrix{n}") for n in (1, 2)]
    ds = [_numbers(values, f"D{n}", f"distCoeffs{n}", f"distortion_coefficients_{n}") for n in (1, 2)]
    told = [f"{key} {value}".lower() for key, value in values.items() if value not in (0, "0")]
    fisheye = any(re.search("fisheye|equi", text) for text in told)
    lenses, size = [_lens(d, fisheye) for d in ds], _size(values)
    text = "OpenCV " + " and ".join(f"'{file.name}'" for file in files)
    if values.keys() >= {"r1", "r2", "p1", "p2"}:
        rps = [(_numbers(values, f"R{n}"), _numbers(values, f"P{n}")) for n in (1, 2)]
        raws = (RawCamera(size, *each[:3], *each[3]) for each in zip(lenses, ds, ks, rps, strict=True))
        left, right = (raw.checked(text) for raw in raws)
        return _CameraPair(left, right, text)
    rotation, translation = (np.array(_numbers(values, name)) for name in ("R", "T"))
    poses = Transform.identity(), Transform.from_matrix(np.c_[rotation.reshape(3, 3), translation]).inverse()
    calibrated = zip(((k[0], k[4], k[2], k[5]) for k in ks), ds, poses, lenses, strict=True)
    left, right = rectified_cameras(text, *(CalibratedCamera(size, *each) for each in calibrated))
    return _CameraPair(left, right, text)


def _colmap(opened: _OpenedFile) -> _CameraPair:
    file, rig_file = opened.files
    of_rig = msgspec.convert(_content(rig_file)[0]["cameras"], list[dict[str, Any]])
    rows = [line.split() for line in read_text(file).splitlines() if line.strip() and line.strip()[0] != "#"]
    rows.sort(key=lambda row: int(row[0]))  # order by CAMERA_ID, because COLMAP writes cameras in any order
    if len(of_rig) != 2 or len(rows) not in (1, 2):
        raise ValueError(f"the first rig has {len(of_rig)} cameras and '{file.name}' {len(rows)}: two are required")
    found, names = [], []
    for row, camera in zip((rows[0], rows[-1]), of_rig, strict=True):
        lens = str(camera.get("camera_model_name", row[1]))
        if lens not in ONE_FOCAL + TWO_FOCALS:
            raise ValueError(f"camera model {lens} is not supported; supported are {', '.join(ONE_FOCAL + TWO_FOCALS)}")
        fx, *rest = map(float, camera.get("camera_params", row[4:]))
        fy, cx, cy, *d = (fx, *rest) if lens in ONE_FOCAL else rest
        d += [0.0] * (4 - len(d))
        w, x, y, z = camera.get("cam_from_rig_rotation", (1, 0, 0, 0))
        T_cam_rig = Transform.from_quat(camera.get("cam_from_rig_translation", (0, 0, 0)), (x, y, z, w))
        intrinsics = (fx, fy, cx - 0.5, cy - 0.5)  # the centre of COLMAP's first pixel is (0.5, 0.5)
        size, model = (int(row[2]), int(row[3])), _lens(d, "FISHEYE" in lens)
        found.append(CalibratedCamera(size, intrinsics, tuple(d), T_cam_rig.inverse(), model))
        names.append(str(camera.get("image_prefix", f"camera {row[0]}")))
    return _side_by_side(f"COLMAP '{file.parent.name}'", found, names)


def _has(*alternatives: str) -> Callable[[_OpenedFile], bool]:
    """Return a test whether the content has all names of one alternative, such as `T_BS intrinsics`."""
    sets = [{_plain(name) for name in names.split()} for names in alternatives]

    def is_named(opened: _OpenedFile) -> bool:
        return isinstance(opened.content, dict) and any(names <= opened.content.keys() for names in sets)

    return is_named


def _is_colmap(opened: _OpenedFile) -> bool:
    """Return whether two files have the names of COLMAP."""
    return opened.other is not None and opened.files[0].name.endswith(COLMAP_FILE)


READERS = (
    _Reader("Kalibr (cam0, cam1)", _kalibr, _has("cam0")),
    _Reader("EuRoC", _euroc, _has("T_BS intrinsics")),
    _Reader("ORB-SLAM", _orbslam, _has("LEFT.K", "Camera.fx", "Camera1.fx")),
    _Reader("OpenCV (M1, D1, M2, D2, R, T)", _opencv, _has("M1", "K1", "cameraMatrix1", "R1", "T")),
    _Reader("ROS (camera_matrix, projection_matrix)", _ros, _has("projection_matrix", "k r p")),
    _Reader("COLMAP (cameras.txt and rig_config.json)", _colmap, _is_colmap),
    _Reader("a rig.json", _rig, _has("baseline_m")),
)
"""The readers of calibrations. The first reader that recognises a file reads it."""
