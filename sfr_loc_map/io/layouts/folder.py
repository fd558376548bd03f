"""The data set folder of the suite (`sfr` format), read and written as a stream.

    rig.json            width, height, k, baseline_m, T_rb_locsb (localisation)
    pairs.csv           stamp_ns,left,right[,navsbOriginPos_m_Lm_{x,y,z},att_q_LmToNavsb_{1..4}[,truth]]
    left/*.png right/*.png truth/*.npy groundtruth.csv

A folder with both tasks has such a folder for each task: `loc/` and `nav/`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import quat_conjugate
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_bytes, read_table_text, refusing, split_lines
from sfr_loc_map.io.calibration.rig_file import read_rig, rig_json
from sfr_loc_map.io.clouds.array_file import MAX_HEADER, parse_npy
from sfr_loc_map.io.clouds.point_image import checked_points
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.layouts.image_files import ImageFiles, ImageFileSequence, ImagePair, complete_pairs, read_pair
from sfr_loc_map.io.layouts.writer import TableWriter
from sfr_loc_map.io.number_text import parse_number
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.stamps.stamp_checks import SHORTEST_IMAGE_STEP_NS, check_truth_order, check_unit
from sfr_loc_map.io.stamps.stamp_text import parse_stamp_ns
from sfr_loc_map.io.tables.pose_columns import CSV_HEADER
from sfr_loc_map.io.tables.trajectory_file import is_suite_table, read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_text import alternatives, counted
from sfr_loc_map.suite_names import SIDES

LOC_COLUMNS = ("stamp_ns", "left", "right")
NAV_COLUMNS = (
    *LOC_COLUMNS,
    *(f"navsbOriginPos_m_Lm_{axis}" for axis in "xyz"),
    *(f"att_q_LmToNavsb_{i}" for i in (1, 2, 3, 4)),
)
TRUTH_COLUMN = "truth"
HEADERS = (LOC_COLUMNS, NAV_COLUMNS, (*NAV_COLUMNS, TRUTH_COLUMN))


@dataclass(frozen=True, slots=True, eq=False)
class FolderNavSequence(ImageFiles):
    """The mapping pairs of a data set folder (`sequence.NavSequence`)."""

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs, with one pair in memory at a time."""
        depth = self.sample_depth()
        for entry in self.entries:
            assert entry.T_lm_navsb is not None  # checked by `open_folder`
            truth = None if entry.truth is None else _load_point_image(entry.truth, self.rig)
            yield PosedStereoPair(read_pair(entry, self.rig, depth), entry.T_lm_navsb, truth)


@dataclass(frozen=True, slots=True)
class _PairsFolder:
    """The rig and the pairs of one folder with a pairs.csv."""

    folder: Path
    rig: StereoRig
    has_poses: bool  #: Whether the header of pairs.csv is that of mapping pairs.
    pairs: list[ImagePair]
    missing_ns: tuple[int, ...]  #: Stamps of pairs that are listed but have no images.


def open_folder(path: Path, config: SourceConfig) -> Source:
    """Open a data set folder of one task, or of both tasks in `loc/` and `nav/`."""
    if (path / "pairs.csv").exists() or (path / "rig.json").exists():
        pairs = _read_pairs_folder(path)
        loc, nav = (None, pairs) if pairs.has_poses else (pairs, None)
    else:
        loc, nav = (_read_pairs_folder(path / name) if (path / name).is_dir() else None for name in ("loc", "nav"))
    if nav is not None and not nav.has_poses:
        raise InputError(
            f"'{nav.folder / 'pairs.csv'}' has no poses of the mapping cameras in the local map (LM):",
            f"add the columns {', '.join(NAV_COLUMNS[len(LOC_COLUMNS) :])} to the pairs",
        )
    drive = None
    if loc is not None:
        drive = ImageFileSequence(loc.rig, loc.pairs, loc.missing_ns)
        drive = drive.configured(path, config, _read_truth(loc.folder))
    return Source(
        path,
        SourceFormat.FOLDER,
        loc=drive,
        nav=None if nav is None else FolderNavSequence(nav.rig, nav.pairs, nav.missing_ns),
        config=config,
        own_extrinsics=None if loc is None else loc.rig.T_rb_sb,
    )


def _read_pairs_folder(folder: Path) -> _PairsFolder:
    table, advice = folder / "pairs.csv", "give a pairs.csv with the stamps and images of the pairs"
    text = read_table_text(table, advice)
    rig = read_rig(folder / "rig.json")
    header, *rows = [[word.strip() for word in line.split(",")] for line in split_lines(text)] or [[""]]
    if tuple(header) not in HEADERS:
        headers = alternatives(f"'{','.join(names)}'" for names in HEADERS)
        raise InputError(f"'{table}' line 1 is '{','.join(header)}':", f"one of the headers {headers} is required")
    pairs = []
    for number, row in enumerate(rows, start=2):
        if row == [""]:  # a blank line
            continue
        if len(row) != len(header):
            raise InputError(
                f"'{table}' line {number} has {counted(len(row), 'column')}:", f"{len(header)} are required"
            )
        pairs.append(_parse_pair(table, number, dict(zip(header, row, strict=True))))
    if not pairs:
        raise InputError(f"'{table}' lists no pair:", "at least one is required")
    check_unit([pair.stamp_ns for pair in pairs], f"'{table}'", shortest_ns=SHORTEST_IMAGE_STEP_NS)
    complete, missing_ns = complete_pairs(pairs, f"'{table}'")
    return _PairsFolder(folder, rig, len(header) > len(LOC_COLUMNS), complete, missing_ns)


def _parse_pair(table: Path, number: int, row: Mapping[str, str]) -> ImagePair:
    """Return the pair in a line of pairs.csv; `row` contains the cells by column name."""
    T_lm_navsb = None
    with refusing(f"'{table}' line {number}", "correct or remove the pair"):
        stamp_ns = parse_stamp_ns(row["stamp_ns"])
        if len(row) > len(LOC_COLUMNS):
            numbers = [parse_number(row[name]) for name in NAV_COLUMNS[len(LOC_COLUMNS) :]]
            T_lm_navsb = Transform.from_origin_and_attitude(numbers[:3], numbers[3:])
    points = table.parent / row[TRUTH_COLUMN] if row.get(TRUTH_COLUMN) else None
    if points is not None and not points.is_file():  # reported before the pairs are processed
        raise InputError(f"'{table}' names a missing truth: {points};", "restore the file or remove its name")
    return ImagePair(stamp_ns, table.parent / row["left"], table.parent / row["right"], T_lm_navsb, points)


def _read_truth(folder: Path) -> RecordedTruth | None:
    """Return the poses of groundtruth.csv; None without this file."""
    file = folder / "groundtruth.csv"
    if not file.exists():
        return None
    if not is_suite_table(file):
        raise InputError(
            f"'{file}' does not have '{CSV_HEADER}', the header of the truth of a data set folder:",
            "convert the file by sfr convert, or rename it and set truth.source",
        )
    loaded = read_trajectory_file(file)
    check_truth_order(loaded.trajectory.stamps_ns, f"'{file}'")
    return RecordedTruth(loaded.trajectory, str(file))


def _load_point_image(path: Path, rig: StereoRig) -> NDArray[np.float32]:
    with refusing(f"cannot read truth '{path}'", "a .npy file is required"):
        points = parse_npy(read_bytes(path, 24 * rig.height * rig.width + 2 * MAX_HEADER))
    if points.shape != (rig.height, rig.width, 3) or points.dtype.newbyteorder("=") != np.float32:
        raise InputError(
            f"truth '{path}' is {points.dtype} {points.shape}:", f"float32 ({rig.height}, {rig.width}, 3) is required"
        )
    return checked_points(points, f"truth '{path}'")


def image_names(index: int) -> list[str]:
    """Return the file names of the left and right image of a pair."""
    return [f"{side}/{index:06d}.png" for side in SIDES]


def pair_row(stamp_ns: int, index: int, T_lm_navsb: Transform | None = None, truth: str = "") -> list[str]:
    """Return a row of pairs.csv: `LOC_COLUMNS`, or with a pose `NAV_COLUMNS` and `TRUTH_COLUMN`."""
    row = [str(stamp_ns), *image_names(index)]
    if T_lm_navsb is None:
        return row
    attitude = quat_conjugate(T_lm_navsb.file_quat_xyzw)  # att_q_LmToNavsb: docs/conventions.md
    return [*row, *map(repr, (*T_lm_navsb.translation.tolist(), *attitude.tolist())), truth]


def pairs_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the header and the lines of pairs.csv; the column of the truth is omitted if no pair has a truth."""
    header: tuple[str, ...] = LOC_COLUMNS
    if rows and len(rows[0]) > len(LOC_COLUMNS):
        header = (*NAV_COLUMNS, TRUTH_COLUMN) if any(row[-1] for row in rows) else NAV_COLUMNS
    return [",".join(row[: len(header)]) for row in (header, *rows)]


class FolderWriter(TableWriter):
    """Context manager that writes a data set folder as a stream; two tasks are written to `loc/` and `nav/`."""

    def __init__(self, path: Path, *, loc: bool, nav: bool) -> None:
        super().__init__(path)
        self._loc, self._nav = ("loc", "nav") if loc and nav else (".", ".")
        self._loc_count = 0
        self._nav_rows: list[list[str]] = []

    def _finish(self) -> None:
        header, *lines = pairs_lines(self._nav_rows)
        for line in lines:
            self.append(f"{self._nav}/pairs.csv", line, header)
        if self._truth:
            save_trajectory(self._path / self._loc / "groundtruth.csv", self._true_poses)

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Write the rig of the localisation cameras; required before their first pair."""
        self._start(self._loc, rig)

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Write the rig of the navigation cameras; required before their first pair."""
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

    def _start(self, folder: str, rig: StereoRig) -> None:
        for name in (".", *SIDES):
            (self._path / folder / name).mkdir(exist_ok=True)
        (self._path / folder / "rig.json").write_text(rig_json(rig), encoding="utf-8")

    def _write_images(self, folder: str, index: int, pair: StereoPair) -> None:
        for name, image in zip(image_names(index), (pair.left, pair.right), strict=True):
            (self._path / folder / name).write_bytes(encode_png(image))
