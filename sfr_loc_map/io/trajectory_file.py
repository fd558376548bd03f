"""Trajectories as files; which format one has follows from its content.

| format | is |
|---|---|
| `csv` | header `stamp_ns,rbOriginPos_m_Ds_{x,y,z},att_q_DsToRb_{1..4}`, scalar last |
| `tum` | `t x y z qx qy qz qw`, t in seconds, orientation as in ROS messages |
| `kitti` | twelve numbers a line, the first three rows of a pose matrix, no stamps (Geiger et al. 2012) |
| `euroc` | csv with nanoseconds and quaternions scalar first (Burri et al. 2016); what follows them is left out |
| `columns` | csv of a total station or a motion capture: a header names its columns and their units |

`att_q_DsToRb` turns components in DS into components in RB: the conjugate of the orientation in ROS messages. KITTI
has poses of the left camera in its first frame: x right, y down, z forward; here both frames get the axes of the suite
(x forward, y left, z up), so that a heading is one. That changes neither an absolute nor a relative pose error.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from enum import StrEnum
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.plausibility import plausible_positions, plausible_rotations
from sfr_loc_map.geometry.rotation import matrix_from_quat, quat_from_matrix
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S, read_table, refusing
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.io.text_table import BOM, parse_number, parse_seconds, parse_stamp_ns, parse_table, seconds_text

CSV_HEADER = "stamp_ns,rbOriginPos_m_Ds_x,rbOriginPos_m_Ds_y,rbOriginPos_m_Ds_z," + ",".join(
    f"att_q_DsToRb_{i}" for i in (1, 2, 3, 4)
)
TUM_HEADER = "# t x y z qx qy qz qw"
EUROC_HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
KITTI_COLUMNS = 12
CONJUGATED = np.array([-1.0, -1.0, -1.0, 1.0])
"""What makes orientations as in ROS messages of `att_q_DsToRb`, and back."""
TUM_SUFFIXES = (".txt", ".tum")
KITTI_SUFFIX, EUROC_SUFFIX = ".kitti", ".euroc.csv"
FILE_SUFFIXES = (".csv", *TUM_SUFFIXES, KITTI_SUFFIX)  #: Endings of names of trajectory files.
HEAD_BYTES = 10_000  #: The format and the header are looked for in these.


class TrajectoryFormat(StrEnum):
    """How a trajectory file is written."""

    CSV = "csv"
    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    COLUMNS = "columns"


ANNOUNCED = (TrajectoryFormat.KITTI, TrajectoryFormat.EUROC, TrajectoryFormat.COLUMNS)
"""Formats of which a command says that it has found them."""
WORDS = {
    TrajectoryFormat.CSV: "csv of the suite",
    TrajectoryFormat.TUM: "TUM",
    TrajectoryFormat.KITTI: "KITTI poses of the left camera, turned to x forward, y left, z up",
    TrajectoryFormat.EUROC: "EuRoC csv",
    TrajectoryFormat.COLUMNS: "csv with named columns",
}
COLUMN_NAMES = {
    "t": ("t", "time", "timestamp", "stamp"),
    "x": ("x", "px", "tx", "posx", "positionx", "east", "easting", "e"),
}
COLUMN_NAMES |= {"y": ("y", "py", "ty", "posy", "positiony", "north", "northing", "n")}
COLUMN_NAMES |= {"z": ("z", "pz", "tz", "posz", "positionz", "up", "height", "h", "elevation")}
COLUMN_NAMES |= {f"q{axis}": (f"q{axis}", f"quat{axis}", f"orientation{axis}") for axis in "xyzw"}
"""Columns of a csv with a header, and how their names may be written, without case, `_`, `.` and spaces."""
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
TIMES = {"s": NS_PER_S, "sec": NS_PER_S, "seconds": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}
UTC_UNIT = "utc"  #: Unit of times written as `2026-05-04 10:22:01.25`.
_UNIT = re.compile(r"^#?\s*(.*?)\s*(?:\[(\w+)\]|\((\w+)\)|_(m|cm|mm|s|sec|ms|us|ns|utc))?$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrajectory:
    """A trajectory as read."""

    path: Path  #: Its file.
    trajectory: Trajectory  #: The poses.
    format: TrajectoryFormat = TrajectoryFormat.CSV  #: How it was written.
    stamps: str = ""  #: Where its stamps come from, in words, where the file does not have them.
    by_index: bool = False  #: Whether the stamps are only the numbers of the lines.

    @property
    def text(self) -> str:
        """What was detected, in one line."""
        stamps = f", stamps: {self.stamps}" if self.stamps else ""
        return f"{self.path}: {WORDS[self.format]}, {len(self.trajectory)} poses{stamps}"

    def with_stamps_of(self, other: LoadedTrajectory) -> LoadedTrajectory:
        """Return poses that have no stamps of their own with those of another trajectory, one by one."""
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


def read_trajectory_file(path: Path, columns: str = "") -> LoadedTrajectory:
    """Read a trajectory; its first bytes, else its name, tell the format. Stamps come as they are, in any order.

    `columns` names those of a csv with a header: `t=Time[s],x=E[m],y=N[m],z=H[m]`, and `qx` to `qw` where there.
    """
    path = Path(path)
    name = f"'{path}'"
    rest = read_table(path, "give a csv, TUM, KITTI or EuRoC file")
    first = next(rest, b"")
    blocks, signs = chain((first,), rest), np.ones(4)
    lines = [line.strip() for line in first[:HEAD_BYTES].removeprefix(BOM).splitlines() if line.strip()]
    header = lines[0].decode("utf-8", "replace").replace(" ", "") if lines else ""
    row = next((line for line in lines if not line.startswith(b"#")), b"")
    cells = row.split(b",")
    has_stamp = cells[0].strip().removeprefix(b"-").isdigit()
    if columns:
        return _parse_columns(path, b"".join(blocks), name, columns)
    kind = TrajectoryFormat.CSV if header == CSV_HEADER else TrajectoryFormat.TUM
    if kind is TrajectoryFormat.CSV:
        table = parse_table(blocks, name, CSV_HEADER, range(8), stamp=parse_stamp_ns, separator=",", skip=1)
        signs = CONJUGATED
    elif len(cells) == 8 and has_stamp and not header.startswith("#timestamp"):
        raise InputError(
            f"{name} has eight columns and no header: csv of the suite (scalar last, DsToRb) or EuRoC (scalar first)? "
            f"give the first line '{CSV_HEADER}' or '{EUROC_HEADER}'"
        )
    elif len(cells) >= 8 and has_stamp:
        form, kind = "timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z", TrajectoryFormat.EUROC
        places = (0, 1, 2, 3, 5, 6, 7, 4)
        table = parse_table(blocks, name, form, places, stamp=parse_stamp_ns, separator=",", more=True)
    elif len(row.split()) == KITTI_COLUMNS:
        return _parse_kitti(path, blocks, name)
    elif path.suffix == ".csv" or (header[:1] != "#" and re.search("[,;\t]", header)):
        return _parse_columns(path, b"".join(blocks), name, "")
    else:
        table = parse_table(blocks, name, TUM_HEADER[2:], range(8), stamp=parse_seconds)
    if not len(table.lines):
        raise InputError(f"{name} has no pose: at least one line with one is needed")
    return LoadedTrajectory(path, table.trajectory(signs), kind)


def _parse_kitti(path: Path, blocks: Iterable[bytes], name: str) -> LoadedTrajectory:
    """Return KITTI poses with stamps from a file of seconds; without one the numbers of the lines, 1 s apart."""
    table = parse_table(blocks, name, "the first three rows of a pose matrix (KITTI)", range(KITTI_COLUMNS))
    matrices = table.values.reshape(-1, 3, 4)
    good = plausible_rotations(matrices[:, :, :3]) & plausible_positions(matrices[:, :, 3])
    if not good.all():
        line = table.lines[int(np.argmin(good))]
        raise InputError(f"{name} line {line}: this is no rotation and position; correct or leave out the line")
    quats = quat_from_matrix(OPTICAL_IN_BODY @ matrices[:, :, :3] @ OPTICAL_IN_BODY.T)
    positions = matrices[:, :, 3] @ OPTICAL_IN_BODY.T
    benchmark = path.parent.parent / "sequences" / path.stem / "times.txt"
    files = (times_beside(path), path.with_name("times.txt"), benchmark)
    times = next((file for file in files if file.is_file() and file != path), None)
    if times is None:
        stamps_ns = np.arange(len(positions), dtype=np.int64) * NS_PER_S
        said = "numbers of the lines, 1 s apart"
    else:
        stamps_ns, said = read_times(times, len(positions)), str(times)
    return LoadedTrajectory(path, Trajectory(stamps_ns, positions, quats), TrajectoryFormat.KITTI, said, times is None)


def _parse_columns(path: Path, data: bytes, name: str, columns: str) -> LoadedTrajectory:
    """Return poses, or positions, of a csv whose header names its columns, or as `columns` says; no unit is guessed."""
    lines = data.removeprefix(BOM).decode("utf-8", "replace").splitlines()
    first = next((k for k, line in enumerate(lines) if line.strip()), 0)
    header = lines[first] if lines else ""
    separator = max(",;\t", key=header.count)
    cells = [cell.strip() for cell in next(csv.reader([header], delimiter=separator), [])]
    given: dict[str, str] = {}
    for item in filter(None, columns.split(",")):
        key, _, text = (part.strip() for part in item.partition("="))
        title, mark, unit = text.rpartition("[")
        whole = text in cells  # its own unit, if any, is that of the column
        given[text if whole or not mark else title.strip()] = f"{key}[{unit}" if mark else key
        if key not in COLUMN_NAMES or not given.keys() <= set(cells):
            raise InputError(f"{name}: no column for '{item}': NAME is of {', '.join(COLUMN_NAMES)}, found {header!r}")
    found: dict[str, tuple[int, str]] = {}
    for k, cell in enumerate(given.get(cell, "") for cell in cells) if given else enumerate(cells):
        title, *units = match.groups("") if (match := _UNIT.match(cell)) else (cell,)
        word = re.sub(r"[_.\s]", "", title.lower())
        for key in (key for key, titles in COLUMN_NAMES.items() if word in titles):
            found.setdefault(key, (k, "".join(units).lower()))
    kinds = {"t": (*TIMES, UTC_UNIT), **dict.fromkeys("xyz", tuple(METRES))}
    wrong = [key for key, units in kinds.items() if key not in found or found[key][1] not in units]
    if wrong:
        raise InputError(
            f"{name} line {first + 1} is '{header[:80]}': the header '{CSV_HEADER}' is needed, or one with columns and "
            f"units of t, x, y, z ({', '.join(wrong)} not found, or without a unit), or their names: "
            "sfr score --set 'truth.columns=t=HEADER[s],x=HEADER[m],y=HEADER[m],z=HEADER[m]'"
        )
    quats = [f"q{axis}" for axis in "xyzw"]
    keys = ["x", "y", "z", *(quats if all(key in found for key in quats) else ())]
    scales = [METRES.get(found[key][1], 1.0) for key in keys]
    stamps, rows, left_out = [], [], 0
    for number, row in enumerate(csv.reader(lines[first + 1 :], delimiter=separator), first + 2):
        if not any(row) or row[0].startswith("#"):
            continue
        with refusing(f"{name} line {number}", "correct or leave out the line"):
            texts = [row[found[key][0]].strip() for key in ("t", *keys)]
            if not all(texts):  # the tracker did not see its target
                left_out += 1
                continue
            stamps.append(_stamp(texts[0], found["t"][1]))
            texts = [text.replace(",", ".") for text in texts[1:]]  # decimal commas, where something else separates
            rows.append([scale * parse_number(text) for scale, text in zip(scales, texts, strict=True)])
    if not rows:
        raise InputError(f"{name} has no pose: at least one line with one is needed")
    with refusing(name, "correct the file"):
        values = np.array(rows, np.float64)
        turns = values[:, 3:].copy() if len(keys) > 3 else np.zeros((len(values), 4))
        trajectory = Trajectory(np.array(stamps, np.int64), values[:, :3].copy(), turns)
    said = f"column '{cells[found['t'][0]]}'" + (f"; {left_out} lines without values left out" if left_out else "")
    return LoadedTrajectory(path, trajectory, TrajectoryFormat.COLUMNS, said)


def _stamp(text: str, unit: str) -> int:
    if unit == UTC_UNIT:
        moment = datetime.fromisoformat(text)
        since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
        return since // timedelta(microseconds=1) * 1000
    number = text.replace(",", ".")
    parse_number(number)
    return round(Decimal(number) * TIMES[unit])


def times_beside(path: Path) -> Path:
    """Return the name under which stamps are written beside KITTI poses."""
    return path.with_name(f"{path.stem}.times.txt")


def read_times(path: Path, count: int | None = None) -> IntArray:
    """Return the stamps of a file of seconds `(N,)`, ns."""
    blocks = read_table(path, "give the seconds of each pose")
    table = parse_table(blocks, f"'{path}'", "seconds", (0,), stamp=parse_seconds)
    if count not in (None, len(table.lines)):
        raise InputError(f"'{path}' has {len(table.lines)} times for {count} poses: one for each is needed")
    return table.stamps_ns


def format_of_name(path: Path) -> TrajectoryFormat | None:
    """Return the format in which a file of this name is written, None if that is no trajectory file."""
    if path.name.endswith(EUROC_SUFFIX):
        return TrajectoryFormat.EUROC
    kinds = {KITTI_SUFFIX: TrajectoryFormat.KITTI, ".csv": TrajectoryFormat.CSV}
    return kinds.get(path.suffix, TrajectoryFormat.TUM if path.suffix in TUM_SUFFIXES else None)


def files_written(path: Path) -> tuple[Path, ...]:
    """Return the files that a trajectory of this name is written to."""
    return (path, times_beside(path)) if format_of_name(path) is TrajectoryFormat.KITTI else (path,)


def save_trajectory(path: Path, trajectory: Trajectory, kind: TrajectoryFormat | None = None) -> None:
    """Write a trajectory, exact to the last bit; KITTI poses with their stamps beside them as `NAME.times.txt`.

    Without a `kind` the name tells it (.txt and .tum, .kitti, .euroc.csv, otherwise csv).
    """
    path = Path(path)
    kind = kind or format_of_name(path) or TrajectoryFormat.CSV
    if kind is TrajectoryFormat.KITTI:
        times = "".join(f"{seconds_text(stamp_ns)}\n" for stamp_ns in trajectory.stamps_ns.tolist())
        write_text(times, times_beside(path))
    write_text(trajectory_text(trajectory, kind), path)


def trajectory_text(trajectory: Trajectory, kind: TrajectoryFormat = TrajectoryFormat.CSV) -> str:
    """Return a trajectory as the text of a file; that of KITTI is without the stamps."""
    if kind is TrajectoryFormat.KITTI:
        rotations = OPTICAL_IN_BODY.T @ matrix_from_quat(trajectory.quats_xyzw) @ OPTICAL_IN_BODY
        matrices = np.concatenate((rotations, (trajectory.positions @ OPTICAL_IN_BODY)[:, :, None]), axis=2)
        return "".join(f"{' '.join(map(repr, row))}\n" for row in matrices.reshape(-1, KITTI_COLUMNS).tolist())
    quats, separator, header = {
        TrajectoryFormat.TUM: (trajectory.quats_xyzw, " ", TUM_HEADER),
        TrajectoryFormat.EUROC: (trajectory.quats_xyzw[:, [3, 0, 1, 2]], ",", EUROC_HEADER),
    }.get(kind, (trajectory.att_q_ds_to_rb, ",", CSV_HEADER))
    stamps: list[Any] = trajectory.stamps_ns.tolist()
    if kind is TrajectoryFormat.TUM:
        stamps = list(map(seconds_text, stamps))
    numbers = np.hstack((trajectory.positions, quats)).tolist()
    body = [f"{stamp}{separator}{separator.join(map(repr, row))}" for stamp, row in zip(stamps, numbers, strict=True)]
    return "\n".join([header, *body]) + "\n"
