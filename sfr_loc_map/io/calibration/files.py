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

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES, parse_yaml, read_text, refusing
from sfr_loc_map.io.calibration.camera_info import projection, rig_from_projections
from sfr_loc_map.io.calibration.rectification import (
    CalibratedCamera,
    RawCamera,
    StereoRectifier,
    rectified_cameras,
    rectified_rig,
    rig_of_rectified,
)
from sfr_loc_map.io.calibration.rig_file import read_rig

ENDINGS = (".yaml", ".yml", ".xml", ".json", ".txt")
PARTNERS = (("left", "right"), ("cam0", "cam1"), ("intrinsics", "extrinsics"), ("cameras.txt", "rig_config.json"))
"""Words in which the names of the two files of a calibration, or of their folders, differ."""
LARGEST_BASELINE_M = 5.0  #: Largest baseline, m; larger numbers are in millimetres.
ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")
"""Models of COLMAP by number of focal lengths; principal point and distortion in OpenCV's order follow."""
Cameras = tuple[RawCamera, RawCamera]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The calibration of a stereo pair."""

    infos: tuple[Any, Any]  #: Left and right, with the fields of a sensor_msgs/CameraInfo.
    is_rectified: bool  #: Whether the images are rectified; `infos` are then those of a rectified pair.
    T_rb_sb: Transform | None  #: Pose of the rig in RB, if the file has it.
    text: str  #: Description for messages: `Kalibr 'camchain.yaml', cam0 and cam1`.

    def rig(self, name: str) -> tuple[StereoRig, StereoRectifier | None]:
        """Return the rectified rig (`loc` or `nav`) and its rectifier; None if the images are rectified."""
        if self.is_rectified:
            return rig_of_rectified(self.infos, name)
        return rectified_rig(self.infos, name)


def read_calibration(path: Path, size: tuple[int, int] | None = None) -> Calibration:
    """Read a calibration from a file or a folder; `size`: width and height of the images, if known.

    InputError if it is not a calibration, is corrupt, is not of a side-by-side pair, or is of another image size.
    """
    where, T_rb_sb = f"calibration '{path}'", None
    with naming(path), refusing(where):
        file = _only_file(path) if path.is_dir() else path
        content, other = _content(file), _partner(file)
        keys = set(content) if isinstance(content, dict) else set()
        if "baselinem" in keys:
            rig = read_rig(file)
            k, r = (tuple(m.reshape(-1).tolist()) for m in (rig.camera_matrix, np.eye(3)))
            ps = (tuple(projection(rig, side).tolist()) for side in SIDES)
            left, right = (RawCamera((rig.width, rig.height), "plumb_bob", (0.0,) * 5, k, r, p) for p in ps)
            T_rb_sb, text = rig.T_rb_sb, f"rig '{file.name}'"
        elif "cam0" in keys:
            (left, right), text = _kalibr(file, content)
        elif {"tbs", "intrinsics"} <= keys:
            (left, right), text = _euroc(file, other)
        elif keys & {"left.k", "camera.fx", "camera1.fx"}:
            (left, right), text = _orbslam(file, content, size)
        elif "projectionmatrix" in keys:
            (left, right), text = _ros(file, other)
        elif keys & {"m1", "k1", "cameramatrix1", "r1", "t"}:
            (left, right), text = _opencv([file, *([other] if other else [])], size)
        elif other and not keys and isinstance(rigs := _content(max(file.absolute(), other)), list):
            of_rig = msgspec.convert(rigs[0]["cameras"], list[dict[str, Any]])
            (left, right), text = _colmap(min(file.absolute(), other), of_rig)
        else:
            found = ", ".join(sorted(keys)[:8]) or "none of these names"
            raise InputError(
                f"{where}: a file of Kalibr (cam0, cam1), EuRoC, ORB-SLAM, OpenCV (M1, D1, M2, D2, R, T), ROS "
                f"(camera_matrix, projection_matrix), COLMAP (cameras.txt and rig_config.json) or a rig.json is "
                f"required, it has {found}"
            )
    if len(sizes := {left.size, right.size, size or left.size}) > 1:
        found = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise InputError(f"{where} and the images differ in size, {found} px: calibrate both cameras at the image size")
    rig = rig_from_projections(np.array(left.p), np.array(right.p), left.size, where)
    if rig.baseline_m > LARGEST_BASELINE_M:
        raise InputError(f"{where}: the baseline is {rig.baseline_m:g} m: give it in metres")
    return Calibration((left.info, right.info), left.is_rectified and right.is_rectified, T_rb_sb, text)


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
    """Return the content of YAML, JSON or OpenCV's XML; top-level names are in lower case without underscores."""
    text = read_text(file).strip()
    if text.startswith("<"):
        if "<!" in text.replace("<!--", ""):
            raise ValueError("XML with declarations is not supported")
        root = ET.fromstring(text)
        content = {item.tag: {part.tag: part.text for part in item} if len(item) else item.text for item in root}
    else:  # JSON is YAML, except for tabs
        content = parse_opencv_yaml(text)
    plain = {str(key).lower().replace("_", ""): item for key, item in content.items()} if type(content) is dict else {}
    return plain or content


def parse_opencv_yaml(text: str) -> Any:  # noqa: ANN401 - any YAML
    """Return the value of a YAML text as cv::FileStorage reads it: `%YAML:1.0`, `data:[`, tags and tabs."""
    text = re.sub(r"^%.*$|!!opencv-\S+|\t", " ", text, flags=re.MULTILINE)
    return parse_yaml(re.sub(r"^(\s*[A-Za-z][\w.]*):(?=[\[\d.+-])", r"\1: ", text, flags=re.MULTILINE))


def _numbers(content: Mapping[str, Any], *names: str) -> tuple[float, ...]:
    """Return the numbers, row by row, of the first matrix of `names` in the content; ValueError if there is none."""
    name = next((name for name in names if name in content), None)
    if name is None:
        raise ValueError(f"it has no {' or '.join(names)}")
    value = content[name]["data"] if isinstance(content[name], dict) else content[name]
    return tuple(np.array(value.split() if isinstance(value, str) else value, np.float64).reshape(-1).tolist())


def _size(content: Mapping[str, Any]) -> tuple[int, int]:
    """Return the width and height of the images, in the file or `given`; ValueError if unknown."""
    names = ("imagesize", "imagewidth", "width", "imageheight", "height", "given")
    found = [number for name in names if name in content for number in _numbers(content, name)]
    if len(found) < 2:
        raise ValueError("it has no image_width and image_height")
    return int(found[0]), int(found[1])


def _lens(d: Sequence[float], fisheye: bool) -> str:
    return "equidistant" if fisheye else "plumb_bob" if len(d) <= 5 else "rational_polynomial"


class _KalibrCamera(msgspec.Struct):
    camera_model: Literal["pinhole"]
    intrinsics: tuple[float, float, float, float]
    distortion_model: Literal["radtan", "equidistant", "equi", "none"]
    distortion_coeffs: tuple[float, ...]
    resolution: tuple[int, int]
    T_cn_cnm1: list[list[float]] | None = None
    T_cam_imu: list[list[float]] | None = None
    T_imu_cam: list[list[float]] | None = None

    def pose_in_imu(self) -> Transform | None:
        """Return the pose of the camera in the IMU; None if the file does not give it."""
        if self.T_imu_cam is not None:
            return _matrix(self.T_imu_cam)
        return None if self.T_cam_imu is None else _matrix(self.T_cam_imu).inverse()


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


def _kalibr(file: Path, content: dict[str, Any]) -> tuple[Cameras, str]:
    if "cam1" not in content:
        raise ValueError("it has only cam0: a stereo pair needs cam0 and cam1")
    one, other = (msgspec.convert(content.get(name), _KalibrCamera, strict=False) for name in ("cam0", "cam1"))
    T_cam0_cam1 = _pose_of_right(one, other)
    cameras = []
    for camera, pose in ((one, Transform.identity()), (other, T_cam0_cam1)):
        d = camera.distortion_coeffs or (0.0,) * 4
        lens = _lens(d, camera.distortion_model.startswith("equi"))
        cameras.append(CalibratedCamera(camera.resolution, camera.intrinsics, d, pose, lens))
    return _side_by_side(f"Kalibr '{file.name}'", cameras, ["cam0", "cam1"])


class _SensorPose(msgspec.Struct):
    data: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class _SensorYaml(msgspec.Struct):
    T_BS: _SensorPose
    resolution: tuple[int, int]
    camera_model: Literal["pinhole"]
    intrinsics: tuple[float, float, float, float]
    distortion_model: Literal["radial-tangential", "radtan", "plumb_bob", "equidistant", "equi", "none"]
    distortion_coefficients: Annotated[tuple[float, ...], msgspec.Meta(max_length=8)] = (0.0,) * 4


def read_sensor_yaml(path: Path) -> CalibratedCamera:
    """Read the sensor.yaml of an EuRoC camera."""
    with refusing(f"'{path}' is not a sensor.yaml of an EuRoC camera"):
        content = parse_opencv_yaml(read_text(path))
        camera = msgspec.convert(content, _SensorYaml, strict=False)  # YAML reads 1e-5 as text
        pose = Transform.from_matrix(np.array(camera.T_BS.data).reshape(4, 4))
        d = camera.distortion_coefficients or (0.0,) * 4
        lens = _lens(d, camera.distortion_model.startswith("equi"))
        return CalibratedCamera(camera.resolution, camera.intrinsics, d, pose, lens)


def _euroc(file: Path, other: Path | None) -> tuple[Cameras, str]:
    if other is None:
        raise InputError(
            f"calibration '{file}' has one camera: add the file of the other camera beside it, named as cam0 and cam1"
        )
    files = sorted((file.absolute(), other))
    cameras = [read_sensor_yaml(path) for path in files]
    return _side_by_side("EuRoC", cameras, [f"'{path.parent.name}/{path.name}'" for path in files])


def _orbslam(file: Path, content: Mapping[str, Any], size: tuple[int, int] | None) -> tuple[Cameras, str]:
    """Read the settings of ORB-SLAM: LEFT.K, RIGHT.K, ... or two cameras for raw images, one camera for rectified ones.

    Two raw cameras are given by Camera1, Camera2 and Stereo.T_c1_c2, in older files by Camera, Camera2 and Tlr. One
    camera with Camera.bf or Stereo.b is that of rectified images without distortion.
    """
    text = f"ORB-SLAM '{file.name}'"
    if "left.k" in content:
        raws = []
        for side in SIDES:
            k, d, r, p = (_numbers(content, f"{side}.{name}") for name in "kdrp")
            size = (int(content[f"{side}.width"]), int(content[f"{side}.height"]))
            raws.append(RawCamera.of(text, RawCamera(size, _lens(d, False), d, k, r, p).info))
        return (raws[0], raws[1]), f"{text}, LEFT and RIGHT"
    if size is None or "camera.width" in content:
        size = (int(_one(content, "camera.width")), int(_one(content, "camera.height")))
    first = "camera1" if "camera1.fx" in content else "camera"
    fisheye = "kannala" in str(content.get("camera.type", "")).lower()
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if "camera2.fx" in content:
        pose = np.eye(4)
        pose[:3] = np.array(_numbers(content, "stereo.tc1c2", "tlr")[:12]).reshape(3, 4)
        cameras = []
        for name, T_left in ((first, Transform.identity()), ("camera2", Transform.from_matrix(pose))):
            d = tuple(float(content.get(f"{name}.{item}", 0.0)) for item in names)
            fx, fy, cx, cy = (_one(content, f"{name}.{item}") for item in ("fx", "fy", "cx", "cy"))
            cameras.append(CalibratedCamera(size, (fx, fy, cx, cy), d, T_left, _lens(d, fisheye)))
        return rectified_cameras(text, *cameras), f"{text}, {first.capitalize()} and Camera2"
    if fisheye or any(float(content.get(f"{first}.{item}", 0.0)) for item in names):
        raise ValueError(
            f"{first.capitalize()} has a distortion but there is no Camera2: the settings are of one raw camera, not "
            "of a stereo pair; give the calibration of both cameras"
        )
    fx, fy, cx, cy = (_one(content, f"{first}.{item}") for item in ("fx", "fy", "cx", "cy"))
    baseline = content.get("stereo.b")
    shift = fx * float(baseline) if baseline is not None else _one(content, "camera.bf")
    k = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    r = tuple(np.eye(3).reshape(-1).tolist())
    ps = [(fx, 0.0, cx, -move, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0) for move in (0.0, shift)]
    left, right = (RawCamera(size, "plumb_bob", (0.0,) * 5, k, r, p) for p in ps)
    return (left, right), f"{text}, rectified"


def _one(content: Mapping[str, Any], name: str) -> float:
    if name not in content:
        raise ValueError(f"it has no {name}")
    return float(content[name])


def _side_by_side(name: str, cameras: list[CalibratedCamera], names: list[str]) -> tuple[Cameras, str]:
    """Return the pair of two cameras; their poses determine which camera is the left one."""
    if (cameras[0].T_body_cam.inverse() @ cameras[1].T_body_cam).translation[0] < 0:
        cameras, names = cameras[::-1], names[::-1]
    return rectified_cameras(name, *cameras), f"{name}, {names[0]} and {names[1]}"


def _ros(file: Path, other: Path | None) -> tuple[Cameras, str]:
    if other is None:
        raise InputError(
            f"calibration '{file}' has one camera: add the file of the other camera beside it, named as left and right"
        )
    found = []
    for path in (file, other):
        values = _content(path)
        k, r, p = (_numbers(values, f"{name}matrix") for name in ("camera", "rectification", "projection"))
        model, d = str(values.get("distortionmodel", "")), _numbers(values, "distortioncoefficients")
        found.append((RawCamera.of(f"'{path}'", RawCamera(_size(values), model, d, k, r, p).info), path))
    (left, one), (right, two) = sorted(found, key=lambda item: -item[0].p[3])
    return (left, right), f"ROS '{one.name}' and '{two.name}'"


def _opencv(files: list[Path], size: tuple[int, int] | None) -> tuple[Cameras, str]:
    values: dict[str, Any] = {"given": size or ()}
    for file in reversed(files):
        values |= _content(file)
    ks = [_numbers(values, f"m{n}", f"k{n}", f"cameramatrix{n}") for n in (1, 2)]
    ds = [_numbers(values, f"d{n}", f"distcoeffs{n}", f"distortioncoefficients{n}") for n in (1, 2)]
    told = [f"{key} {value}".lower() for key, value in values.items() if value not in (0, "0")]
    fisheye = any(re.search("fisheye|equi", text) for text in told)
    lenses, size = [_lens(d, fisheye) for d in ds], _size(values)
    text = "OpenCV " + " and ".join(f"'{file.name}'" for file in files)
    if values.keys() >= {"r1", "r2", "p1", "p2"}:
        rps = [(_numbers(values, f"r{n}"), _numbers(values, f"p{n}")) for n in (1, 2)]
        raws = (RawCamera(size, *each[:3], *each[3]) for each in zip(lenses, ds, ks, rps, strict=True))
        left, right = (RawCamera.of(text, raw.info) for raw in raws)
        return (left, right), text
    rotation, translation = (np.array(_numbers(values, name)) for name in ("r", "t"))
    poses = Transform.identity(), Transform.from_matrix(np.c_[rotation.reshape(3, 3), translation]).inverse()
    calibrated = zip(((k[0], k[4], k[2], k[5]) for k in ks), ds, poses, lenses, strict=True)
    return rectified_cameras(text, *(CalibratedCamera(size, *each) for each in calibrated)), text


def _colmap(file: Path, of_rig: list[dict[str, Any]]) -> tuple[Cameras, str]:
    rows = [line.split() for line in read_text(file).splitlines() if line.strip() and line.strip()[0] != "#"]
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
