"""Writes a drive in the layout of the EuRoC MAV data sets (ASL), as `io/euroc.py` reads it.

    mav0/cam0/{sensor.yaml,data.csv,data/*.png} mav0/cam1/... mav0/state_groundtruth_estimate0/data.csv

The body frame B is RB, or SB where the rig's pose on the rover is not known; the truth is left out then. Images are
rectified: both cameras have one matrix and no distortion. The truth has positions and orientations alone: velocities
and biases are not known.
"""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import encode_png

CAMERAS = ("cam0", "cam1")
TRUTH = "state_groundtruth_estimate0"
LIST_HEADER = "#timestamp [ns],filename"
TRUTH_HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"  # as published
)
_log = logging.getLogger(__name__)


class EurocWriter:
    """A sequence that is being written; a context manager."""

    def __init__(self, path: Path) -> None:
        """Prepare a folder, made when the block begins."""
        self._path = path
        self._folder = path / "mav0"
        self._tables: dict[str, IO[str]] = {}
        self._has_body = True
        self._told = False

    def __enter__(self) -> EurocWriter:
        """Make the folder."""
        self._path.mkdir(exist_ok=True)
        for name in CAMERAS:
            (self._folder / name / "data").mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all tables."""
        for stream in self._tables.values():
            stream.close()

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the two cameras; comes before the first pair and the truth."""
        self._has_body = rig.T_rb_sb is not None
        T_body_left = rig.T_rb_left if self._has_body else rig.T_sb_left
        T_left_right = Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
        for name, pose in zip(CAMERAS, (T_body_left, T_body_left @ T_left_right), strict=True):
            text = _sensor_yaml(rig, pose, f"rectified camera {name}")
            (self._folder / name / "sensor.yaml").write_text(text, encoding="ascii")

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Leave out the rig of mapping pairs: the layout has none."""

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        for name, image in zip(CAMERAS, (pair.left, pair.right), strict=True):
            file = f"{pair.stamp_ns}.png"
            (self._folder / name / "data" / file).write_bytes(encode_png(image))
            self._append(name, LIST_HEADER, f"{pair.stamp_ns},{file}")

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Leave out a mapping pair."""

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Write one true pose of RB in DS."""
        if not self._has_body:
            if not self._told:
                _log.warning("the truth is left out: the pose of the cameras on the rover (T_rb_locsb) is not known")
            self._told = True
            return
        x, y, z, w = quat_xyzw.tolist()
        self._append(TRUTH, TRUTH_HEADER, ",".join([str(stamp_ns), *map(repr, (*position.tolist(), w, x, y, z))]))

    def _append(self, name: str, header: str, row: str) -> None:
        if name not in self._tables:
            (self._folder / name).mkdir(exist_ok=True)
            self._tables[name] = (self._folder / name / "data.csv").open("w", encoding="ascii", newline="\n")
            self._tables[name].write(header + "\n")
        self._tables[name].write(row + "\n")


def _sensor_yaml(rig: StereoRig, T_body_cam: Transform, comment: str) -> str:
    numbers = ", ".join(map(repr, T_body_cam.matrix.reshape(-1).tolist()))
    return (
        f"%YAML:1.0\nsensor_type: camera\ncomment: {comment}\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\n"
        f"resolution: [{rig.width}, {rig.height}]\ncamera_model: pinhole\n"
        f"intrinsics: [{rig.fx!r}, {rig.fy!r}, {rig.cx!r}, {rig.cy!r}]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
    )
