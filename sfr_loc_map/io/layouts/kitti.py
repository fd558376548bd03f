"""The layout of the KITTI odometry benchmark (Geiger et al. 2012), read and written.

    image_0/000000.png  image_1/000000.png   rectified images, left and right (or image_2, image_3: colour)
    calib.txt           P0: ... P3: ...      projection matrices of the rectified cameras, in the frame of camera 0
    times.txt           one time per line, s
    poses.txt           optional (or ../../poses/NAME.txt): 3 x 4 matrices of camera 0 in its first frame

RB is the frame SB of the stereo rig, and DS is RB at the first pose: x forward, y left, z up.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stamped_poses import covered, sampled
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parent_of, read_table, refusing
from sfr_loc_map.io.calibration.projections import check_centre, projection, rig_from_projections
from sfr_loc_map.io.image_codec import encode_png, read_grey
from sfr_loc_map.io.layouts.image_files import ImageFileSequence, ImagePair, complete_pairs
from sfr_loc_map.io.layouts.writer import TableWriter
from sfr_loc_map.io.number_text import parse_number
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.stamps.stamp_text import seconds_text
from sfr_loc_map.io.tables.numbered_stamps import read_times
from sfr_loc_map.io.tables.text_table import RowForm, parse_table, read_lines
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import IMAGE_ENDINGS, SIDES

CAMERAS = ((0, 1), (2, 3))  #: Numbers of the left and right cameras, in the order of preference: grey, colour.
_log = logging.getLogger(__name__)


def open_kitti(path: Path, config: SourceConfig) -> Source:
    """Open a KITTI odometry sequence."""
    left, right = next(pair for pair in CAMERAS if (path / f"image_{pair[0]}").is_dir())
    times, calibration = path / "times.txt", path / "calib.txt"
    stamps = read_times(times).tolist()
    if not stamps:
        raise InputError(f"'{times}' has no times:", "one line for each pair is required")
    entries = [
        ImagePair(stamp, path / f"image_{left}" / f"{i:06d}.png", path / f"image_{right}" / f"{i:06d}.png")
        for i, stamp in enumerate(stamps)
    ]
    _check_names(entries)
    pairs, missing_ns = complete_pairs(entries, f"'{times}'")
    height, width = read_grey(pairs[0].left).shape
    cameras = _read_projections(calibration)
    if left not in cameras or right not in cameras:
        found = sorted(f"P{i}" for i in cameras)
        raise InputError(f"'{calibration}' has {', '.join(found) or 'no P'}:", f"P{left} and P{right} are required")
    size, where, names = (width, height), f"'{calibration}'", (f"P{left}", f"P{right}")
    rig = rig_from_projections(cameras[left], cameras[right], size, where, names)
    check_centre(rig.cx, rig.cy, size, where)
    rig = replace(rig, T_rb_sb=Transform.identity())
    truth = _load_poses(path, stamps, rig, -cameras[left][3] / cameras[left][0])
    loc = ImageFileSequence(rig, pairs, missing_ns).configured(path, config, truth)
    beside = tuple(file for file in _pose_files(path) if file.is_file())
    return Source(path, SourceFormat.KITTI, loc, None, config=config, own_extrinsics=rig.T_rb_sb, truth_files=beside)


def _check_names(entries: Sequence[ImagePair]) -> None:
    """Raise InputError if the folder of the left images has only images whose names are not those of the benchmark."""
    folder = entries[0].left.parent
    if any(entry.left.exists() for entry in entries):
        return
    found = sorted(file.name for file in folder.iterdir() if suffix_of(file) in IMAGE_ENDINGS)
    if found:
        raise InputError(
            f"'{folder}' has images such as '{found[0]}': names like '{entries[0].left.name}', with the numbers of "
            "their lines in times.txt, are required;",
            "rename the images, or link them by such names",
        )


def _read_projections(calibration: Path) -> dict[int, FloatArray]:
    """Return the projection matrices `(12,)` in calib.txt by the number of the camera."""
    cameras: dict[int, FloatArray] = {}
    for line in read_lines(calibration):
        name, _, rest = line.partition(":")
        if name not in ("P0", "P1", "P2", "P3"):
            continue
        if int(name[1]) in cameras:
            raise InputError(f"'{calibration}' has {name} twice:", f"one line {name} is required")
        with refusing(f"'{calibration}' {name}: 12 finite numbers are required"):
            cameras[int(name[1])] = np.array([parse_number(word) for word in rest.split()]).reshape(12)
    return cameras


def _pose_files(path: Path) -> list[Path]:
    """Return the possible files of the poses of a sequence, in the order of preference."""
    return [path / "poses.txt", parent_of(parent_of(path)) / "poses" / f"{path.resolve().name}.txt"]


def _load_poses(path: Path, stamps: list[int], rig: StereoRig, offset_m: float) -> RecordedTruth | None:
    """Return the poses of RB from those of camera 0; the left camera is at x = `offset_m` in camera 0."""
    file = next((file for file in _pose_files(path) if file.is_file()), None)
    if file is None:
        return None
    rows = parse_table(
        read_table(file), f"'{file}'", RowForm("the first three rows of a pose matrix", range(12))
    ).values
    if len(rows) != len(stamps):
        raise InputError(
            f"'{file}' has {len(rows)} poses for {len(stamps)} times:", "one pose for each time is required"
        )
    T_cam0_left = Transform(np.eye(3), np.array([offset_m, 0.0, 0.0]))
    with refusing(f"'{file}'"):
        matrices = [Transform.from_matrix(row.reshape(3, 4)) for row in rows]
    poses = [T_cam0_left.inverse() @ pose @ T_cam0_left for pose in matrices]
    start, T_left_sb = rig.T_sb_left @ poses[0].inverse(), rig.T_sb_left.inverse()
    stamped = zip(stamps, poses, strict=True)
    return RecordedTruth(Trajectory.from_poses((stamp, start @ pose @ T_left_sb) for stamp, pose in stamped), str(file))


class KittiWriter(TableWriter):
    """Context manager that writes a sequence. Mapping pairs are omitted because the layout does not support them."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._rig: StereoRig | None = None
        self._stamps_ns: list[int] = []

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the calibration."""
        self._rig = rig
        for number, side in enumerate(SIDES):
            self.append("calib.txt", f"P{number}: {' '.join(map(repr, projection(rig, side).tolist()))}")

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        if pair.stamp_ns < 0:
            raise OutputError(f"stamp {pair.stamp_ns} ns is negative: KITTI requires times from 0")
        for name, image in (("image_0", pair.left), ("image_1", pair.right)):
            (self._path / name).mkdir(exist_ok=True)
            (self._path / name / f"{len(self._stamps_ns):06d}.png").write_bytes(encode_png(image))
        self._stamps_ns.append(pair.stamp_ns)
        self.append("times.txt", seconds_text(pair.stamp_ns))

    def _finish(self) -> None:
        """Write the true pose of the left camera at each image, relative to the first image.

        Poses are interpolated between true poses that are at most 1 s apart.
        """
        rig = self._rig
        if rig is None or not self._truth:
            return
        if rig.T_rb_sb is None:
            _log.warning(
                "poses.txt is omitted, because the pose of the cameras on the rover (T_rb_locsb) is unknown: set "
                "extrinsics.translation_m and extrinsics.quat_xyzw in sfr.yaml and convert again"
            )
            return
        truth, stamps = self._true_poses, np.array(self._stamps_ns, np.int64)
        if not truth.has_attitude:
            _log.warning("poses.txt is omitted: the truth has no attitudes")
            return
        if not covered(truth.stamps_ns, stamps).all():
            _log.warning("poses.txt is omitted: the truth does not cover every image")
            return
        places_and_turns = zip(*sampled(truth, stamps), strict=True)
        poses = [Transform.from_quat(place, turn) @ rig.T_rb_left for place, turn in places_and_turns]
        T_first_ds = poses[0].inverse()
        for pose in poses:
            self.append("poses.txt", " ".join(map(repr, (T_first_ds @ pose).matrix[:3].reshape(-1).tolist())))
