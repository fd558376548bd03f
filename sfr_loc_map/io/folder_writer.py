"""Writes a drive and mapping pairs as a data set folder, as a stream."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from sfr_loc_map.geometry.rotation import quat_conjugate
from sfr_loc_map.geometry.stereo import GreyImage, NavPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.folder import LOC_COLUMNS, NAV_COLUMNS, TRUTH_COLUMN
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.rig_file import rig_json
from sfr_loc_map.io.trajectory_file import save_trajectory


class FolderWriter:
    """A data set folder that is being written; a context manager.

    With one task the files are in the folder itself, with both in `loc/` and `nav/`. The memory does not grow with
    the number of pairs.
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
        self._lists: dict[Path, IO[str]] = {}
        self._counts: dict[Path, int] = {}

    def __enter__(self) -> FolderWriter:
        """Make the folder."""
        self._path.mkdir(exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the lists of pairs."""
        for stream in self._lists.values():
            stream.close()

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the rig of the localisation cameras; comes before their first pair."""
        self._start(self._loc, rig, LOC_COLUMNS)

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Write the rig of the navigation cameras; comes before their first pair."""
        self._start(self._nav, rig, (*NAV_COLUMNS, TRUTH_COLUMN))

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        self._write_row(self._loc, [str(pair.stamp_ns), *self._write_pictures(self._loc, pair)])
        self._counts[self._loc] += 1

    def write_nav_pair(self, nav: NavPair) -> None:
        """Write a mapping pair with its pose and truth."""
        folder = self._nav
        attitude = quat_conjugate(nav.T_lm_navsb.file_quat_xyzw)  # att_q_LmToNavsb, see docs/conventions
        numbers = [repr(value) for value in (*nav.T_lm_navsb.translation.tolist(), *attitude.tolist())]
        truth = ""
        if nav.truth is not None:
            truth = f"truth/{self._counts[folder]:06d}.npy"
            (folder / "truth").mkdir(exist_ok=True)
            np.save(folder / truth, np.asarray(nav.truth, np.float32))
        self._write_row(folder, [str(nav.pair.stamp_ns), *self._write_pictures(folder, nav.pair), *numbers, truth])
        self._counts[folder] += 1

    def write_truth(self, trajectory: Trajectory) -> None:
        """Write the true trajectory of the drive."""
        self._loc.mkdir(exist_ok=True)
        save_trajectory(self._loc / "groundtruth.csv", trajectory)

    def _start(self, folder: Path, rig: StereoRig, columns: tuple[str, ...]) -> None:
        for name in (".", "left", "right"):
            (folder / name).mkdir(exist_ok=True)
        (folder / "rig.json").write_text(rig_json(rig), encoding="utf-8")
        self._lists[folder] = (folder / "pairs.csv").open("w", encoding="utf-8", newline="\n")
        self._counts[folder] = 0
        self._write_row(folder, columns)

    def _write_row(self, folder: Path, words: list[str] | tuple[str, ...]) -> None:
        self._lists[folder].write(",".join(words) + "\n")

    def _write_pictures(self, folder: Path, pair: StereoPair) -> list[str]:
        names = [f"{side}/{self._counts[folder]:06d}.png" for side in ("left", "right")]
        pictures: tuple[GreyImage, GreyImage] = (pair.left, pair.right)
        for name, picture in zip(names, pictures, strict=True):
            (folder / name).write_bytes(encode_png(picture))
        return names
