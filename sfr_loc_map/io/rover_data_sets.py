"""Layouts of rover data sets: MADMAX (Meyer et al. 2021), Katwijk beach (Hewitt et al. 2018), LuSNAR (Liu et al. 2024).

`docs/formats.md` describes their files. The calibration of Katwijk is MATLAB's, which counts pixels from 1 and writes
rotations for rows: `x2 = x1 R + t`, in millimetres. Of LuSNAR the cameras stand here, as they have no file.
"""

from __future__ import annotations

import io
import logging
import re
import struct
import zlib
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import MB, SIDES, parse_yaml, read_bytes, refusing
from sfr_loc_map.io.camera_info import rig_from_projections
from sfr_loc_map.io.euroc import load_body_truth
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_files import ImageFileSequence, ImagePair, pairs_of, stamped_files, whole_pairs
from sfr_loc_map.io.rectification import CalibratedCamera, rectified_pair
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.text_table import check_order, numbers_of, parse_seconds, parse_table, read_data, read_lines

_log = logging.getLogger(__name__)
LEFT, RIGHT = "rect_left", "rect_right"
TRUTH_FOLDER, TRUTH_FILE = "ground_truth", "gt_6DoF_gnss_and_imu.csv"
TRUTH_COLUMNS = ("UNIX time", "x-enu(m)", "y-enu(m)", "z-enu(m)", *(f"orientation.{name}" for name in "xyzw"))
CALIBRATIONS = ("calibration", "calibration/calibration", "../calibration", "../calibration/calibration")
CAMERA = "camera_rect_{side}_info.txt"
BETWEEN, TO_LEFT, TO_BODY = "tf__camera_left_to_camera_right.csv", "tf__imu_to_camera_left.csv", "tf__imu_to_B.csv"
BASELINE_SHARE = 0.05
"""Most that the distance of the cameras by their poses may differ from the baseline of the rectified images."""
KATWIJK_FOLDER = "LocCam"
KATWIJK_CALIBRATION, ORIGINAL = "LocCam_calibstruct.mat", "LocCam_calibration.mat"
VARIABLE = "stereoParams"
KATWIJK_NAME = re.compile(r"LocCam_(\d{4})_(\d{2})_(\d{2})_(\d{2})_(\d{2})_(\d{2})_(\d{3})_0\.png")
MAX_MAT_BYTES, MAX_UNPACKED_BYTES = 16 * MB, 32 * MB
MAT_HEADER_BYTES = 128
MAT_COMPRESSED = 15  #: Type of an element of a MATLAB file that is compressed.
LUSNAR_LAYOUTS = (("image0/color", "image1/color"), ("image1/RGB", "image2/RGB"))
"""Folders of the left and right images: of the scenes, of their description."""
LUSNAR_TRUTHS = ("gt.txt", "Rover_pose.txt")
SIDE_PX, FOCAL_PX, BASELINE_M = 1024, 610.17784, 0.31
CENTRE_PX = (SIDE_PX - 1) / 2
"""The published centre 512 counts from the corner of the first pixel, this one from its centre."""
LEFT_ON_ROVER_M = (1.0, -0.155, -1.5)
PITCH_DEG = -20.0  #: Place and pitch of the left camera in the rover frame, z down.
FLIP = Transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""Turns a frame with y right and z down to one with y left and z up, and back."""


def is_madmax(path: Path) -> bool:
    """Tell whether a path looks like a MADMAX run."""
    return path.is_dir() and len(_madmax_folders(path)) == 2


def open_madmax(path: Path) -> Source:
    """Open a MADMAX run."""
    left, right = _madmax_folders(path)
    lefts, rights = stamped_files(left, "img_rect_left_", ".png"), stamped_files(right, "img_rect_right_", ".png")
    whole, _ = whole_pairs(pairs_of(lefts, rights, f"'{path}'"), f"'{path}'")
    single = len(lefts.keys() ^ rights.keys())
    if single:
        _log.warning("'%s': %d images without the other side left out", path, single)
    height, width = read_grey(whole[0].left).shape
    folders = (path / name for name in CALIBRATIONS)
    folder = next((item for item in folders if (item / CAMERA.format(side="left")).is_file()), None)
    if folder is None:
        raise InputError(f"'{path}' has no calibration/{CAMERA.format(side='left')}, in it or beside it")
    (p_left, turn), (p_right, _) = (_projection(folder / CAMERA.format(side=side)) for side in SIDES)
    rig = rig_from_projections(p_left, p_right, (width, height), f"'{folder}'")
    rig = replace(rig, T_rb_sb=_madmax_extrinsics(folder, rig, turn))
    return Source(path, "madmax", ImageFileSequence(rig, whole, _madmax_truth(path)), None, single)


def _madmax_folders(path: Path) -> list[Path]:
    """Return the folders of the left and right images, as far as they are there."""
    found = (sorted(item for item in path.glob(f"*{name}") if item.is_dir()) for name in (LEFT, RIGHT))
    return [items[0] for items in found if items]


class _CameraYaml(msgspec.Struct):
    P: Annotated[list[float], msgspec.Meta(min_length=12, max_length=12)]
    R: Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)] | None = None


def _projection(file: Path) -> tuple[FloatArray, FloatArray]:
    """Return P `(12,)` and R `(3, 3)` of a camera_info; without R the identity."""
    with refusing(f"'{file}' is no camera_info with P"):
        content = parse_yaml("\n".join(line for line in read_lines(file) if line.strip() != "---"))
        camera = msgspec.convert(content, _CameraYaml, strict=False)  # YAML takes 1e-5 for a text
    return np.array(camera.P), np.reshape(camera.R or np.eye(3), (3, 3))


def _madmax_extrinsics(folder: Path, rig: StereoRig, turn: FloatArray) -> Transform | None:
    """Return `T_rb_sb`, None without the files for it; `turn` takes the left camera to the rectified one."""
    files = [folder / name for name in (BETWEEN, TO_LEFT, TO_BODY)]
    if not all(file.is_file() for file in files):
        return None
    between, to_left, to_body = (_madmax_pose(file) for file in files)
    across = float(between.translation[0])
    if not abs(abs(across) - rig.baseline_m) <= BASELINE_SHARE * rig.baseline_m:
        raise InputError(
            f"'{files[0]}': the cameras are {across:g} m apart along x, by P {rig.baseline_m:g} m; correct the file"
        )
    if across < 0.0:  # the files hold the pose of the first frame in the second
        to_left, to_body = to_left.inverse(), to_body.inverse()
    with refusing(f"'{folder}'", "correct the files tf__*.csv or R"):
        T_imu_left = to_left @ Transform(turn, np.zeros(3)).inverse()
        T_rb_sb = to_body.inverse() @ T_imu_left @ rig.T_sb_left.inverse()
        return Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw)


def _madmax_pose(file: Path) -> Transform:
    """Return the transform of a file: a header `#position.x, ..., orientation.w` and a line of numbers."""
    rows = read_lines(file)
    values = numbers_of((rows or [""])[0].replace(",", " ").split(), 7, f"'{file}'")
    with refusing(f"'{file}'"):
        return Transform.from_quat(values[:3], values[3:])


def _madmax_truth(path: Path) -> Trajectory | None:
    """Return the poses in a folder that ends in `ground_truth`, in the run or in a folder of it, None without it."""
    folders = [path, *(item for item in sorted(path.iterdir()) if item.is_dir())]
    places = (place / TRUTH_FILE for folder in folders for place in sorted(folder.glob(f"*{TRUTH_FOLDER}")))
    file = next((file for file in places if file.is_file()), None)
    if file is None:
        return None
    heads = [line for line in read_lines(file) if line.startswith("%") and TRUTH_COLUMNS[0] in line]
    names = [name.strip(" %\t") for name in heads[-1].split(",")] if heads else []
    missing = [name for name in TRUTH_COLUMNS if name not in names]
    if missing:
        raise InputError(f"'{file}' has no column {', '.join(missing)}: a line '% {TRUTH_COLUMNS[0]}, ...' names them")
    places_of = [names.index(name) for name in TRUTH_COLUMNS]
    form, data = ", ".join(names), read_data(file)
    table = parse_table(
        data, f"'{file}'", form, places_of, stamp=parse_seconds, separator=",", more=True, comment=(b"%", b"#")
    )
    check_order(table.stamps_ns, f"'{file}'", strict=False)
    return table.trajectory(table.values[:, :3], table.values[:, 3:]) if len(table.lines) else None


def is_katwijk(path: Path) -> bool:
    """Tell whether a path looks like a part of a Katwijk traverse."""
    return (path / KATWIJK_FOLDER).is_dir()


def open_katwijk(path: Path) -> Source:
    """Open a part of a traverse: the localisation cameras."""
    entries = []
    for image in sorted((path / KATWIJK_FOLDER).glob("*_0.png")):
        match = KATWIJK_NAME.fullmatch(image.name)
        with refusing(f"'{image}'", "LocCam_YYYY_MM_DD_hh_mm_ss_mmm_0.png is needed"):
            if match is None:
                raise ValueError("its name has another form")
            *parts, milliseconds = (int(part) for part in match.groups())
            seconds = int(datetime(*parts, tzinfo=UTC).timestamp())  # type: ignore[misc, arg-type]
        stamp = (seconds * 1000 + milliseconds) * 1_000_000
        entries.append(ImagePair(stamp, image, image.with_name(f"{image.name.removesuffix('_0.png')}_1.png")))
    if not entries:
        raise InputError(f"'{path / KATWIJK_FOLDER}' has no left image LocCam_*_0.png")
    whole, left_out = whole_pairs(entries, f"'{path / KATWIJK_FOLDER}'")
    height, width = read_grey(whole[0].left).shape
    folders = (path, *list(path.resolve().parents)[:2])
    file = next((folder / KATWIJK_CALIBRATION for folder in folders if (folder / KATWIJK_CALIBRATION).is_file()), None)
    if file is None:
        raise InputError(
            f"'{path}' has no {KATWIJK_CALIBRATION}, nor have the two folders above: {ORIGINAL} holds an object of "
            "MATLAB, save it again as a struct (docs/formats.md)"
        )
    rig, rectify = rectified_pair(f"'{file}'", *load_cameras(file, (width, height)))
    rig = replace(rig, T_rb_sb=Transform.identity())
    return Source(path, "katwijk", ImageFileSequence(rig, whole, None, rectify), None, left_out)


def load_cameras(file: Path, size: tuple[int, int]) -> tuple[CalibratedCamera, CalibratedCamera]:
    """Read the left and the right camera of a calibration, for images of a size (width, height)."""
    content, where = _load_struct(file), f"'{file}'"
    rotation = _array(content, "RotationOfCamera2", (3, 3), where)
    shift = 1e-3 * _array(content, "TranslationOfCamera2", (3,), where)
    with refusing(where):
        check_extrinsics(shift)
        T_right_left = Transform(rotation.T, shift)
        left, right = (
            _camera(content.get(f"CameraParameters{number}"), size, pose, f"{where} camera {number}")
            for number, pose in ((1, Transform.identity()), (2, T_right_left.inverse()))
        )
    return left, right


def _camera(content: Any, size: tuple[int, int], pose: Transform, where: str) -> CalibratedCamera:  # noqa: ANN401
    if not isinstance(content, dict):
        raise InputError(f"{where} is no struct: save the calibration again (docs/formats.md)")
    name = next((name for name in ("IntrinsicMatrixInternal", "IntrinsicMatrix", "K") if name in content), "K")
    k = _array(content, name, (3, 3), where)
    k = k.T.copy() if k[2, 0] or k[2, 1] else k.copy()  # for columns, whichever way it was written
    k[:2, 2] -= 1.0  # the first pixel of MATLAB is 1, 1
    radial = _array(content, "RadialDistortion", None, where)
    tangential = _array(content, "TangentialDistortion", (2,), where)
    if radial.ndim != 1 or len(radial) not in (2, 3):
        raise InputError(f"{where}: RadialDistortion has the shape {radial.shape}: 2 or 3 numbers are needed")
    distortion = np.concatenate((radial[:2], tangential, radial[2:]))
    check_camera(size, (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2])))
    check_distortion(distortion.tolist())
    return CalibratedCamera(size, k, distortion, pose)


def _array(content: dict[str, Any], name: str, shape: tuple[int, ...] | None, where: str) -> FloatArray:
    with refusing(f"{where} has no numbers '{name}'", "save the calibration again (docs/formats.md)"):
        values = np.asarray(content[name], np.float64)
    if (shape is not None and values.shape != shape) or not np.isfinite(values).all():
        raise InputError(f"{where}: '{name}' has the shape {values.shape} or is not finite: {shape} is needed")
    return values


def _load_struct(path: Path) -> dict[str, Any]:
    """Return the fields of the struct of a MATLAB file (version 5 to 7), structs within it as the same."""
    from scipy.io import loadmat  # a fifth of a second that no other source needs

    try:
        data = io.BytesIO(_unpacked(read_bytes(path, MAX_MAT_BYTES)))
        content: dict[str, Any] = loadmat(data, variable_names=[VARIABLE], simplify_cells=True)  # type: ignore[arg-type]
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}; a .mat file is needed") from error
    except MemoryError:
        raise
    except Exception as error:  # of the library for broken data: of many kinds
        text = " ".join(str(error).split())[:200]
        raise InputError(f"'{path}' cannot be read as a .mat file (version 5 to 7): {text}") from error
    value = content.get(VARIABLE)
    if not isinstance(value, dict):
        raise InputError(f"'{path}' has no struct '{VARIABLE}': save it again as a struct (docs/formats.md)")
    return value


def _unpacked(data: bytes) -> bytes:
    """Return a MATLAB file of the same elements, none of them compressed, so that what they become is bounded.

    Form of the file: "MAT-File Format", The MathWorks, chapter 1.
    """
    if len(data) < MAT_HEADER_BYTES or data[126:128] != b"IM" or data[125] != 1:
        raise ValueError("it has no header of a little-endian file of version 5")
    parts, offset, left = [data[:MAT_HEADER_BYTES]], MAT_HEADER_BYTES, MAX_UNPACKED_BYTES
    while offset + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, offset)
        body = data[offset + 8 : offset + 8 + size]
        if kind == MAT_COMPRESSED:
            decompressor = zlib.decompressobj()
            part = decompressor.decompress(body, left + 1)
            if not decompressor.eof and len(part) <= left:
                raise ValueError("a compressed part is cut off")
        else:
            part = data[offset : offset + 8 + size]
        left -= len(part)
        if left < 0:
            raise ValueError(f"it holds more than {MAX_UNPACKED_BYTES} bytes")
        parts.append(part)
        offset += 8 + size
    return b"".join(parts)


def is_lusnar(path: Path) -> bool:
    """Tell whether a path looks like a LuSNAR scene."""
    return any(left.is_dir() and right.is_dir() for left, right in _lusnar_folders(path))


def open_lusnar(path: Path) -> Source:
    """Open a LuSNAR scene."""
    left, right = next(pair for pair in _lusnar_folders(path) if pair[0].is_dir() and pair[1].is_dir())
    stamps = stamped_files(left, "", ".png")
    entries = [ImagePair(stamp, file, right / file.name) for stamp, file in stamps.items()]
    whole, left_out = whole_pairs(entries, f"'{left}'")
    height, width = read_grey(whole[0].left).shape
    if (width, height) != (SIDE_PX, SIDE_PX):
        raise InputError(
            f"image '{whole[0].left}' is {width} x {height}: the published cameras of LuSNAR have {SIDE_PX} x {SIDE_PX}"
        )
    pitch = np.radians(PITCH_DEG)
    axes = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # of the camera, in x forward, y right, z down
    tilt = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    T_rover_left = Transform(tilt @ axes, np.array(LEFT_ON_ROVER_M))
    rig = StereoRig(SIDE_PX, SIDE_PX, FOCAL_PX, FOCAL_PX, CENTRE_PX, CENTRE_PX, BASELINE_M)
    rig = replace(rig, T_rb_sb=FLIP @ T_rover_left @ rig.T_sb_left.inverse())
    file = next((path / name for name in LUSNAR_TRUTHS if (path / name).is_file()), None)
    truth = load_body_truth(file) if file is not None else None
    if truth is not None:
        stamps_ns = truth.stamps_ns.tolist()
        truth = Trajectory.from_poses((stamp, FLIP @ truth.pose(i) @ FLIP) for i, stamp in enumerate(stamps_ns))
    return Source(path, "lusnar", ImageFileSequence(rig, whole, truth), None, left_out)


def _lusnar_folders(path: Path) -> list[tuple[Path, Path]]:
    return [(path / left, path / right) for left, right in LUSNAR_LAYOUTS]
