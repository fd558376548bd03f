"""Detection of the columns of stamps, positions and attitudes in a text table, and of their units.

A header that names columns determines the layout, with or without a comment sign. Without a header, the layout is the
only one in `LAYOUTS` that the rows fit: number of columns, unit quaternions, orthonormal rotations, increasing stamps.
If several layouts fit, or none, the error message lists them; `--columns` or `truth.columns` then names the columns:

    t=Time[s],x=East[mm],y=North[mm],z=Height[mm]      columns by name in the header, or by number: t=#1[ns]
    t[ns],x,y,z,qw,qx,qy,qz                            columns in order; _ skips a column
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_rotations
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.tables.number_text import number_or_nan
from sfr_loc_map.io.tables.stamps import (
    TIMES,
    UTC_UNIT,
    parse_decimal,
    parse_nanoseconds,
    parse_seconds,
    parse_utc,
    time_unit,
)
from sfr_loc_map.io.tables.text_table import COMMENTS, split_cells

STAMP, SECONDS, NANOSECONDS, FRAME = "t", "sec", "nsec", "frame"
SMALLER_FRACTIONS = {"us": ("usec", "microsec"), "ms": ("msec", "millisec")}
"""Units of the fraction of a second other than ns, by the beginning of the name of the column."""
POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
MATRIX = tuple(f"m{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4))
DOWN = "down"  #: A height that is positive downwards; z is its negative.
SKIPPED = "_"
NAMES: dict[str, tuple[str, ...]] = {
    STAMP: ("headerstamp", "timestamp", "stamp", "time", "t", "utime", "unixtime", "timestamps"),
    SECONDS: ("sec", "secs", "headerstampsec", "headerstampsecs", "stampsec", "timesec", "timestampsec"),
    NANOSECONDS: (
        *("nsec", "nsecs", "nanosec", "nanosecs", "headerstampnanosec", "headerstampnsecs", "stampnanosec"),
        *("usec", "usecs", "microsec", "microsecs", "microseconds", "msec", "msecs", "millisec", "millisecs"),
    ),
    "x": ("x", "px", "tx", "posx", "positionx", "translationx", "xenu", "east", "easting", "e", "prsrx"),
    "y": ("y", "py", "ty", "posy", "positiony", "translationy", "yenu", "north", "northing", "n", "prsry"),
    "z": ("z", "pz", "tz", "posz", "positionz", "translationz", "zenu", "up", "height", "h", "elevation", "prsrz"),
    DOWN: (DOWN, "zned"),
}
NAMES |= {
    f"q{axis}": (f"q{axis}", f"quat{axis}", f"quaternion{axis}", f"orientation{axis}", f"rotation{axis}", f"qrs{axis}")
    for axis in "xyzw"
}
"""Names of columns in lower case without `_`, `.`, `-` and spaces; earlier names take precedence."""
METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}
UNITS = {*METRES, *TIMES, UTC_UNIT, "rad", "deg", "-", "1"}  #: Contents of a line of units below a header.
COVARIANCES = {
    "Pr": ("attitude", ("11", "12", "13", "22", "23", "33")),
    "Pt": ("position", ("11", "12", "13", "22", "23", "33")),
}
"""Covariance columns of OpenVINS: upper triangles in rad^2 and m^2 (docs.openvins.com, "Filesystem format")."""
COVARIANCE_KEYS = tuple(f"{prefix}{index}" for prefix, (_, indices) in COVARIANCES.items() for index in indices)
_UNIT = re.compile(
    r"^[#%/\s]*(.*?)\s*(?:\[([^\[\]]*)\]|\((\w*)\)|_(m|cm|mm|km|s|sec|ms|msec|us|usec|ns|nsec|utc))?$", re.IGNORECASE
)
_SCALAR_FIRST_TEXT = re.compile(r"\bq?_?w\W+q?_?x\W+q?_?y\W+q?_?z\b|\bwxyz\b", re.IGNORECASE)
_SCALAR_LAST_TEXT = re.compile(r"\bq?_?x\W+q?_?y\W+q?_?z\W+q?_?w\b|\bxyzw\b", re.IGNORECASE)
_PREFIXES = ("field", "poseposepose", "posepose", "pose", "transform")


class TrajectoryFormat(StrEnum):
    """The formats of trajectory files."""

    CSV = "csv"
    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    COLUMNS = "columns"
    MATRIX = "matrix"


@dataclass(frozen=True, slots=True)
class Layout:
    """A layout of lines without a header."""

    name: str  #: Name in messages.
    keys: tuple[str, ...]  #: Content of the first columns.
    separator: str = ""  #: Required separator: "," (or semicolon), " " (or tab); empty: any.
    widths: tuple[int, ...] = ()  #: Allowed numbers of columns; empty: at least the number of keys.
    unit: str = ""  #: Unit of the stamps; empty: inferred from their magnitude.


_POSE = (*POSITION, *QUATERNION)
_SCALAR_FIRST = (*POSITION, "qw", "qx", "qy", "qz")
_ORDERS = (
    (TrajectoryFormat.EUROC, (STAMP, *_SCALAR_FIRST), (",",)),
    (TrajectoryFormat.TUM, (STAMP, *_POSE), (None, "\t")),
)
"""First columns and separators of the formats without matrices."""
LAYOUTS = (
    Layout("TUM (t x y z qx qy qz qw)", (STAMP, *_POSE), " "),
    Layout("TUM with commas (t,x,y,z,qx,qy,qz,qw)", (STAMP, *_POSE), ",", (8,)),
    Layout("EuRoC (t,x,y,z,qw,qx,qy,qz)", (STAMP, *_SCALAR_FIRST), ",", (8,), "ns"),
    Layout("EuRoC (t,x,y,z,qw,qx,qy,qz, velocity, biases)", (STAMP, *_SCALAR_FIRST), ",", (11, 17), "ns"),
    Layout("sec nsec x y z qx qy qz qw", (SECONDS, NANOSECONDS, *_POSE), "", (9,)),
    Layout("KITTI (3 x 4 matrix)", MATRIX, "", (12,)),
    Layout("KITTI-360 (frame and 3 x 4 matrix)", (FRAME, *MATRIX), "", (13,)),
    Layout("KITTI-360 (frame and 4 x 4 matrix)", (FRAME, *MATRIX), "", (17,)),
    Layout("MulRan (t and 3 x 4 matrix)", (STAMP, *MATRIX), "", (13,)),
    Layout("t and 4 x 4 matrix", (STAMP, *MATRIX), "", (17,)),
    Layout("t x y z", (STAMP, *POSITION), "", (4,)),
)
"""All supported layouts without a header; docs/formats.md has the same table."""
HEAD_LINES = 5000  #: Number of lines from which the layout is detected. Later rows that do not fit are invalid.
MAX_FRAME = 1e7  #: Integers below are frame numbers; larger integers are stamps.
FIT = 0.9  #: Minimum fraction of rows that must fit a layout; the others are invalid rows.
HALF_FIT = 0.5  #: Minimum fraction if no layout reaches `FIT`, so that error messages can name the invalid rows.


@dataclass(frozen=True, slots=True)
class PoseColumns:
    """The columns that are read, and their content."""

    name: str  #: Name of the layout in messages.
    separator: str | None  #: None: spaces.
    index_of: Mapping[str, int]  #: Column of each key, from 0.
    units: Mapping[str, str]  #: Unit of each key, if the header or `--columns` gives a unit.
    width: int  #: Number of columns.
    skip: int = 0  #: Number of lines before the first row.
    by_header: bool = False  #: Whether a header, `--columns` or `truth.columns` names the columns.
    ignored: tuple[str, ...] = ()  #: Names of columns that are not read.
    inferred: str = ""  #: Unit of the stamps if it was inferred from their magnitude.

    def __contains__(self, key: str) -> bool:
        return key in self.index_of

    @property
    def format(self) -> TrajectoryFormat:
        """The format with these columns, with or without a header; COLUMNS if the format has no name of its own."""
        if self.is_matrix:
            return TrajectoryFormat.KITTI if self.stamp_key is None else TrajectoryFormat.MATRIX
        for known, order, separators in _ORDERS:
            if self.separator in separators and all(self.index_of.get(key) == k for k, key in enumerate(order)):
                return known
        return TrajectoryFormat.COLUMNS

    @property
    def position_keys(self) -> tuple[str, ...]:
        """The three columns of the position."""
        return POSITION if "z" in self.index_of else ("x", "y", DOWN)

    @property
    def is_matrix(self) -> bool:
        """Whether the poses are 3 x 4 matrices."""
        return MATRIX[0] in self.index_of

    @property
    def stamp_key(self) -> str | None:
        """The column of the stamp or of the frame number; None if lines have neither."""
        return next((key for key in (STAMP, SECONDS, FRAME) if key in self.index_of), None)

    @property
    def has_covariance(self) -> bool:
        """Whether the columns contain a complete covariance."""
        return all(key in self.index_of for key in COVARIANCE_KEYS)

    @property
    def value_keys(self) -> list[str]:
        """The columns of numbers other than the stamp."""
        poses = (
            MATRIX if self.is_matrix else (*self.position_keys, *(key for key in QUATERNION if key in self.index_of))
        )
        covariances = COVARIANCE_KEYS if self.has_covariance else ()
        return [*poses, *((NANOSECONDS,) if NANOSECONDS in self.index_of else ()), *covariances]

    @property
    def fraction_ns(self) -> int:
        """Unit of the column `nsec`, ns."""
        return TIMES[self.units.get(NANOSECONDS, "ns")]

    @property
    def scales(self) -> list[float]:
        """Factors that convert the columns of the position to metres."""
        return [METRES[self.units.get(key, "")] * (-1.0 if key == DOWN else 1.0) for key in self.position_keys]

    def stamp_parser(self) -> Callable[[str], int]:
        """Return the function that converts the text of a stamp to nanoseconds."""
        unit = self.units.get(STAMP, "s")
        if unit == UTC_UNIT:
            return parse_utc
        unit_ns = TIMES[unit]
        if unit_ns == NS_PER_S:
            return parse_seconds
        return parse_nanoseconds if unit_ns == 1 else partial(parse_decimal, unit_ns=unit_ns)


def pose_columns(lines: Sequence[str], name: str, columns: str, option: str) -> PoseColumns:
    """Return the columns of a table that begins with these lines.

    `columns` is given by the user and may be empty; `option` names it in messages. InputError if neither a header nor
    a unique layout determines the columns.
    """
    lines = lines[:HEAD_LINES]
    first, separator = _first_row(lines)
    if first < 0:
        number = next((number for number, line in enumerate(lines) if line.strip()), None)
        found = "it is empty" if number is None else f"line {number + 1} is '{lines[number].strip()[:60]}'"
        raise InputError(
            f"{name} has no pose: at least one line with a pose is required, with numbers separated by commas, "
            f"semicolons, tabs or spaces; {found}: give a csv, TUM, KITTI or EuRoC file"
        )
    rows = _numbers(lines[first:], separator)
    width = max((len(cells) for cells in rows), default=0) or len(split_cells(lines[first], separator))
    if columns:
        columns_found = _by_user(lines[:first], name, columns, separator, width)
    else:
        by_header = _by_header(lines[:first], name, separator, rows, option)
        columns_found = by_header or _by_layout(lines, first, name, separator, rows, option)
    columns_found = replace(columns_found, skip=first)
    _check(columns_found, name, lines[:first], option)
    return _with_time_unit(columns_found, rows, name, option)


# ---- separators and rows


def _first_row(lines: Sequence[str]) -> tuple[int, str | None]:
    """Return the index of the first row of numbers, -1 if there is none, and the separator of its cells."""
    for number, line in enumerate(lines):
        text = line.strip()
        if not text or text.startswith(COMMENTS):
            continue
        separator = _separator(text)
        cells = split_cells(text, separator)
        numeric = sum(_is_number(cell) or not cell for cell in cells)
        if len(cells) > 1 and 2 * numeric >= len(cells) and (_is_number(cells[0]) or _is_time(cells[0])):
            return number, separator
    return -1, None


def _separator(text: str) -> str | None:
    for separator in (";", "\t", ","):
        if separator in text:
            return separator
    return None


def _is_number(text: str) -> bool:
    is_special = text.strip().lower().lstrip("+-").partition("(")[0] in ("nan", "inf")
    return is_special or math.isfinite(number_or_nan(text))


def _is_time(text: str) -> bool:
    try:
        parse_utc(text)
    except (ValueError, OverflowError):
        return False
    return True


def _numbers(lines: Sequence[str], separator: str | None) -> list[list[str]]:
    """Return the cells of the lines that are rows."""
    rows = [line.strip() for line in lines]
    return [split_cells(row, separator) for row in rows if row and not row.startswith(COMMENTS)]


# ---- a header


def split_unit(cell: str) -> tuple[str, str]:
    """Return the name and the unit of a cell of a header: `East [mm]`, `time_ns`, `Height (m)`, `usec`."""
    match = _UNIT.match(cell.strip())
    title, *units = match.groups("") if match else (cell, "")
    name, unit = str(title).strip(), "".join(units).strip().lower()
    in_name = (unit for unit, starts in SMALLER_FRACTIONS.items() if name.lower().startswith(starts))
    return name, unit or next(in_name, "")


def key_of(cell: str) -> tuple[str, int] | None:
    """Return the content of a column by its name, and the precedence of the name; None if the name is unknown."""
    title = split_unit(cell)[0]
    word = re.sub(r"[^a-z0-9]", "", title.lower())
    words = [word]
    words += [word.removeprefix(prefix) for prefix in _PREFIXES if word.startswith(prefix)]
    words += [word.removeprefix("field").removeprefix(prefix) for prefix in _PREFIXES if word.startswith("field")]
    for key, names in NAMES.items():
        for candidate in words:
            if candidate in names:
                return key, names.index(candidate)
    for prefix, (_, indices) in COVARIANCES.items():
        for index in indices:
            if title == f"{prefix}{index}":
                return title, 0
    return None


def header_cells(line: str, separator: str | None, width: int) -> list[str]:
    """Return the cells of a line that may be a header, without a comment sign."""
    text = line.strip().lstrip("#%/").strip()
    options = [separator, ",", ";", "\t", None]
    cells = [split_cells(text, option) for option in options]
    return next((found for found in cells if len(found) >= min(width, 4)), cells[0])


def _by_header(
    before: Sequence[str], name: str, separator: str | None, rows: Sequence[Sequence[str]], option: str
) -> PoseColumns | None:
    """Return the columns named by the header, or None without a header; InputError if a name occurs twice.

    The header is the last line before the rows that names a stamp, x, y, and z or down. A line of units may follow.
    """
    width = max((len(cells) for cells in rows), default=0)
    for number, line in reversed([*enumerate(before)]):
        cells = _aligned(header_cells(line, separator, width), rows, width)
        found = _named(cells)
        if found.keys() & {STAMP, SECONDS} and {"x", "y"} <= found.keys() and found.keys() & {"z", DOWN}:
            _check_names_differ(cells, found, f"{name} line {number + 1}", option)
            below = _units_below(before[number + 1 :], separator, len(cells))
            return _of_header(cells, found, below, separator, width)
    return None


def _check_names_differ(cells: Sequence[str], found: Mapping[str, int], where: str, option: str) -> None:
    """Raise InputError if several columns have the name of a column that would be read."""
    for place in found.values():
        places = [number for number, cell in enumerate(cells) if key_of(cell) == key_of(cells[place])]
        if len(places) > 1:
            numbers = " and ".join(f"#{number + 1}" for number in places)
            example = option.replace("COLUMNS", "t=#NUMBER[s],x=#NUMBER,y=#NUMBER,z=#NUMBER")
            raise InputError(f"{where}: columns {numbers} are both '{cells[place]}': name the columns: {example}")


def _units_below(lines: Sequence[str], separator: str | None, width: int) -> list[str]:
    """Return the units of the columns in a line between the header and the rows; empty without such a line.

    In a line with a unit of time, other units may be unknown. `_check` refuses them.
    """
    for line in lines:
        units = [cell.strip("()[] ").lower() for cell in header_cells(line, separator, width)]
        are_known = any(units) and all(unit in UNITS for unit in units)
        if len(units) == width and (are_known or any(unit in TIMES for unit in units)):
            return units
    return []


def _aligned(cells: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the names of a header, one for each column of the rows.

    A label before the names (`format: t x y z`) is ignored, as are names beyond the last column. Rows may begin with
    a row number that the header does not name (`write.table` of R).
    """
    names = list(cells)
    if len(names) > 1 and names[0].endswith(":"):
        names = names[1:]
    if len(names) == width - 1 and [row[0].strip('"') for row in rows] == [str(n + 1) for n in range(len(rows))]:
        names = ["", *names]
    return names[: max(width, 1)]


def _named(cells: Sequence[str]) -> dict[str, int]:
    ranked: dict[str, tuple[int, int]] = {}
    for place, cell in enumerate(cells):
        known = key_of(cell)
        if known is None:
            continue
        key, rank = known
        if key not in ranked or rank < ranked[key][0]:
            ranked[key] = (rank, place)
    return {key: place for key, (_, place) in ranked.items()}


def _of_header(
    cells: Sequence[str], found: Mapping[str, int], below: Sequence[str], separator: str | None, width: int
) -> PoseColumns:
    """Return the columns of a header; `below` has the units in the line below the header, or is empty."""
    places = dict(found)
    units = {key: split_unit(cells[place])[1] for key, place in places.items()}
    if below:
        units = {key: unit or below[places[key]] for key, unit in units.items()}
    if SECONDS in places and NANOSECONDS not in places and STAMP not in places:
        places[STAMP], units[STAMP] = places.pop(SECONDS), "s"
    if {SECONDS, NANOSECONDS} <= places.keys():
        places.pop(STAMP, None)
    if not all(key in places for key in QUATERNION) or DOWN in places:  # attitudes in NED are of another body
        places = {key: place for key, place in places.items() if key not in QUATERNION}
    units = {key: unit for key, unit in units.items() if key in places and unit}
    ignored = tuple(cell for place, cell in enumerate(cells) if place not in places.values())
    name, columns = "columns by their names", max(width, len(cells))
    return PoseColumns(name, separator, places, units, columns, by_header=True, ignored=ignored)


def _by_user(before: Sequence[str], name: str, columns: str, separator: str | None, width: int) -> PoseColumns:
    """Return the columns that the user names as `NAME=HEADER[UNIT]`, or as `NAME[UNIT]` in the order of columns."""
    items = [item.strip() for item in columns.split(",")]
    header = max((header_cells(line, separator, width) for line in before), key=len, default=[])
    ordered = not any("=" in item for item in items)
    places: dict[str, int] = {}
    units: dict[str, str] = {}
    for number, item in enumerate(items):
        key, _, text = (part.strip() for part in item.partition("="))
        if ordered:
            key, unit = split_unit(item)
            place = None if key == SKIPPED else number
        else:
            place, unit = _column(text, header)
        if key == SKIPPED:
            continue
        known = {*NAMES, FRAME, *MATRIX}
        if key in places:
            raise InputError(f"{name}: the columns name {key} twice, the second time by '{item}': name it once")
        if key not in known or place is None or place >= max(width, len(header)):
            shown = ", ".join(header) or f"{width} columns without a header"
            raise InputError(
                f"{name}: no column for '{item}': give NAME=HEADER, where NAME is t, sec, nsec, x, y, z, qx, qy, qz "
                f"or qw (_: a column that is not read), and HEADER is the title or #NUMBER of a column; "
                f"found {shown[:200]}"
            )
        places[key] = place
        units[key] = unit
    titles = [*header, *(f"#{number + 1}" for number in range(len(header), width))]
    ignored = tuple(title for place, title in enumerate(titles) if place not in places.values())
    units = {key: unit for key, unit in units.items() if unit}
    return PoseColumns("columns as given", separator, places, units, width, by_header=True, ignored=ignored)


def _column(text: str, header: Sequence[str]) -> tuple[int | None, str]:
    """Return the index and the unit of a column that the user names: `#3[mm]`, `East [mm]` or `East`.

    A column is named by its number, or by its title in the header with or without its unit. A given unit has priority
    over the unit in the header. The index is None if there is no such column.
    """
    title, unit = split_unit(text)
    without_bracket = text.rpartition("[")[0] if text.endswith("]") else text
    if re.fullmatch(r"#?[0-9]{1,4}", without_bracket.strip()) and (text.startswith("#") or not header):
        return int(without_bracket.strip(" #")) - 1, unit
    titles = [_compact(cell) for cell in header]
    titles_without_unit = [_compact(split_unit(cell)[0]) for cell in header]
    for names in (titles, titles_without_unit):
        for wanted in (text, without_bracket, title):
            if _compact(wanted) in names:
                place = names.index(_compact(wanted))
                return place, unit or split_unit(header[place])[1]
    return None, ""


def _compact(title: str) -> str:
    """Return a title in lower case without spaces and comment signs."""
    return re.sub(r"[\s#%]", "", title).lower()


# ---- without a header


def _by_layout(
    lines: Sequence[str], first: int, name: str, separator: str | None, rows: Sequence[Sequence[str]], option: str
) -> PoseColumns:
    """Return the only layout that the rows fit; InputError if no layout or several layouts fit."""
    header = _unknown_header(lines[:first])
    if header is not None:
        raise InputError(_no_names(name, lines[:first], header, option))
    has_empty_end = all(len(cells) > 1 and not cells[-1] for cells in rows)  # a separator after the last number
    widths = sorted(len(cells) - has_empty_end for cells in rows)
    width = widths[len(widths) // 2]
    table = _table([cells for cells in rows if len(cells) >= width], width)
    comma = "," if separator in (",", ";") else " "
    share = {layout: _fit(layout, table, width, comma) for layout in LAYOUTS}
    fitting = [layout for layout, fraction in share.items() if fraction >= FIT]
    fitting = fitting or [layout for layout, fraction in share.items() if fraction >= HALF_FIT]
    if len(fitting) > 1:  # rows of matrices near the identity look like unit quaternions
        fitting = [layout for layout in fitting if MATRIX[0] in layout.keys] or fitting
    if len(fitting) != 1:
        shown = lines[first].strip()[:60]
        if fitting:
            names = " or ".join(layout.name for layout in fitting)
            problem = f"has {width} columns and no header; possible layouts are {names}"
        else:
            names = "; ".join(layout.name for layout in LAYOUTS)
            problem = f"has {width} columns and no header, and fits no layout of: {names}"
        advice = option.replace("COLUMNS", "t[s],x,y,z,qx,qy,qz,qw")
        raise InputError(f"{name} {problem} (line {first + 1}: '{shown}'): name the columns: {advice}")
    layout = fitting[0]
    places = {key: place for place, key in enumerate(layout.keys)}
    stated = _stated_order(lines[:first])
    if stated is not None and "qw" in places and stated.is_scalar_first != (places["qw"] < places["qx"]):
        order = "first" if stated.is_scalar_first else "last"
        columns = "t[s],x,y,z,qw,qx,qy,qz" if stated.is_scalar_first else "t[s],x,y,z,qx,qy,qz,qw"
        problem = f"line {stated.line} states that quaternions have the scalar {order}, unlike {layout.name}"
        raise InputError(f"{name} {problem}: name the columns: {option.replace('COLUMNS', columns)}")
    extra = tuple(f"#{number + 1}" for number in range(len(layout.keys), width))
    units = {STAMP: layout.unit} if layout.unit and STAMP in places else {}
    return PoseColumns(layout.name, separator, places, units, width + has_empty_end, ignored=extra)


class _StatedOrder(NamedTuple):
    line: int  #: From 1.
    is_scalar_first: bool


def _stated_order(comments: Sequence[str]) -> _StatedOrder | None:
    """Return the order of quaternions in the last comment that states an order; None if no comment does."""
    for number, comment in reversed([*enumerate(comments, 1)]):
        for pattern, is_scalar_first in ((_SCALAR_FIRST_TEXT, True), (_SCALAR_LAST_TEXT, False)):
            if pattern.search(comment):
                return _StatedOrder(number, is_scalar_first)
    return None


def _unknown_header(before: Sequence[str]) -> int | None:
    """Return the index of the line before the rows that is probably the header; None without such a line.

    The line is not a comment. Of several lines, the first of those that name the most columns is returned.
    """
    texts = [number for number, line in enumerate(before) if line.strip() and not line.strip().startswith(COMMENTS)]
    return max(texts, key=lambda number: len(_named(header_cells(before[number], None, 4))), default=None)


def _table(rows: Sequence[Sequence[str]], width: int) -> FloatArray:
    """Return the numbers in rows; NaN if a cell is not a number."""
    table = np.full((len(rows), width), np.nan)
    for row, cells in enumerate(rows):
        for column, cell in enumerate(cells[:width]):
            table[row, column] = number_or_nan(cell)
    return table


def _fit(layout: Layout, table: FloatArray, width: int, comma: str) -> float:
    """Return the fraction of rows that fit a layout."""
    keys = layout.keys
    if (layout.separator and layout.separator != comma) or width < len(keys):
        return 0.0
    if layout.widths and width not in layout.widths:
        return 0.0
    rows = table[np.isfinite(table[:, : len(keys)]).all(axis=1)]
    if not len(rows) or (keys[0] == STAMP and not _are_stamps(layout, rows[:, 0], width)):
        return 0.0
    return float(_fitting_rows(keys, rows).mean())


def _are_stamps(layout: Layout, stamps: FloatArray, width: int) -> bool:
    """Return whether the first column `(N,)` can be the stamps of a layout that begins with stamps."""
    are_integers = bool(_is_integer(stamps).all())
    if layout.unit == "ns" and not are_integers:
        return False
    if MATRIX[0] in layout.keys and are_integers and float(stamps.max()) < MAX_FRAME:  # numbers of frames
        return False
    steps = np.diff(stamps)
    increasing, decreasing = (float(np.mean(steps * sign >= 0.0)) if len(steps) else 1.0 for sign in (1.0, -1.0))
    if layout.keys == (STAMP, *POSITION) and max(increasing, decreasing) < FIT:  # such as the rows of a 4 x 4 matrix
        return False
    has_extra_columns = width > len(layout.keys)  # the first columns of a matrix look like a stamp and a quaternion
    return not has_extra_columns or bool(len(steps) and np.mean(steps > 0.0) >= FIT)


def _fitting_rows(keys: Sequence[str], rows: FloatArray) -> Mask:
    """Return which rows `(N, K)` have a valid attitude, fraction of a second and frame number, if a layout has them."""
    index_of = {key: index for index, key in enumerate(keys)}
    fitting = np.ones(len(rows), np.bool_)
    if "qw" in index_of:
        quats = rows[:, [index_of[key] for key in QUATERNION]]
        fitting &= plausible_attitudes(quats)
    if MATRIX[0] in index_of:
        first = index_of[MATRIX[0]]
        fitting &= plausible_rotations(rows[:, first : first + 12].reshape(-1, 3, 4)[:, :, :3])
    if NANOSECONDS in index_of:
        fraction = rows[:, index_of[NANOSECONDS]]
        fitting &= (fraction >= 0.0) & (fraction < NS_PER_S) & _is_integer(fraction) & _is_integer(rows[:, 0])
    if FRAME in index_of:
        frames = rows[:, index_of[FRAME]]
        fitting &= _is_integer(frames) & (frames >= 0.0) & (frames < MAX_FRAME)
    return fitting


def _is_integer(numbers: FloatArray) -> Mask:
    return np.asarray(numbers == np.floor(numbers))


# ---- units


def _check(found: PoseColumns, name: str, before: Sequence[str], option: str) -> None:
    """Check that the required columns of a pose exist and have known units."""
    needed = ((STAMP, SECONDS, FRAME), ("x",), ("y",), ("z", DOWN))
    missing = [] if found.is_matrix else [keys[0] for keys in needed if not any(key in found for key in keys)]
    if missing:
        header = _unknown_header(before) or 0
        raise InputError(_no_names(name, before, header, option, f"{', '.join(missing)} not found"))
    fractions = [unit for unit, unit_ns in TIMES.items() if unit_ns < NS_PER_S]
    known = {STAMP: (*TIMES, UTC_UNIT, ""), NANOSECONDS: (*fractions, "")}
    known |= dict.fromkeys((*POSITION, DOWN), tuple(METRES))
    scaled = [key for key in found.position_keys if METRES.get(found.units.get(key, ""), 1.0) != 1.0]
    without_unit = [key for key in found.position_keys if key in found and not found.units.get(key)]
    if scaled and without_unit:
        raise InputError(
            f"{name}: {scaled[0]} is in {found.units[scaled[0]]}, but {without_unit[0]} has no unit: name its unit "
            f"in the header, or name the columns: {option.replace('COLUMNS', 't=...,x=...[mm],y=...[mm],z=...[mm]')}"
        )
    for key, unit in found.units.items():
        if key in known and unit not in known[key]:
            units = ", ".join(unit for unit in known[key] if unit)
            raise InputError(
                f"{name}: the unit of {key} is '{unit[:20]}', which is unknown: convert the column to one of {units}"
            )


def _no_names(name: str, before: Sequence[str], number: int, option: str, problem: str = "") -> str:
    """Return the error message for a header that does not name stamps and positions; it quotes the header's names."""
    header = before[number].strip() if before else ""
    cells = header_cells(header, _separator(header), 4)
    found = _named(cells)
    needed = (STAMP, "x", "y", "z")
    missing = [key for key in needed if key not in found]
    problem = problem or f"{', '.join(missing)} not found"
    own = [cells[found[key]] if key in found else "HEADER" for key in needed]
    example = ",".join(f"{key}={cell}" for key, cell in zip(needed, own, strict=True))
    return (
        f"{name} line {number + 1} is '{header[:80]}': the header has no known names for t, x, y, z "
        f"({problem}): name the columns: {option.replace('COLUMNS', example)}"
    )


def _with_time_unit(found: PoseColumns, rows: Sequence[Sequence[str]], name: str, option: str) -> PoseColumns:
    """Return the columns with the unit of the stamps, which is inferred from their magnitude if it is not given."""
    if STAMP not in found or found.units.get(STAMP):
        return found
    texts = [cells[found.index_of[STAMP]] for cells in rows if len(cells) > found.index_of[STAMP]]
    if texts and not _is_number(texts[0]) and _is_time(texts[0]):
        return replace(found, units={**found.units, STAMP: UTC_UNIT}, inferred=UTC_UNIT)
    unit = time_unit(texts, is_seconds=found.format is TrajectoryFormat.TUM)
    if not unit:
        raise InputError(
            f"{name}: the unit of the stamps {', '.join(texts[:3])} is ambiguous: name the unit "
            f"(s, ms, us or ns), for example {option.replace('COLUMNS', 't[ns],x,y,z,qx,qy,qz,qw')}"
        )
    return replace(found, units={**found.units, STAMP: unit}, inferred="" if unit == "s" else unit)
