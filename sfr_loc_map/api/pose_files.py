"""Trajectories in the files of other tools."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry import trajectory as base
from sfr_loc_map.io.trajectory_file import TrajectoryFormat, read_times, read_trajectory_file, save_trajectory


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseFiles(base.Trajectory):
    """Poses that are read and written as csv, TUM, KITTI, EuRoC; read as a result of evo."""

    @classmethod
    def from_tum(cls, path: PathLike) -> Self:
        """Read a TUM file: `t x y z qx qy qz qw`, t in seconds.

        Raises:
            InputError: If it cannot be read; names the line.
        """
        return cls._of_file(path, TrajectoryFormat.TUM)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a trajectory file; the format is detected: csv of the suite, TUM, KITTI, EuRoC, result of evo.

        Raises:
            InputError: If it cannot be read; names the line.
        """
        return cls._of(read_trajectory_file(Path(path)).trajectory)

    @classmethod
    def from_kitti(cls, path: PathLike, times: PathLike | None = None) -> Self:
        """Read KITTI poses: twelve numbers a line, of the left camera; here with x forward, y left, z up.

        Args:
            path: The poses.
            times: Seconds of each pose, one a line; None: `NAME.times.txt` or `times.txt` beside the poses, otherwise
                the numbers of the lines, 1 s apart.

        Raises:
            InputError: If a file cannot be read; names the line.
        """
        found = cls._of_file(path, TrajectoryFormat.KITTI)
        return found if times is None else replace(found, stamps_ns=read_times(Path(times), len(found)))

    @classmethod
    def from_euroc(cls, path: PathLike) -> Self:
        """Read a EuRoC csv: nanoseconds, position, quaternion scalar first.

        Raises:
            InputError: If it cannot be read; names the line.
        """
        return cls._of_file(path, TrajectoryFormat.EUROC)

    @classmethod
    def from_evo(cls, path: PathLike, role: str = "estimate") -> Self:
        """Read the estimate or the `truth` of a result of evo that holds its trajectories.

        Raises:
            InputError: If it cannot be read, or has no trajectories.
        """
        return cls._of_file(path, TrajectoryFormat.EVO, role)

    @classmethod
    def _of_file(cls, path: PathLike, kind: TrajectoryFormat, role: str = "estimate") -> Self:
        loaded = read_trajectory_file(Path(path), role)
        if loaded.format is not kind:
            raise InputError(f"{loaded.text}: this is not {kind}; Trajectory.load() reads every format")
        return cls._of(loaded.trajectory)

    @classmethod
    def _of(cls, poses: base.Trajectory) -> Self:
        return cls(poses.stamps_ns, poses.positions, poses.quats_xyzw)

    @classmethod
    def from_csv(cls, path: PathLike) -> Self:
        """Read a csv of the suite, as `sfr localise` writes it.

        Raises:
            InputError: If it cannot be read; names the line.
        """
        return cls._of_file(path, TrajectoryFormat.CSV)

    def to_tum(self, path: PathLike) -> None:
        """Write a TUM file.

        Raises:
            OutputError: If it cannot be written.
        """
        save_trajectory(Path(path), self, TrajectoryFormat.TUM)

    def to_kitti(self, path: PathLike) -> None:
        """Write KITTI poses, and their stamps beside them as `NAME.times.txt`.

        Raises:
            OutputError: If they cannot be written.
        """
        save_trajectory(Path(path), self, TrajectoryFormat.KITTI)

    def to_euroc(self, path: PathLike) -> None:
        """Write a EuRoC csv.

        Raises:
            OutputError: If it cannot be written.
        """
        save_trajectory(Path(path), self, TrajectoryFormat.EUROC)

    def to_csv(self, path: PathLike) -> None:
        """Write a csv of the suite.

        Raises:
            OutputError: If it cannot be written.
        """
        save_trajectory(Path(path), self, TrajectoryFormat.CSV)
