"""Trajectories in the formats that other tools write; which one it is follows from the content.

| format | is |
|---|---|
| `csv` | the csv of the suite (`trajectory_file`) |
| `tum` | TUM: `t x y z qx qy qz qw` |
| `kitti` | twelve numbers a line, without stamps (`kitti_poses`) |
| `euroc` | csv with nanoseconds and quaternions scalar first (`euroc_poses`) |
| `evo` | a zip file of evo with trajectories (`evo_result`) |
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.euroc_poses import euroc_text, parse_euroc_poses
from sfr_loc_map.io.evo_result import MAGIC, read_evo_trajectory
from sfr_loc_map.io.kitti_poses import COLUMNS as KITTI_COLUMNS
from sfr_loc_map.io.kitti_poses import (
    find_times,
    index_stamps,
    kitti_text,
    parse_kitti_poses,
    read_times,
    times_beside,
    times_text,
)
from sfr_loc_map.io.trajectory_file import HEAD_BYTES, TUM_SUFFIXES, parse_trajectory, save_trajectory

KITTI_SUFFIX = ".kitti"
EUROC_SUFFIX = ".euroc.csv"
EVO_SUFFIX = ".zip"
OUTPUT_SUFFIXES = (".csv", *TUM_SUFFIXES, KITTI_SUFFIX)
"""Endings of names of trajectory files that are written."""
FILE_SUFFIXES = (*OUTPUT_SUFFIXES, EVO_SUFFIX)
"""Endings of names of those that are read."""


class TrajectoryFormat(StrEnum):
    """How a trajectory file is written."""

    CSV = "csv"
    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    EVO = "evo"


FOREIGN = (TrajectoryFormat.KITTI, TrajectoryFormat.EUROC, TrajectoryFormat.EVO)
"""Formats of which a command says that it has found them."""
WORDS = {
    TrajectoryFormat.CSV: "csv of the suite",
    TrajectoryFormat.TUM: "TUM",
    TrajectoryFormat.KITTI: "KITTI poses of the left camera, turned to x forward, y left, z up",
    TrajectoryFormat.EUROC: "EuRoC csv",
    TrajectoryFormat.EVO: "evo result",
}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrajectory:
    """A trajectory as read.

    Attributes:
        path: Its file.
        trajectory: The poses.
        format: How it was written.
        stamps: Where its stamps come from, in words, where the file does not have them.
        by_index: Whether the stamps are only the numbers of the lines.
    """

    path: Path
    trajectory: Trajectory
    format: TrajectoryFormat
    stamps: str = ""
    by_index: bool = False

    @classmethod
    def of(cls, path: Path, trajectory: Trajectory) -> LoadedTrajectory:
        """Return the poses of a bag or data set folder, which have stamps."""
        return cls(path, trajectory, TrajectoryFormat.CSV)

    @property
    def text(self) -> str:
        """What was detected, in one line."""
        stamps = f", stamps: {self.stamps}" if self.stamps else ""
        return f"{self.path}: {WORDS[self.format]}, {len(self.trajectory)} poses{stamps}"

    def with_stamps_of(self, other: LoadedTrajectory) -> LoadedTrajectory:
        """Return poses that have no stamps of their own with those of another trajectory, one by one.

        Raises:
            InputError: If the numbers of poses differ.
        """
        if not self.by_index or other.by_index:
            return self
        count, others = len(self.trajectory), len(other.trajectory)
        if count != others:
            raise InputError(
                f"'{self.path}' has no stamps ({count} KITTI poses) and '{other.path}' has {others} poses: put the "
                f"seconds of each pose into '{times_beside(self.path).name}' beside it"
            )
        stamped = replace(self.trajectory, stamps_ns=other.trajectory.stamps_ns)
        return replace(self, trajectory=stamped, stamps=f"those of {other.path}, pose by pose", by_index=False)


def read_trajectory_file(path: Path, role: str = "estimate") -> LoadedTrajectory:
    """Read a trajectory in any format.

    Args:
        path: The file.
        role: `estimate` or `truth`: which of a result of evo is wanted.

    Raises:
        InputError: If it cannot be read, or a line is no pose; names the line.
    """
    path = Path(path)
    data = _read(path)
    kind = detect_format(path, data[:HEAD_BYTES])
    if kind is TrajectoryFormat.EVO:
        return _read_evo(path, role)
    if kind is TrajectoryFormat.KITTI:
        return _stamped_kitti(path, data, f"'{path}'")
    trajectory = (
        parse_euroc_poses(data, f"'{path}'") if kind is TrajectoryFormat.EUROC else parse_trajectory(path, data)
    )
    return LoadedTrajectory(path, trajectory, kind)


def detect_format(path: Path, head: bytes) -> TrajectoryFormat:
    """Return the format of a file by its first bytes, and where they do not tell by its name."""
    if head.startswith(MAGIC):
        return TrajectoryFormat.EVO
    lines = [line.strip() for line in head.removeprefix(b"\xef\xbb\xbf").splitlines() if line.strip()]
    if lines and lines[0].startswith(b"stamp_ns"):
        return TrajectoryFormat.CSV
    row = next((line for line in lines if not line.startswith(b"#")), b"")
    cells = row.split(b",")
    if len(cells) >= 8 and cells[0].strip().isdigit():
        return TrajectoryFormat.EUROC
    if len(row.split()) == KITTI_COLUMNS:
        return TrajectoryFormat.KITTI
    return TrajectoryFormat.CSV if path.suffix == ".csv" else TrajectoryFormat.TUM


def format_of_name(path: Path) -> TrajectoryFormat | None:
    """Return the format in which a file of this name is written, None if that is no trajectory file."""
    if path.name.endswith(EUROC_SUFFIX):
        return TrajectoryFormat.EUROC
    kinds = {KITTI_SUFFIX: TrajectoryFormat.KITTI, ".csv": TrajectoryFormat.CSV}
    return kinds.get(path.suffix, TrajectoryFormat.TUM if path.suffix in TUM_SUFFIXES else None)


def write_trajectory_file(path: Path, trajectory: Trajectory, kind: TrajectoryFormat | None = None) -> None:
    """Write a trajectory; KITTI poses with their stamps beside them as `NAME.times.txt`.

    Args:
        path: The file.
        trajectory: The poses.
        kind: Format; None: by the name (.csv, .txt and .tum, .kitti, .euroc.csv).

    Raises:
        OutputError: If it cannot be written.
    """
    kind = kind or format_of_name(path)
    if kind is TrajectoryFormat.KITTI:
        _write(times_beside(path), times_text(trajectory.stamps_ns))
        _write(path, kitti_text(trajectory))
    elif kind is TrajectoryFormat.EUROC:
        _write(path, euroc_text(trajectory))
    else:
        save_trajectory(path, trajectory, tum=kind is TrajectoryFormat.TUM)


def files_written(path: Path) -> tuple[Path, ...]:
    """Return the files that a trajectory of this name is written to."""
    return (path, times_beside(path)) if format_of_name(path) is TrajectoryFormat.KITTI else (path,)


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def _read(path: Path) -> bytes:
    try:
        if path.suffix == EVO_SUFFIX:
            with path.open("rb") as stream:
                return stream.read(len(MAGIC))
        return read_table(path)
    except OSError as error:
        reason = error.strerror or str(error)
        formats = "csv, TUM, KITTI, EuRoC or evo file"
        raise InputError(f"cannot read trajectory '{path}': {reason}; give a {formats}") from error


def _read_evo(path: Path, role: str) -> LoadedTrajectory:
    member = read_evo_trajectory(path, role)
    if not member.is_tum:
        found = _stamped_kitti(path, member.data, f"'{path}' {member.name}")
        return replace(found, format=TrajectoryFormat.EVO)
    return LoadedTrajectory(path, parse_trajectory(path / member.name, member.data), TrajectoryFormat.EVO)


def _stamped_kitti(path: Path, data: bytes, name: str) -> LoadedTrajectory:
    positions, quats = parse_kitti_poses(data, name)
    times = find_times(path)
    stamps_ns = index_stamps(len(positions)) if times is None else read_times(times, len(positions))
    stamps = "numbers of the lines, 1 s apart" if times is None else str(times)
    trajectory = Trajectory(stamps_ns, positions, quats)
    return LoadedTrajectory(path, trajectory, TrajectoryFormat.KITTI, stamps, times is None)
