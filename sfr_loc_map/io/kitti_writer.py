"""Writes a drive in the layout of the KITTI odometry benchmark, as `io/kitti.py` reads it.

    image_0/000000.png image_1/000000.png calib.txt (P0, P1) times.txt poses.txt

Poses are those of the left camera in its first frame, one an image; they are left out where the rig's pose on the
rover or the truth at an image is not known.
"""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.camera_info import projection
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.trajectory_file import seconds_text
from sfr_loc_map.io.truth_of_pairs import poses_at

_log = logging.getLogger(__name__)


class KittiWriter:
    """A sequence that is being written; a context manager."""

    def __init__(self, path: Path) -> None:
        """Prepare a folder, made when the block begins."""
        self._path = path
        self._rig: StereoRig | None = None
        self._stamps_ns: list[int] = []
        self._truth: list[tuple[int, Transform]] = []

    def __enter__(self) -> KittiWriter:
        """Make the folder."""
        for name in (".", "image_0", "image_1"):
            (self._path / name).mkdir(exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the tables, unless something was raised."""
        if error is None:
            times = "".join(f"{seconds_text(stamp)}\n" for stamp in self._stamps_ns)
            (self._path / "times.txt").write_text(times, encoding="ascii")
            self._write_poses()

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the calibration."""
        self._rig = rig
        sides = enumerate((projection(rig, "left"), projection(rig, "right")))
        lines = [f"P{number}: {' '.join(map(repr, matrix.tolist()))}\n" for number, matrix in sides]
        (self._path / "calib.txt").write_text("".join(lines), encoding="ascii")

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Leave out the rig of mapping pairs: the layout has none."""

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive.

        Raises:
            OutputError: If its stamp is negative: times are seconds from 0 on.
        """
        if pair.stamp_ns < 0:
            raise OutputError(f"stamp {pair.stamp_ns} ns is negative: the times of KITTI begin at 0")
        for name, image in (("image_0", pair.left), ("image_1", pair.right)):
            (self._path / name / f"{len(self._stamps_ns):06d}.png").write_bytes(encode_png(image))
        self._stamps_ns.append(pair.stamp_ns)

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Leave out a mapping pair."""

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Take a true pose of RB in DS."""
        self._truth.append((stamp_ns, Transform.from_quat(position, quat_xyzw)))

    def _write_poses(self) -> None:
        if not self._truth or self._rig is None:
            return
        if self._rig.T_rb_sb is None:
            _log.warning("poses.txt is left out: the pose of the cameras on the rover (T_rb_locsb) is not known")
            return
        poses = poses_at(self._stamps_ns, self._truth)
        if poses is None:
            _log.warning("poses.txt is left out: it needs a true pose at every image, the truth does not cover them")
            return
        T_rb_left = self._rig.T_rb_left
        T_first_ds = (poses[0] @ T_rb_left).inverse()
        rows = [(T_first_ds @ pose @ T_rb_left).matrix[:3].reshape(-1).tolist() for pose in poses]
        text = "".join(f"{' '.join(map(repr, row))}\n" for row in rows)
        (self._path / "poses.txt").write_text(text, encoding="ascii")
