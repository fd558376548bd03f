"""The calibration of a stereo pair from files of other programs, detected from the content.

    Kalibr       camchain.yaml with cam0 and cam1 (pinhole; radtan, equidistant) and T_cn_cnm1, T_cam_imu or T_imu_cam
    EuRoC        cam0/sensor.yaml and cam1/sensor.yaml
    ORB-SLAM     settings with LEFT.K, RIGHT.K, ..., with Camera1, Camera2 and Stereo.T_c1_c2, or with Camera.bf
    OpenCV       FileStorage (YAML, XML, JSON) with M1 D1 M2 D2 R T or R1 R2 P1 P2, in one file or two
    ROS          left.yaml and right.yaml of camera_calibration
    COLMAP       cameras.txt and rig_config.json
    rig.json     of the suite

If a calibration has two files, the second is found by its name (`opened_file.PARTNERS`). A folder with one calibration
is accepted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.inputs import check_exists, refusing
from sfr_loc_map.io.calibration.opened_file import open_calibration, partner_of
from sfr_loc_map.io.calibration.programs import READERS
from sfr_loc_map.io.calibration.projections import with_baseline
from sfr_loc_map.io.calibration.stereo_calibration import CameraPair, StereoCalibration, calibrated
from sfr_loc_map.suffixes import suffix_of

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
        raise CalibrationError(str(error)) from error


def _cameras_in(path: Path, size: tuple[int, int] | None, where: str) -> CameraPair:
    """Return the cameras in a file or a folder; InputError unless both have the size of the images."""
    check_exists(path, "give a calibration file, or a folder that contains one")
    with naming(path), refusing(where):
        opened = open_calibration(_only_file(path) if path.is_dir() else path, size)
        reader = next((reader for reader in READERS if reader.recognises(opened)), None)
        if reader is None:
            *known, last = (reader.shown for reader in READERS)
            found = ", ".join(opened.shown_names[:8]) or "no known structure"
            raise InputError(f"{where}: the file has {found}; a file of {', '.join(known)} or {last} is required")
        pair = reader.read(opened)
    if len(sizes := {pair.left.size, pair.right.size, size or pair.left.size}) > 1:
        shown = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise InputError(f"{where} and the images differ in size, {shown} px: calibrate both cameras at the image size")
    return pair


def _only_file(folder: Path) -> Path:
    """Return the only calibration file in a folder, or the first file if the calibration has two."""
    files = [*folder.absolute().glob("*.*"), *folder.absolute().glob("*/*.*")]
    files = sorted(file for file in files if suffix_of(file) in ENDINGS)
    found = [file for file in files if (other := partner_of(file)) and file < other] or files
    if len(found) != 1:
        names = ", ".join(str(file.relative_to(folder.absolute())) for file in found[:8]) or "no calibration file"
        raise InputError(f"calibration '{folder}': the folder has {names}; give the path of one calibration file")
    return found[0]
