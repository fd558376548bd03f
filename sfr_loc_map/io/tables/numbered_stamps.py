"""Stamps of poses that have only numbers of lines or frames, from a file of times beside the poses."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.inputs import parent_of, read_table
from sfr_loc_map.io.tables.pose_columns import PoseColumns
from sfr_loc_map.io.tables.stamps import parse_seconds
from sfr_loc_map.io.tables.text_table import Table, parse_table
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted

LONGEST_TIME_STEP_NS = (
    10 * NS_PER_S
)  #: Longest step, ns, of whole seconds in a file of times; longer steps indicate ms or us.


class NumberedStamps(NamedTuple):
    """The stamps of numbered poses."""

    stamps_ns: IntArray  #: `(N,)`
    origin: str  #: Origin of the stamps for messages: the file of times, or the numbers.
    by_index: bool  #: Whether the stamps are only the numbers, 1 s apart.


def stamps_by_number(path: Path, table: Table, columns: PoseColumns) -> NumberedStamps:
    """Return the stamps of the poses in the table of a file, which have frame numbers, or only line numbers."""
    rows = len(table.lines) + len(table.skipped_lines)
    if columns.stamp_key is None:
        return _stamps_of_frames(path, table.row_numbers, "line", rows)
    _check_frame_numbers(table)
    numbers = table.stamps_ns // NS_PER_S
    is_consecutive = len(numbers) > 0 and int(numbers[-1]) + 1 == rows
    return _stamps_of_frames(path, numbers, "frame", rows if is_consecutive else None)


def _check_frame_numbers(table: Table) -> None:
    """Raise InputError if a frame number is negative or not whole; the table has frame numbers in place of seconds."""
    is_invalid = (table.stamps_ns < 0) | (table.stamps_ns % NS_PER_S != 0)
    if is_invalid.any():
        first = int(np.argmax(is_invalid))
        frame = int(table.stamps_ns[first]) / NS_PER_S
        raise InputError(
            f"{table.name} line {table.lines[first]}: the frame number is {frame:.9g}: a whole number "
            "that is 0 or larger is required"
        )


def _stamps_of_frames(path: Path, numbers: IntArray, numbers_of: str, count: int | None) -> NumberedStamps:
    """Return the stamps of numbered poses from a file of seconds, or 1 s apart if there is no such file.

    `numbers_of` states what is numbered: "line" or "frame".
    `count` is the number of times that the file of seconds must have: that of the lines with poses, including skipped
    lines. It is None if the numbers of the images are not consecutive.
    """
    benchmark = parent_of(parent_of(path)) / "sequences" / path.stem / "times.txt"
    files = (times_beside(path), path.with_name("times.txt"), benchmark)
    times = next((file for file in files if file.is_file() and file != path), None)
    if times is None:
        return NumberedStamps(numbers.astype(np.int64) * NS_PER_S, f"{numbers_of} numbers, 1 s apart", by_index=True)
    stamps_ns = read_times(times, count)
    if len(numbers) and int(numbers.max()) >= len(stamps_ns):
        raise InputError(
            f"'{times}' has {counted(len(stamps_ns), 'time')}, but '{path}' has a pose of image {int(numbers.max())}: "
            "give the times of all images"
        )
    return NumberedStamps(stamps_ns[numbers], str(times), by_index=False)


def times_beside(path: Path) -> Path:
    """Return the path of the file with the stamps of KITTI poses."""
    return path.with_name(f"{path.stem}.times.txt")


def read_times(path: Path, count: int | None = None) -> IntArray:
    """Return the stamps in a file of seconds, `(N,)` ns."""
    blocks = read_table(path, "give the seconds of each pose")
    table = parse_table(blocks, f"'{path}'", "seconds", (0,), stamp=parse_seconds)
    if count not in (None, len(table.lines)):
        raise InputError(f"'{path}' has {len(table.lines)} times for {count} poses: one time for each pose is required")
    steps_ns = np.diff(table.stamps_ns)
    if len(steps_ns) > 1 and np.median(steps_ns) > LONGEST_TIME_STEP_NS and not (table.stamps_ns % NS_PER_S).any():
        raise InputError(
            f"'{path}' has whole numbers that are {np.median(steps_ns) / NS_PER_S:g} apart: seconds are required; are "
            "the times in milliseconds or microseconds?"
        )
    return table.stamps_ns
