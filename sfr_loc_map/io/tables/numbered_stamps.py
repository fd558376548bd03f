"""Stamps of poses that have only numbers of lines or frames, from a file of times beside the poses."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.inputs import parent_of, read_table
from sfr_loc_map.io.stamps.stamp_text import STAMP_LIMIT, StampParser
from sfr_loc_map.io.tables.text_table import RowForm, TableRows, parse_table
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted

MAX_FRAME = STAMP_LIMIT // NS_PER_S - 1  #: Largest frame number: frames without times are 1 s apart.
LONGEST_TIME_STEP_NS = 10 * NS_PER_S
"""Longest step, ns, of whole seconds in a file of times; longer steps indicate milliseconds or microseconds."""


class PoseStamps(NamedTuple):
    """The stamps of the poses in a table."""

    stamps_ns: IntArray  #: `(N,)`
    origin: str = ""  #: Origin of the stamps for messages, if the table itself has none: the file of times, or numbers.
    by_index: bool = False  #: Whether the stamps are only numbers of lines or frames, 1 s apart.


def stamps_of_lines(path: Path, rows: TableRows) -> PoseStamps:
    """Return the stamps of poses without stamps and frame numbers.

    They are the times in a file beside `path`, one for each row, or 1 s apart if there is no such file.
    """
    return _stamps_of_numbers(path, rows.row_numbers, "line", rows.row_count)


def stamps_of_frames(path: Path, rows: TableRows, frames: FloatArray) -> PoseStamps:
    """Return the stamps of poses with frame numbers `(N,)`; InputError if a number is negative or not whole."""
    numbers = _whole_numbers(rows, frames)
    is_consecutive = len(numbers) > 0 and int(numbers[-1]) + 1 == rows.row_count
    return _stamps_of_numbers(path, numbers, "frame", rows.row_count if is_consecutive else None)


def _whole_numbers(rows: TableRows, frames: FloatArray) -> IntArray:
    """Return frame numbers as integers `(N,)`; InputError if one is not a whole number from 0 to `MAX_FRAME`."""
    is_invalid = (frames < 0.0) | (frames > MAX_FRAME) | (frames != np.floor(frames))
    if is_invalid.any():
        first = int(np.argmax(is_invalid))
        raise InputError(
            f"{rows.name} line {rows.lines[first]}: the frame number is {frames[first]:.9g}:",
            f"a whole number from 0 to {MAX_FRAME} is required",
        )
    return frames.astype(np.int64)


def _stamps_of_numbers(path: Path, numbers: IntArray, numbers_of: str, count: int | None) -> PoseStamps:
    """Return the stamps of numbered poses from a file of seconds, or 1 s apart if there is no such file.

    `numbers_of` states what is numbered: "line" or "frame". `count` is the required number of times in the file of
    seconds: the number of rows, including skipped rows; None if the frame numbers are not consecutive.
    """
    benchmark = parent_of(parent_of(path)) / "sequences" / path.stem / "times.txt"
    files = (times_beside(path), path.with_name("times.txt"), benchmark)
    times = next((file for file in files if file.is_file() and file != path), None)
    if times is None:
        return PoseStamps(numbers * NS_PER_S, f"{numbers_of} numbers, 1 s apart", by_index=True)
    stamps_ns = read_times(times, count)
    if len(numbers) and int(numbers.max()) >= len(stamps_ns):
        raise InputError(
            f"'{times}' has {counted(len(stamps_ns), 'time')}, but '{path}' has a pose of image {int(numbers.max())}:",
            "give the times of all images",
        )
    return PoseStamps(stamps_ns[numbers], str(times))


def times_beside(path: Path) -> Path:
    """Return the path of the file with the stamps of KITTI poses."""
    return path.with_name(f"{path.stem}.times.txt")


def read_times(path: Path, count: int | None = None) -> IntArray:
    """Return the stamps in a file of seconds, `(N,)` ns."""
    blocks = read_table(path, "give the seconds of each pose")
    rows = parse_table(blocks, f"'{path}'", RowForm("seconds", (0,), StampParser.of("s")))
    if count not in (None, len(rows.lines)):
        raise InputError(
            f"'{path}' has {len(rows.lines)} times for {count} poses:", "one time for each pose is required"
        )
    steps_ns = np.diff(rows.stamps_ns)
    if len(steps_ns) > 1 and np.median(steps_ns) > LONGEST_TIME_STEP_NS and not (rows.stamps_ns % NS_PER_S).any():
        raise InputError(
            f"'{path}' has whole numbers that are {np.median(steps_ns) / NS_PER_S:g} apart: seconds are required;",
            "are the times in milliseconds or microseconds?",
        )
    return rows.stamps_ns
