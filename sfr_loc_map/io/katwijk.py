"""The layout of the Katwijk beach planetary rover data set (Hewitt et al. 2018); one part (`Traverse1/Part1`).

    LocCam/LocCam_2015_11_26_12_53_35_149_0.png   left image, named by its time (UTC); `_1.png`: the right one
    LocCam_calibstruct.mat                        calibration, here or in one of the two folders above

The calibration of the data set, `LocCam_calibration.mat`, holds an object that MATLAB alone opens; it is saved again
as a struct (`docs/formats.md`). MATLAB counts pixels from 1 and writes rotations for rows: `x2 = x1 R + t`, in
millimetres. Images are rectified here. RB is the stereo bench, DS is not given: the positions of the receiver have no
orientation, so they are no truth.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import MB, read_bytes
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_files import ImageFileSequence, ImagePair, whole_pairs
from sfr_loc_map.io.rectification import CalibratedCamera, rectified_pair
from sfr_loc_map.io.sequence import Source

FOLDER = "LocCam"
CALIBRATION, ORIGINAL = "LocCam_calibstruct.mat", "LocCam_calibration.mat"
VARIABLE = "stereoParams"
NAME = re.compile(r"LocCam_(\d{4})_(\d{2})_(\d{2})_(\d{2})_(\d{2})_(\d{2})_(\d{3})_0\.png")
NS_PER_MS = 1_000_000
MAX_MAT_BYTES, MAX_UNPACKED_BYTES = 16 * MB, 32 * MB
MAT_HEADER_BYTES = 128
MAT_COMPRESSED = 15
"""Type of an element of a MATLAB file that is compressed."""


def is_katwijk(path: Path) -> bool:
    """Tell whether a path looks like a part of a Katwijk traverse."""
    return (path / FOLDER).is_dir()


def open_katwijk(path: Path) -> Source:
    """Open a part of a traverse: the localisation cameras."""
    whole, left_out = whole_pairs(_entries(path / FOLDER), f"'{path / FOLDER}'")
    height, width = read_grey(whole[0].left).shape
    folders = (path, *list(path.resolve().parents)[:2])
    file = next((folder / CALIBRATION for folder in folders if (folder / CALIBRATION).is_file()), None)
    if file is None:
        raise InputError(
            f"'{path}' has no {CALIBRATION}, nor have the two folders above: {ORIGINAL} holds an object of MATLAB, "
            "save it again as a struct (docs/formats.md)"
        )
    rig, rectify = rectified_pair(f"'{file}'", *load_cameras(file, (width, height)))
    rig = replace(rig, T_rb_sb=Transform.identity())
    return Source(path, "katwijk", ImageFileSequence(rig, whole, None, rectify), None, left_out)


def _entries(folder: Path) -> list[ImagePair]:
    entries = []
    for file in sorted(folder.glob("*_0.png")):
        match = NAME.fullmatch(file.name)
        try:
            if match is None:
                raise ValueError("its name has another form")
            *parts, milliseconds = (int(part) for part in match.groups())
            seconds = int(datetime(*parts, tzinfo=UTC).timestamp())  # type: ignore[misc, arg-type]
        except ValueError as error:
            raise InputError(f"'{file}': {error}; LocCam_YYYY_MM_DD_hh_mm_ss_mmm_0.png is needed") from error
        stamp = (seconds * 1000 + milliseconds) * NS_PER_MS
        entries.append(ImagePair(stamp, file, file.with_name(f"{file.name.removesuffix('_0.png')}_1.png")))
    if not entries:
        raise InputError(f"'{folder}' has no left image LocCam_*_0.png")
    return entries


def load_cameras(file: Path, size: tuple[int, int]) -> tuple[CalibratedCamera, CalibratedCamera]:
    """Read the left and the right camera of a calibration, for images of a size (width, height)."""
    content, where = _load_struct(file), f"'{file}'"
    rotation = _array(content, "RotationOfCamera2", (3, 3), where)
    shift = 1e-3 * _array(content, "TranslationOfCamera2", (3,), where)
    try:
        check_extrinsics(shift)
        T_right_left = Transform(rotation.T, shift)
        left, right = (
            _camera(content.get(f"CameraParameters{number}"), size, pose, f"{where} camera {number}")
            for number, pose in ((1, Transform.identity()), (2, T_right_left.inverse()))
        )
    except GeometryError as error:
        raise InputError(f"{where}: {error}; correct the file") from error
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
    try:
        values = np.asarray(content[name], np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where} has no numbers '{name}': save the calibration again (docs/formats.md)") from error
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
