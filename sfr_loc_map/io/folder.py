"""The data set folder of the suite (`sfr` format).

    rig.json            width, height, k, baseline_m, T_rb_locsb (localisation)
    pairs.csv           stamp_ns,left,right[,navsbOriginPos_m_Lm_{x,y,z},att_q_LmToNavsb_{1..4}[,truth]]
    left/*.png right/*.png truth/*.npy groundtruth.csv

A folder with both tasks holds the two as `loc/` and `nav/`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_bytes, read_table
from sfr_loc_map.io.array_file import MAX_HEADER, parse_npy
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_file_sequence import whole_pairs
from sfr_loc_map.io.point_image import checked_points
from sfr_loc_map.io.rig_file import load_rig
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.text_numbers import parse_number, parse_stamp_ns
from sfr_loc_map.io.trajectory_file import check_order, load_trajectory

LOC_COLUMNS = ("stamp_ns", "left", "right")
NAV_COLUMNS = (
    *LOC_COLUMNS,
    *(f"navsbOriginPos_m_Lm_{axis}" for axis in "xyz"),
    *(f"att_q_LmToNavsb_{i}" for i in (1, 2, 3, 4)),
)
TRUTH_COLUMN = "truth"


@dataclass(frozen=True, slots=True)
class _Entry:
    """One line of pairs.csv."""

    stamp_ns: int
    left: Path
    right: Path
    T_lm_navsb: Transform | None
    truth: Path | None


class FolderLocSequence:
    """The drive of a data set folder."""

    def __init__(self, folder: Path) -> None:
        """Read everything but the images.

        Raises:
            InputError: If a file is missing or broken, or stamps go backwards.
        """
        self._rig = load_rig(folder / "rig.json")
        self._entries, self.left_out = _load_pairs(folder)
        self._truth = _load_truth(folder / "groundtruth.csv")

    @property
    def rig(self) -> StereoRig:
        """Rig of the localisation cameras."""
        return self._rig

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses of RB in DS, or None."""
        return self._truth

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, in their order."""
        return tuple(entry.stamp_ns for entry in self._entries)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self._entries)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs, one in memory at a time.

        Raises:
            InputError: If an image is broken or not of the rig's size.
        """
        for entry in self._entries:
            yield _load_pair(entry, self._rig)


class FolderNavSequence:
    """The mapping pairs of a data set folder."""

    def __init__(self, folder: Path) -> None:
        """Read everything but the images and the truth.

        Raises:
            InputError: If a file is missing or broken, or stamps go backwards.
        """
        self._rig = load_rig(folder / "rig.json")
        self._entries, self.left_out = _load_pairs(folder)

    @property
    def rig(self) -> StereoRig:
        """Rig of the navigation cameras."""
        return self._rig

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, in their order."""
        return tuple(entry.stamp_ns for entry in self._entries)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self._entries)

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs, one in memory at a time.

        Raises:
            InputError: If an image or truth is broken or not of the rig's size.
        """
        for entry in self._entries:
            if entry.T_lm_navsb is None:
                raise InputError(f"pair of stamp {entry.stamp_ns} has no pose in LM")
            truth = None if entry.truth is None else _load_point_image(entry.truth, self._rig)
            yield PosedStereoPair(_load_pair(entry, self._rig), entry.T_lm_navsb, truth)


def is_folder(path: Path) -> bool:
    """Tell whether a path looks like a data set folder."""
    return any((path / part / name).exists() for part in (".", "loc", "nav") for name in ("pairs.csv", "rig.json"))


def open_folder(path: Path) -> Source:
    """Open a data set folder: of either task, or of both as `loc/` and `nav/`.

    Raises:
        InputError: If a file is missing or broken.
    """
    loc: FolderLocSequence | None = None
    nav: FolderNavSequence | None = None
    if (path / "pairs.csv").exists() or (path / "rig.json").exists():
        if NAV_COLUMNS[3] in _header(path / "pairs.csv"):
            nav = FolderNavSequence(path)
        else:
            loc = FolderLocSequence(path)
    else:
        loc = FolderLocSequence(path / "loc") if (path / "loc").is_dir() else None
        nav = FolderNavSequence(path / "nav") if (path / "nav").is_dir() else None
    return Source(path, "sfr", loc, nav, sum(part.left_out for part in (loc, nav) if part is not None))


def check_size(image: GreyImage, rig: StereoRig, name: str) -> None:
    """Check that an image has the rig's size.

    Raises:
        InputError: If not.
    """
    if image.shape != (rig.height, rig.width):
        found = f"{image.shape[1]} x {image.shape[0]}"
        raise InputError(f"{name} is {found}: its rig says {rig.width} x {rig.height}; both images need the rig's size")


def _load_pair(entry: _Entry, rig: StereoRig) -> StereoPair:
    images = []
    for path in (entry.left, entry.right):
        image = read_grey(path)
        check_size(image, rig, f"image '{path}' (stamp {entry.stamp_ns})")
        images.append(image)
    return StereoPair(entry.stamp_ns, *images)


def _load_point_image(path: Path, rig: StereoRig) -> NDArray[np.float32]:
    try:
        points = parse_npy(read_bytes(path, 24 * rig.height * rig.width + 2 * MAX_HEADER))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read truth '{path}': {error}; a .npy file is needed") from error
    if points.shape != (rig.height, rig.width, 3) or points.dtype.newbyteorder("=") != np.float32:
        raise InputError(
            f"truth '{path}' is {points.dtype} {points.shape}: float32 ({rig.height}, {rig.width}, 3) is needed"
        )
    return checked_points(points, f"truth '{path}'")


def _load_truth(path: Path) -> Trajectory | None:
    if not path.exists():
        return None
    truth = load_trajectory(path)
    check_order(truth.stamps_ns.tolist(), f"'{path}'", strict=False)
    return truth


def _header(path: Path) -> list[str]:
    return _read_rows(path)[0]


def _read_rows(path: Path) -> list[list[str]]:
    try:
        text = io.StringIO(read_table(path).decode("utf-8-sig"), newline="")
        rows = [[word.strip() for word in row] for row in csv.reader(text)]
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read '{path}': {reason}; a data set folder needs its pairs.csv") from error
    if not rows or not rows[0]:
        raise InputError(f"'{path}' is empty: a header {','.join(LOC_COLUMNS)} and a line for each pair are needed")
    return rows


def _load_pairs(folder: Path) -> tuple[list[_Entry], int]:
    path = folder / "pairs.csv"
    header, *rows = _read_rows(path)
    allowed = (LOC_COLUMNS, NAV_COLUMNS, (*NAV_COLUMNS, TRUTH_COLUMN))
    if tuple(header) not in allowed:
        raise InputError(f"'{path}' line 1 is '{','.join(header)}': the header must be one of {_headers(allowed)}")
    entries = []
    for number, row in enumerate(rows, start=2):
        if row:
            if len(row) != len(header):
                raise InputError(f"'{path}' line {number}: {len(row)} columns found where {len(header)} are needed")
            entries.append(_entry(folder, f"'{path}' line {number}", dict(zip(header, row, strict=True))))
    if not entries:
        raise InputError(f"'{path}' lists no pair: at least one is needed")
    check_order([entry.stamp_ns for entry in entries], f"'{path}'", strict=True)
    _check_truth(path, entries)
    return whole_pairs(entries, f"'{path}'")


def _headers(allowed: tuple[tuple[str, ...], ...]) -> str:
    return " or ".join(f"'{','.join(names)}'" for names in allowed)


def _entry(folder: Path, where: str, row: dict[str, str]) -> _Entry:
    try:
        stamp = parse_stamp_ns(row["stamp_ns"])
    except ValueError as error:
        raise InputError(f"{where}: stamp '{row['stamp_ns']}' is not whole nanoseconds") from error
    pose = None
    if NAV_COLUMNS[3] in row:
        try:
            numbers = [parse_number(row[name]) for name in NAV_COLUMNS[3:]]
            pose = Transform.from_origin_and_attitude(numbers[:3], numbers[3:])
        except (ValueError, GeometryError) as error:
            raise InputError(f"{where}: {error}; correct or leave out the pair") from error
    truth = folder / row[TRUTH_COLUMN] if row.get(TRUTH_COLUMN) else None
    return _Entry(stamp, folder / row["left"], folder / row["right"], pose, truth)


def _check_truth(path: Path, entries: list[_Entry]) -> None:
    """Say at once that a truth is missing, not after an hour of work."""
    missing = [str(entry.truth) for entry in entries if entry.truth is not None and not entry.truth.is_file()]
    if missing:
        raise InputError(f"'{path}' names a truth that is not there: {missing[0]}; restore it, or leave out its name")
