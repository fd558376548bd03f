"""A trajectory as read, with what commands report about its file, and with the stamps of another trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.stamps.time_units import UnitOrigin
from sfr_loc_map.io.tables.numbered_stamps import times_beside
from sfr_loc_map.io.tables.pose_columns import STAMP, PoseColumns, TrajectoryFormat
from sfr_loc_map.message_text import counted

ANNOUNCED = (TrajectoryFormat.KITTI, TrajectoryFormat.EUROC, TrajectoryFormat.COLUMNS, TrajectoryFormat.MATRIX)
"""Formats that commands report when they detect them."""
MOST_NAMED = 8  #: Maximum number of columns that a message lists.
FORMAT_NAMES = {  # all formats but COLUMNS, whose name is that of the detected columns
    TrajectoryFormat.CSV: "csv of the suite",
    TrajectoryFormat.TUM: "TUM",
    TrajectoryFormat.KITTI: "KITTI poses of the left camera, rotated to x forward, y left, z up",
    TrajectoryFormat.EUROC: "EuRoC csv",
    TrajectoryFormat.MATRIX: "3 x 4 matrices with stamps or frame numbers",
}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrajectory:
    """A trajectory as read from a file, a bag or memory."""

    path: Path
    trajectory: Trajectory
    columns: PoseColumns | None = None  #: The columns of the file; None for poses of a bag or in memory.
    stamps: str = ""  #: Origin of the stamps for messages, if the file itself has none.
    by_index: bool = False  #: Whether the stamps are only numbers of lines or frames.
    skipped: str = ""  #: Description of the skipped rows and covariances.
    covariance: FloatArray | None = None  #: `(N, 6, 6)` in ROS order (m^2, rad^2), if the file has it.
    rows: IntArray | None = None  #: `(N,)` number of the row of each pose in the file, from 0; None: all rows.
    row_count: int | None = None  #: Number of rows in the file, with the skipped rows; None: that of the poses.

    @property
    def format(self) -> TrajectoryFormat | None:
        """The format of the file; None for poses of a bag or in memory."""
        return None if self.columns is None else self.columns.format

    @property
    def text(self) -> str:
        """The detected format and content, in one line."""
        kind = "pose" if self.trajectory.has_attitude else "position"
        parts = [] if self.columns is None else [FORMAT_NAMES.get(self.columns.format, self.columns.name)]
        parts += [counted(len(self.trajectory), kind)]
        parts += [f"stamps: {self.stamps}"] if self.stamps else []
        parts += [] if self.columns is None else self._units(self.columns)
        parts += ["covariances read"] if self.covariance is not None else []
        ignored = [] if self.columns is None else [name for name in self.columns.ignored if name]
        more = f" and {len(ignored) - MOST_NAMED} more" if len(ignored) > MOST_NAMED else ""
        parts += [f"columns not read: {', '.join(ignored[:MOST_NAMED])}{more}"] if ignored else []
        parts += [self.skipped] if self.skipped else []
        return f"{self.path}: {', '.join(parts)}"

    @staticmethod
    def _units(columns: PoseColumns) -> list[str]:
        """Return the texts about units other than metres, and about an inferred unit of the stamps."""
        lengths = " and ".join(columns.length_units)
        texts = [f"unit of the positions: {lengths}"] if lengths else []
        if columns.unit_origin is UnitOrigin.INFERRED:
            texts.append(f"unit of the stamps, inferred from their magnitude: {columns.units[STAMP]}")
        return texts

    @property
    def is_announced(self) -> bool:
        """Whether commands report the detection: always, except for the default forms of the suite's csv and of TUM."""
        if self.columns is None:
            return False
        is_unusual = bool(self._units(self.columns) or self.columns.ignored)
        return self.format in ANNOUNCED or bool(self.skipped) or is_unusual

    @property
    def stamped(self) -> Trajectory:
        """The trajectory with the stamps of the file; InputError if the file has no stamps."""
        if self.by_index:
            raise InputError(
                f"'{self.path}' has no stamps ({len(self.trajectory)} poses, numbered by line):",
                f"write the time of each pose in seconds into '{times_beside(self.path)}'",
            )
        return self.trajectory

    def with_stamps_of(self, other: LoadedTrajectory) -> LoadedTrajectory:
        """Return the trajectory; if it has no stamps, with the stamps of another trajectory, row by row.

        Poses whose row was skipped in the other file are omitted. InputError if the files differ in their numbers of
        rows, or have no pose in the same row.
        """
        if not self.by_index or other.by_index:
            return self
        own_rows, own_count = self._numbered_rows()
        other_rows, other_count = other._numbered_rows()
        if own_count != other_count:
            raise InputError(
                f"'{self.path}' has no stamps ({own_count} rows of KITTI poses) and '{other.path}' has {other_count} "
                f"rows:",
                f"write the time of each pose in seconds into '{times_beside(self.path)}'",
            )
        _, own, others = np.intersect1d(own_rows, other_rows, assume_unique=True, return_indices=True)
        if not len(own):
            raise InputError(f"'{self.path}' and '{other.path}' have no pose in the same row:", "correct the files")
        poses = self.trajectory
        stamped = Trajectory(other.trajectory.stamps_ns[others], poses.positions[own], poses.quats_xyzw[own])
        missing = len(poses) - len(own)
        skipped = [self.skipped] if self.skipped else []
        skipped += [f"{counted(missing, 'pose')} without a stamp in {other.path} skipped"] if missing else []
        return replace(
            self,
            trajectory=stamped,
            stamps=f"those of {other.path}, pose by pose",
            by_index=False,
            skipped="; ".join(skipped),
            covariance=None if self.covariance is None else self.covariance[own],
            rows=own_rows[own],
        )

    def _numbered_rows(self) -> tuple[IntArray, int]:
        """Return the number of the row of each pose `(N,)`, from 0, and the number of all rows."""
        rows = np.arange(len(self.trajectory)) if self.rows is None else self.rows
        return rows, len(self.trajectory) if self.row_count is None else self.row_count
