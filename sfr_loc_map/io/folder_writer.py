"""Writes a drive and mapping pairs as a data set folder, as a stream."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_conjugate
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io.folder import LOC_COLUMNS, NAV_COLUMNS, TRUTH_COLUMN
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.rig_file import rig_json
from sfr_loc_map.io.trajectory_file import CSV_HEADER, csv_row


class FolderWriter:
    """A data set folder that is being written; a context manager.

    With one task the files are in the folder itself, with both in `loc/` and `nav/`. Images and the tables of the
    drive are written as they come; only the few lines of the mapping pairs are kept to the end.
    """

    def __init__(self, path: Path, *, loc: bool, nav: bool) -> None:
        """Prepare a folder.

        Args:
            path: The folder; made when the block begins.
            loc: Whether it will hold a drive.
            nav: Whether it will hold mapping pairs.
        """
        self._path = path
        self._loc = path / "loc" if loc and nav else path
        self._nav = path / "nav" if loc and nav else path
        self._tables: dict[Path, IO[str]] = {}
        self._loc_count = 0
        self._nav_rows: list[list[str]] = []

    def __enter__(self) -> FolderWriter:
        """Make the folder."""
        self._path.mkdir(exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the list of mapping pairs and close all tables."""
        if self._nav_rows:
            has_truth = any(row[-1] for row in self._nav_rows)
            header = (*NAV_COLUMNS, TRUTH_COLUMN) if has_truth else NAV_COLUMNS
            for row in self._nav_rows:
                self._append(self._nav / "pairs.csv", ",".join(header), ",".join(row[: len(header)]))
        for stream in self._tables.values():
            stream.close()

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the rig of the localisation cameras; comes before their first pair."""
        _start(self._loc, rig)

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Write the rig of the navigation cameras; comes before their first pair."""
        _start(self._nav, rig)

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        names = _write_images(self._loc, self._loc_count, pair)
        self._append(self._loc / "pairs.csv", ",".join(LOC_COLUMNS), ",".join([str(pair.stamp_ns), *names]))
        self._loc_count += 1

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Write a mapping pair with its pose and truth."""
        index, truth = len(self._nav_rows), ""
        attitude = quat_conjugate(nav.T_lm_navsb.file_quat_xyzw)  # att_q_LmToNavsb, see docs/conventions
        numbers = [repr(value) for value in (*nav.T_lm_navsb.translation.tolist(), *attitude.tolist())]
        if nav.truth is not None:
            truth = f"truth/{index:06d}.npy"
            (self._nav / "truth").mkdir(exist_ok=True)
            np.save(self._nav / truth, np.asarray(nav.truth, np.float32))
        names = _write_images(self._nav, index, nav.pair)
        self._nav_rows.append([str(nav.pair.stamp_ns), *names, *numbers, truth])

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Write one true pose of RB in DS; comes after the rig of the localisation cameras."""
        self._append(self._loc / "groundtruth.csv", CSV_HEADER, csv_row(stamp_ns, position, quat_xyzw))

    def _append(self, path: Path, header: str, row: str) -> None:
        if path not in self._tables:
            self._tables[path] = path.open("w", encoding="utf-8", newline="\n")
            self._tables[path].write(header + "\n")
        self._tables[path].write(row + "\n")


def _start(folder: Path, rig: StereoRig) -> None:
    for name in (".", "left", "right"):
        (folder / name).mkdir(exist_ok=True)
    (folder / "rig.json").write_text(rig_json(rig), encoding="utf-8")


def _write_images(folder: Path, index: int, pair: StereoPair) -> list[str]:
    names = [f"{side}/{index:06d}.png" for side in ("left", "right")]
    for name, image in zip(names, (pair.left, pair.right), strict=True):
        (folder / name).write_bytes(encode_png(image))
    return names
