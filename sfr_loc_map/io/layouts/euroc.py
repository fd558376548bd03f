"""The layout of the EuRoC MAV data sets (ASL; Burri et al. 2016), read and written.

    mav0/cam0/{sensor.yaml,data.csv,data/*.png}   left camera: pinhole, radial-tangential distortion, T_BS
    mav0/cam1/...                                 right camera
    mav0/state_groundtruth_estimate0/data.csv     optional: timestamp [ns], p_xyz [m], q_wxyz, ... of B in the world

The reader rectifies the images unless they are rectified. RB is the body frame B, and DS is the world frame of the
truth. The truth is read at its own rate. If the pose of the rig on the rover is unknown, the writer sets B to SB and
omits the truth.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import naming
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.io.calibration.opened_file import parse_opencv_yaml
from sfr_loc_map.io.calibration.programs.euroc import SensorPose, euroc_pair
from sfr_loc_map.io.calibration.rectification import StereoRectifier
from sfr_loc_map.io.calibration.stereo_calibration import calibrated, pose_of_rig
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.layouts.image_files import ImageFileSequence, complete_pairs, paired_files
from sfr_loc_map.io.layouts.writer import TableWriter
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.stamps.stamp_checks import SHORTEST_IMAGE_STEP_NS, check_stamp_order, check_truth_order, check_unit
from sfr_loc_map.io.stamps.stamp_text import parse_stamp_ns
from sfr_loc_map.io.tables.pose_columns import TrajectoryFormat
from sfr_loc_map.io.tables.text_table import read_lines
from sfr_loc_map.io.tables.trajectory_file import TRUTH_OPTION, read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.json_yaml import converted

CAMERAS = ("cam0", "cam1")
TRUTH = "state_groundtruth_estimate0"
TRUTHS = (TRUTH, "mocap0", "vicon0", "gt0", "leica0")
"""Folders of the truth in the order of preference: mocap0 occurs in TUM-VI, vicon0 and leica0 in EuRoC."""
LIST_HEADER = "#timestamp [ns],filename"
_log = logging.getLogger(__name__)


def open_euroc(path: Path, config: SourceConfig) -> Source:
    """Open an EuRoC sequence: the folder `mav0` or its parent."""
    folder = path / "mav0" if (path / "mav0").is_dir() else path
    rig, rectifier = _rig_of(folder)
    left, right = (_load_list(folder / name / "data.csv") for name in CAMERAS)
    pairs, single_ns = paired_files(left, right, config.sync, f"'{folder}'")
    complete, missing_ns = complete_pairs(pairs, f"'{folder}'")
    loc = ImageFileSequence(rig, complete, sorted((*missing_ns, *single_ns)), rectifier=rectifier)
    loc = loc.configured(path, config, _load_truth(folder))
    return Source(path, SourceFormat.EUROC, loc, None, config=config, own_extrinsics=rig.T_rb_sb)


def _rig_of(folder: Path) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rectified rig, with its pose in B, and its rectifier; None if the images are rectified."""
    name = f"'{folder}'"
    with naming(folder):
        pair = euroc_pair([folder / camera / "sensor.yaml" for camera in CAMERAS])
        pair.check_images(*CAMERAS, "Correct T_BS in sensor.yaml, or exchange the names of both folders")
    found = calibrated(pair, name)
    with refusing(f"{name}: the cameras cannot be rectified", "correct the calibration"):
        return replace(found.rig, T_rb_sb=pose_of_rig(pair, found.rig)), found.rectifier


def _load_truth(folder: Path) -> RecordedTruth | None:
    """Return the truth of the first existing folder of `TRUTHS`.

    A tracker measures its marker, whose pose in B is T_BS.
    """
    file = next((file for name in TRUTHS if (file := folder / name / "data.csv").is_file()), None)
    if file is None:
        return None
    loaded = read_trajectory_file(file, option=TRUTH_OPTION)
    check_truth_order(loaded.trajectory.stamps_ns, f"'{file}'")
    sensor = file.with_name("sensor.yaml")
    if file.parent.name == TRUTH or not sensor.is_file():
        return RecordedTruth(loaded.trajectory, loaded.text)
    with refusing(f"'{sensor}' is not a sensor.yaml of an EuRoC body"):
        T_rb_marker = converted(parse_opencv_yaml(read_text(sensor)), SensorPose).T_BS.transform
    return RecordedTruth(loaded.trajectory, loaded.text, T_rb_body=T_rb_marker)


def _load_list(path: Path) -> dict[int, Path]:
    stamps_ns, files = [], []
    for number, line in enumerate(read_lines(path), start=1):
        stamp, name, *_ = [*line.split(","), ""]
        with refusing(f"'{path}' entry {number}"):
            stamps_ns.append(parse_stamp_ns(stamp))
        files.append(path.parent / "data" / name.strip())
    check_stamp_order(stamps_ns, f"'{path}'", strict=True)
    check_unit(stamps_ns, f"'{path}'", shortest_ns=SHORTEST_IMAGE_STEP_NS)
    return dict(zip(stamps_ns, files, strict=True))


class EurocWriter(TableWriter):
    """Context manager that writes a sequence. Mapping pairs are omitted because the layout does not support them."""

    _has_body = True

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the calibration of both cameras; required before the first pair and the truth."""
        self._has_body = rig.T_rb_sb is not None
        T_body_left = rig.T_rb_left if self._has_body else rig.T_sb_left
        T_left_right = Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
        for name, pose in zip(CAMERAS, (T_body_left, T_body_left @ T_left_right), strict=True):
            numbers = ", ".join(map(repr, pose.matrix.reshape(-1).tolist()))
            (self._path / "mav0" / name / "data").mkdir(parents=True)
            (self._path / "mav0" / name / "sensor.yaml").write_text(
                f"%YAML:1.0\nsensor_type: camera\ncomment: rectified camera {name}\n"
                f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\n"
                f"resolution: [{rig.width}, {rig.height}]\ncamera_model: pinhole\n"
                f"intrinsics: [{rig.fx!r}, {rig.fy!r}, {rig.cx!r}, {rig.cy!r}]\n"
                "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n",
                encoding="ascii",
            )

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        for name, image in zip(CAMERAS, (pair.left, pair.right), strict=True):
            file = f"{pair.stamp_ns}.png"
            (self._path / "mav0" / name / "data" / file).write_bytes(encode_png(image))
            self.append(f"mav0/{name}/data.csv", f"{pair.stamp_ns},{file}", LIST_HEADER)

    def _finish(self) -> None:
        if self._truth and not self._has_body:
            _log.warning(
                "the truth is omitted, because the pose of the cameras on the rover (T_rb_locsb) is unknown: set "
                "extrinsics.translation_m and extrinsics.quat_xyzw in sfr.yaml and convert again"
            )
        elif self._truth:
            folder = self._path / "mav0" / TRUTH
            folder.mkdir()
            save_trajectory(folder / "data.csv", self._true_poses, TrajectoryFormat.EUROC)
