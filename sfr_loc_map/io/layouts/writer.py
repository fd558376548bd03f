"""The common part of layout writers: tables are written line by line, the truth at the end."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Self

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory


class TableWriter:
    """Context manager that writes a folder of images and tables. Tables are written line by line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tables: dict[Path, IO[str]] = {}
        self._truth: list[tuple[int, FloatArray, FloatArray]] = []

    def __enter__(self) -> Self:
        self._path.mkdir(exist_ok=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._finish()
        for stream in self._tables.values():
            stream.close()

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Ignore the rig of mapping pairs, which KITTI and EuRoC do not have."""

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Ignore a mapping pair, which KITTI and EuRoC do not have."""

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Add a true pose of RB in DS; the truth is written at the end."""
        self._truth.append((stamp_ns, position, quat_xyzw))

    @property
    def _true_poses(self) -> Trajectory:
        stamps_ns, positions, quats = (np.array(column) for column in zip(*self._truth, strict=True))
        return Trajectory(stamps_ns, positions, quats)

    def _finish(self) -> None:
        """Write the files that require all data."""

    def append(self, name: str, row: str, header: str = "") -> None:
        """Append a row to the table `name` in the folder; the first row is preceded by the header."""
        path = self._path / name
        if path not in self._tables:
            path.parent.mkdir(exist_ok=True)
            self._tables[path] = path.open("w", encoding="utf-8", newline="\n")
            self._tables[path].write(header + "\n" if header else "")
        self._tables[path].write(row + "\n")
