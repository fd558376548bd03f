"""The calibration of a stereo pair from files of other programs or of the suite, detected from the content.

Each program has a reader in `programs`. If a calibration has two files, the second is found by its name
(`opened_file.PARTNERS`). A folder with one calibration is accepted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.inputs import check_exists, refusing
from sfr_loc_map.io.calibration.opened_file import OpenedFile, is_colmap_list, open_calibration, partner_of, plain_name
from sfr_loc_map.io.calibration.programs.colmap import read_colmap
from sfr_loc_map.io.calibration.programs.euroc import read_euroc
from sfr_loc_map.io.calibration.programs.kalibr import read_kalibr
from sfr_loc_map.io.calibration.programs.opencv import read_opencv
from sfr_loc_map.io.calibration.programs.orb_slam import read_orb_slam
from sfr_loc_map.io.calibration.programs.ros import read_ros
from sfr_loc_map.io.calibration.projections import projection, with_baseline
from sfr_loc_map.io.calibration.rectification import RectifiableCamera
from sfr_loc_map.io.calibration.rig_file import read_rig
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, StereoCalibration, calibrated
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import SIDES

ENDINGS = (".yaml", ".yml", ".xml", ".json", ".txt")


class CalibrationError(InputError):
    """A calibration file cannot be used."""


def read_calibration(path: Path, size: tuple[int, int] | None = None, baseline_m: float = 0.0) -> StereoCalibration:
    """Read a calibration from a file or a folder.

    `size`: width and height of the images, if known. `baseline_m`: baseline of the configuration, m; 0: that of the
    file. CalibrationError if the file is not a calibration, is corrupt, does not describe a side-by-side pair, or has
    another image size or another baseline.
    """
    where = f"calibration '{path}'"
    try:
        pair = _cameras_in(path, size, where)
        if baseline_m:
            p_right = with_baseline(pair.left.p, pair.right.p, baseline_m, pair.text)
            pair = pair._replace(right=replace(pair.right, p=tuple(p_right.tolist())))
        return calibrated(pair, where)
    except InputError as error:
        raise CalibrationError(error.finding, error.advice) from error


def _cameras_in(path: Path, size: tuple[int, int] | None, where: str) -> CameraPair:
    """Return the cameras in a file or a folder; InputError unless both have the size of the images."""
    check_exists(path, "give a calibration file, or a folder that contains one")
    with naming(path), refusing(where):
        opened = open_calibration(_only_file(path) if path.is_dir() else path, size)
        reader = next((reader for reader in READERS if reader.recognises(opened)), None)
        if reader is None:
            *known, last = (reader.shown for reader in READERS)
            found = ", ".join(opened.shown_names[:8]) or "no known structure"
            raise InputError(f"{where}: the file has {found};", f"a file of {', '.join(known)} or {last} is required")
        pair = reader.read(opened)
    if len(sizes := {pair.left.size, pair.right.size, size or pair.left.size}) > 1:
        shown = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise InputError(
            f"{where} and the images differ in size, {shown} px:", "calibrate both cameras at the image size"
        )
    return pair


def _only_file(folder: Path) -> Path:
    """Return the only calibration file in a folder, or the first file if the calibration has two."""
    files = [*folder.absolute().glob("*.*"), *folder.absolute().glob("*/*.*")]
    files = sorted(file for file in files if suffix_of(file) in ENDINGS)
    calibrations = [file for file in files if (other := partner_of(file)) and file < other] or files
    if len(calibrations) != 1:
        names = (
            ", ".join(str(file.relative_to(folder.absolute())) for file in calibrations[:8]) or "no calibration file"
        )
        raise InputError(f"calibration '{folder}': the folder has {names};", "give the path of one calibration file")
    return calibrations[0]


# ---- programs


class ProgramReader(NamedTuple):
    """The reader of the files of a program, and how they are recognised."""

    shown: str  #: Program, with names in its files or of its files, for messages.
    read: Callable[[OpenedFile], CameraPair]
    recognises: Callable[[OpenedFile], bool]  #: Whether a file belongs to this program.


def _has(*alternatives: str) -> Callable[[OpenedFile], bool]:
    """Return a test whether the content has all names of one alternative, such as `T_BS intrinsics`."""
    sets = [{plain_name(name) for name in names.split()} for names in alternatives]

    def is_named(opened: OpenedFile) -> bool:
        return isinstance(opened.content, dict) and any(names <= opened.content.keys() for names in sets)

    return is_named


def _is_colmap(opened: OpenedFile) -> bool:
    """Return whether a calibration consists of COLMAP's two files, judged by their names."""
    return opened.other is not None and is_colmap_list(opened.files[0])


def _read_rig_json(opened: OpenedFile) -> CameraPair:
    """Read the rig.json of a data set."""
    rig = read_rig(opened.file)
    left, right = (RectifiableCamera.of_rectified((rig.width, rig.height), projection(rig, side)) for side in SIDES)
    return CameraPair(left, right, f"rig '{opened.file.name}'", rig.T_rb_sb)


READERS = (
    ProgramReader("Kalibr (cam0, cam1)", read_kalibr, _has("cam0")),
    ProgramReader("EuRoC", read_euroc, _has("T_BS intrinsics")),
    ProgramReader("ORB-SLAM", read_orb_slam, _has("LEFT.K", "Camera.fx", "Camera1.fx")),
    ProgramReader("OpenCV (M1, D1, M2, D2, R, T)", read_opencv, _has("M1", "K1", "cameraMatrix1", "R1", "T")),
    ProgramReader("ROS (camera_matrix, projection_matrix)", read_ros, _has("projection_matrix", "k r p")),
    ProgramReader("COLMAP (cameras.txt and rig_config.json)", read_colmap, _is_colmap),
    ProgramReader("a rig.json", _read_rig_json, _has("baseline_m")),
)
"""The readers of calibrations. The first reader that recognises a file reads it."""
