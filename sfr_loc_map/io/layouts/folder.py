"""The data set folder of the suite (`sfr` format), read and written as a stream.

    rig.json            width, height, k, baseline_m, T_rb_locsb (localisation)
    pairs.csv           stamp_ns,left,right[,navsbOriginPos_m_Lm_{x,y,z},att_q_LmToNavsb_{1..4}[,truth]]
    left/*.png right/*.png truth/*.npy groundtruth.csv

A folder with both tasks holds the two as `loc/` and `nav/`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.camera_info import baseline_from_projection
from sfr_loc_map.geometry.rotation import quat_conjugate
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import MAX_TEXT_BYTES, SIDES, read_bytes, read_table, refusing
from sfr_loc_map.io.clouds.array_file import MAX_HEADER, parse_npy
from sfr_loc_map.io.images.codec import checked_points, encode_png
from sfr_loc_map.io.images.files import ImageFiles, ImageFileSequence, ImagePair, TableWriter, read_pair, whole_pairs
from sfr_loc_map.io.sequence import Source, SourceFormat
from sfr_loc_map.io.tables.text_table import BOM, parse_number, parse_stamp_ns
from sfr_loc_map.io.tables.trajectory_file import CSV_HEADER, TrajectoryFormat, read_trajectory_file, save_trajectory

LOC_COLUMNS = ("stamp_ns", "left", "right")
NAV_COLUMNS = (
    *LOC_COLUMNS,
    *(f"navsbOriginPos_m_Lm_{axis}" for axis in "xyz"),
    *(f"att_q_LmToNavsb_{i}" for i in (1, 2, 3, 4)),
)
TRUTH_COLUMN = "truth"
HEADERS = (LOC_COLUMNS, NAV_COLUMNS, (*NAV_COLUMNS, TRUTH_COLUMN))
FILES = tuple(f"{part}/{name}" for part in (".", "loc", "nav") for name in ("pairs.csv", "rig.json"))
"""Files that identify a data set folder; any of them does."""


@dataclass(frozen=True, slots=True, eq=False)
class FolderNavSequence(ImageFiles):
    """The mapping pairs of a data set folder (`sequence.NavSequence`)."""

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs, one in memory at a time."""
        depth = self.sample_depth()
        for entry in self.entries:
            if entry.T_lm_navsb is None:
                raise InputError(f"pair of stamp {entry.stamp_ns} has no pose in LM")
            truth = None if entry.truth is None else _load_point_image(entry.truth, self.rig)
            yield PosedStereoPair(read_pair(entry, self.rig, depth), entry.T_lm_navsb, truth)


def is_folder(path: Path) -> bool:
    """Return whether a path is a data set folder."""
    return any((path / name).exists() for name in FILES)


def open_folder(path: Path) -> Source:
    """Open a data set folder: of either task, or of both as `loc/` and `nav/`."""
    loc: ImageFileSequence | None = None
    nav: FolderNavSequence | None = None
    missing_loc_ns: tuple[int, ...] = ()
    missing_nav_ns: tuple[int, ...] = ()
    is_whole = (path / "pairs.csv").exists() or (path / "rig.json").exists()
    for folder in [path] if is_whole else [path / part for part in ("loc", "nav") if (path / part).is_dir()]:
        file, table, truth_file = folder / "rig.json", folder / "pairs.csv", folder / "groundtruth.csv"
        with refusing(f"cannot read '{table}'", advice := "a data set folder needs its pairs.csv"):
            text = b"".join(read_table(table, advice)).decode("utf-8-sig")
        rig = read_rig(file)

        header, *rows = [[word.strip() for word in line.split(",")] for line in text.splitlines()] or [[""]]
        if tuple(header) not in HEADERS:
            headers = " or ".join(f"'{','.join(names)}'" for names in HEADERS)
            raise InputError(f"'{table}' line 1 is '{','.join(header)}': the header must be one of {headers}")
        pairs = []
        for number, row in enumerate(rows, start=2):
            if len(row) != len(header):
                raise InputError(f"'{table}' line {number}: {len(row)} columns found where {len(header)} are required")
            of_row, T_lm_navsb = dict(zip(header, row, strict=True)), None
            with refusing(f"'{table}' line {number}", "correct or leave out the pair"):
                stamp = parse_stamp_ns(row[0])
                if len(row) > len(LOC_COLUMNS):
                    numbers = [parse_number(of_row[name]) for name in NAV_COLUMNS[3:]]
                    T_lm_navsb = Transform.from_origin_and_attitude(numbers[:3], numbers[3:])
            points = folder / of_row[TRUTH_COLUMN] if of_row.get(TRUTH_COLUMN) else None
            if points is not None and not points.is_file():  # reported at once, not after an hour of work
                raise InputError(f"'{table}' names a missing truth: {points}; restore it, or omit its name")
            pairs.append(ImagePair(stamp, folder / row[1], folder / row[2], T_lm_navsb, points))
        if not pairs:
            raise InputError(f"'{table}' lists no pair: at least one is required")
        whole, missing_ns = whole_pairs(pairs, f"'{table}'")

        if folder.name == "nav" if not is_whole else len(header) > len(LOC_COLUMNS):
            nav, missing_nav_ns = FolderNavSequence(rig, whole), missing_ns
            continue
        truth = None
        if truth_file.exists():
            loaded = read_trajectory_file(truth_file)
            truth = loaded.trajectory
            if loaded.format is not TrajectoryFormat.CSV:
                raise InputError(
                    f"'{truth_file}' line 1 is not '{CSV_HEADER}': the truth of a data set folder needs it"
                )
            if len(back := np.flatnonzero(np.diff(truth.stamps_ns) < 0)):
                before, after = truth.stamps_ns[back[0] : back[0] + 2].tolist()
                raise InputError(f"'{truth_file}': stamp {after} goes back behind {before}: stamps must be in order")
        loc, missing_loc_ns = ImageFileSequence(rig, whole, truth), missing_ns
    return Source(path, SourceFormat.FOLDER, loc, nav, missing_loc_ns, missing_nav_ns)


def _load_point_image(path: Path, rig: StereoRig) -> NDArray[np.float32]:
    with refusing(f"cannot read truth '{path}'", "a .npy file is required"):
        points = parse_npy(read_bytes(path, 24 * rig.height * rig.width + 2 * MAX_HEADER))
    if points.shape != (rig.height, rig.width, 3) or points.dtype.newbyteorder("=") != np.float32:
        raise InputError(
            f"truth '{path}' is {points.dtype} {points.shape}: float32 ({rig.height}, {rig.width}, 3) is required"
        )
    return checked_points(points, f"truth '{path}'")


class _PoseOfRig(msgspec.Struct, forbid_unknown_fields=True):
    translation_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class _RigFile(msgspec.Struct, forbid_unknown_fields=True):
    width: int
    height: int
    k: tuple[float, float, float, float, float, float, float, float, float]
    baseline_m: float
    T_rb_locsb: _PoseOfRig | None = None


def read_rig(file: Path) -> StereoRig:
    """Read a rig.json; InputError if it cannot be that of a rig."""
    with refusing(f"cannot read '{file}'", "a data set folder needs its rig.json"):
        found = msgspec.json.decode(read_bytes(file, MAX_TEXT_BYTES).removeprefix(BOM), type=_RigFile)
    with refusing(f"'{file}'"):
        fx, skew, cx, low, fy, cy, *last = found.k
        if (skew, low, *last) != (0, 0, 0, 0, 1):
            raise GeometryError(f"k is {list(found.k)}: [fx, 0, cx, 0, fy, cy, 0, 0, 1] is required")
        pose = found.T_rb_locsb
        T_rb_sb = None if pose is None else Transform.from_quat(pose.translation_m, pose.quat_xyzw)
        # as it comes out of camera_info messages: a rig from a file and one from topics are equal to the last digit
        baseline_m = baseline_from_projection(fx, -(fx * found.baseline_m)) if fx else found.baseline_m
        return StereoRig(found.width, found.height, fx, fy, cx, cy, baseline_m, T_rb_sb)


def rig_json(rig: StereoRig) -> str:
    """Return the text of the rig.json that `open_folder` reads as this rig."""
    content: dict[str, Any] = {
        "width": rig.width,
        "height": rig.height,
        "k": rig.camera_matrix.reshape(-1).tolist(),
        "baseline_m": rig.baseline_m,
    }
    if rig.T_rb_sb is not None:
        pose = rig.T_rb_sb
        content["T_rb_locsb"] = {"translation_m": pose.translation.tolist(), "quat_xyzw": pose.file_quat_xyzw.tolist()}
    return json.dumps(content, indent=1) + "\n"


def image_names(index: int) -> list[str]:
    """Return the files of the images of a pair, left and right."""
    return [f"{side}/{index:06d}.png" for side in SIDES]


def pair_row(stamp_ns: int, index: int, T_lm_navsb: Transform | None = None, truth: str = "") -> list[str]:
    """Return a row of pairs.csv: `LOC_COLUMNS`, or `NAV_COLUMNS` and `TRUTH_COLUMN` of a pair with its pose."""
    row = [str(stamp_ns), *image_names(index)]
    if T_lm_navsb is None:
        return row
    attitude = quat_conjugate(T_lm_navsb.file_quat_xyzw)  # att_q_LmToNavsb, see docs/conventions
    return [*row, *map(repr, (*T_lm_navsb.translation.tolist(), *attitude.tolist())), truth]


class FolderWriter(TableWriter):
    """A data set folder that is being written, as a stream; with both tasks in `loc/` and `nav/`. A context manager."""

    def __init__(self, path: Path, *, loc: bool, nav: bool) -> None:
        super().__init__(path)
        self._loc, self._nav = ("loc", "nav") if loc and nav else (".", ".")
        self._loc_count = 0
        self._nav_rows: list[list[str]] = []

    def _finish(self) -> None:
        has_truth = any(row[-1] for row in self._nav_rows)
        header = (*NAV_COLUMNS, TRUTH_COLUMN) if has_truth else NAV_COLUMNS
        for row in self._nav_rows:
            self.append(f"{self._nav}/pairs.csv", ",".join(row[: len(header)]), ",".join(header))
        if self._truth:
            save_trajectory(self._path / self._loc / "groundtruth.csv", self._true_poses)

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the rig of the localisation cameras; comes before their first pair."""
        self._start(self._loc, rig)

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Write the rig of the navigation cameras; comes before their first pair."""
        self._start(self._nav, rig)

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive."""
        self._write_images(self._loc, self._loc_count, pair)
        self.append(f"{self._loc}/pairs.csv", ",".join(pair_row(pair.stamp_ns, self._loc_count)), ",".join(LOC_COLUMNS))
        self._loc_count += 1

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Write a mapping pair with its pose and truth."""
        index, truth = len(self._nav_rows), ""
        if nav.truth is not None:
            truth = f"truth/{index:06d}.npy"
            (self._path / self._nav / "truth").mkdir(exist_ok=True)
            np.save(self._path / self._nav / truth, np.asarray(nav.truth, np.float32))
        self._write_images(self._nav, index, nav.pair)
        self._nav_rows.append(pair_row(nav.pair.stamp_ns, index, nav.T_lm_navsb, truth))

    def _start(self, part: str, rig: StereoRig) -> None:
        for name in (".", *SIDES):
            (self._path / part / name).mkdir(exist_ok=True)
        (self._path / part / "rig.json").write_text(rig_json(rig), encoding="utf-8")

    def _write_images(self, part: str, index: int, pair: StereoPair) -> None:
        for name, image in zip(image_names(index), (pair.left, pair.right), strict=True):
            (self._path / part / name).write_bytes(encode_png(image))
