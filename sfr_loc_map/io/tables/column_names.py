"""Columns of a table by their names: the names in its header, or those that the user gives.

`--columns` or `truth.columns` names the columns of a table without a known header:

    t=Time[s],x=East[mm],y=North[mm],z=Height[mm]      columns by name in the header, or by number: t=#1[ns]
    t[ns],x,y,z,qw,qx,qy,qz                            columns in order; _ skips a column
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.length_units import LENGTH_WORDS, METRES, length_symbol
from sfr_loc_map.io.tables.pose_columns import (
    COVARIANCE_KEYS,
    DOWN,
    FRAME,
    MATRIX,
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SECONDS,
    STAMP,
    PoseColumns,
)
from sfr_loc_map.io.tables.stamps import TIMES, UTC_UNIT
from sfr_loc_map.io.tables.table_head import TableHead, header_cells, is_number, separator_in
from sfr_loc_map.io.tables.text_table import COMMENTS

NAMES: dict[str, tuple[str, ...]] = {
    STAMP: ("headerstamp", "timestamp", "stamp", "time", "t", "utime", "unixtime", "timestamps"),
    SECONDS: ("sec", "secs", "headerstampsec", "headerstampsecs", "stampsec", "timesec", "timestampsec"),
    NANOSECONDS: (
        *("nsec", "nsecs", "nanosec", "nanosecs", "headerstampnanosec", "headerstampnsecs", "stampnanosec"),
        *("usec", "usecs", "microsec", "microsecs", "microseconds", "msec", "msecs", "millisec", "millisecs"),
    ),
}
_FORMS = ("{}", "p{}", "t{}", "pos{}", "position{}", "translation{}", "{}enu", "prsr{}", "rboriginposmds{}")
_EAST, _NORTH, _UP = ("east", "easting", "e"), ("north", "northing", "n"), ("up", "height", "h", "elevation")
_OF_AXES: list[dict[str, tuple[str, ...]]] = [{axis: (form.format(axis),) for axis in "xyz"} for form in _FORMS]
FAMILIES: tuple[dict[str, tuple[str, ...]], ...] = (
    *_OF_AXES,
    {"x": _EAST, "y": _NORTH, "z": _UP},
    {"x": _EAST, "y": _NORTH, DOWN: (DOWN,)},
    {"x": ("yned",), "y": ("xned",), DOWN: ("zned",)},
)
"""Names of the three columns of a position. `x`, `y` and `down` form no family, because their frame is left-handed."""
NAMES |= {key: tuple(name for family in FAMILIES for name in family.get(key, ())) for key in ("x", "y", "z", DOWN)}
NAMES |= {
    f"q{axis}": (
        *(f"q{axis}", f"quat{axis}", f"quaternion{axis}", f"orientation{axis}", f"rotation{axis}", f"qrs{axis}"),
        f"attqdstorb{number}",
    )
    for number, axis in enumerate("xyzw", 1)
}
"""Names of columns in lower case without `_`, `.`, `-` and spaces; earlier names take precedence."""
_LENGTHS = {name for key in ("x", "y", "z", DOWN) for name in NAMES[key]}
_CONJUGATES = re.compile(r"att_?q_?(ds_?to_?rb|lm_?to_?navsb)_?[1-4]", re.IGNORECASE)
"""Titles of the quaternions of the suite, which are the conjugates of those in ROS messages (docs/conventions.md)."""
SMALLER_FRACTIONS = {"us": ("usec", "microsec"), "ms": ("msec", "millisec")}
"""Units of the fraction of a second other than ns, by the beginning of the name of the column."""
UNITS = {*METRES, *TIMES, UTC_UNIT, "rad", "deg", "1"}  #: Contents of a line of units below a header.
_OTHER_NAMES = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosecond", "nanoseconds"), "ns"),
}
"""Other names of the units of stamps, and their symbols."""
SKIPPED = "_"
_TIME_WORDS = ("s", "sec", "ms", "msec", "us", "usec", "ns", "nsec", "utc")
_WORDS = "|".join(sorted((*LENGTH_WORDS, "in", *_TIME_WORDS), key=len, reverse=True))
_UNIT = re.compile(rf"^[#%/\s]*(.*?)\s*(?:\[([^\[\]]*)\]|\((\w*)\)|(?<=\w)[\s_/]+({_WORDS}))?$", re.IGNORECASE)
_ATTACHED = re.compile(rf"([a-z._]+?)({'|'.join(word for word in LENGTH_WORDS if len(word) > 1)})", re.IGNORECASE)
"""A title and a unit without a separator: `Xmm`."""
_PREFIXES = ("field", "poseposepose", "posepose", "pose", "transform")
_DEGREES = ({"lat", "latitude"}, {"lon", "long", "lng", "longitude"})
"""Names of the two columns of a geographic position, in lower case."""


def split_unit(cell: str) -> tuple[str, str]:
    """Return the name and the unit of a cell of a header: `East [mm]`, `time_ns`, `Height (m)`, `X/mm`, `Xmm`."""
    match = _UNIT.match(cell.strip())
    title, *units = match.groups("") if match else (cell, "")
    name, unit = str(title).strip(), symbol_of("".join(units))
    attached = None if unit else _ATTACHED.fullmatch(name)
    if attached and _plain(attached[1]) in _LENGTHS and _plain(name) not in _LENGTHS:
        return attached[1], symbol_of(attached[2])
    in_name = (unit for unit, starts in SMALLER_FRACTIONS.items() if name.lower().startswith(starts))
    return name, unit or next(in_name, "")


def symbol_of(unit: str) -> str:
    """Return the symbol of a unit: `mm` for `Millimetres`; an unknown unit in lower case."""
    plain = unit.strip().lower()
    return length_symbol(plain) or _OTHER_NAMES.get(plain, plain)


def _plain(title: str) -> str:
    """Return a title in lower case without signs and spaces, as in `NAMES`."""
    return re.sub(r"[^a-z0-9]", "", title.lower())


def key_of(cell: str) -> tuple[str, int] | None:
    """Return the content of a column by its name, and the precedence of the name; None if the name is unknown."""
    title = split_unit(cell)[0]
    word = _plain(title)
    words = [word]
    words += [word.removeprefix(prefix) for prefix in _PREFIXES if word.startswith(prefix)]
    words += [word.removeprefix("field").removeprefix(prefix) for prefix in _PREFIXES if word.startswith("field")]
    for key, names in NAMES.items():
        for candidate in words:
            if candidate in names:
                return key, names.index(candidate)
    return (title, 0) if title in COVARIANCE_KEYS else None


def keys_of(cells: Sequence[str]) -> list[tuple[str, int] | None]:
    """Return the contents of columns by their names (`key_of`).

    Of `stamp_sec` and `stamp_nsec`, each name alone is that of a complete stamp, and both are parts of one stamp.
    """
    keys = [key_of(cell) for cell in cells]
    words = [_plain(cell) for cell in cells]
    for index, word in enumerate(words):
        stem = word.removesuffix("sec")
        fractions = [number for number, other in enumerate(words) if other in (f"{stem}{unit}sec" for unit in "num")]
        if word in NAMES[SECONDS] and len(fractions) == 1:
            keys[index], keys[fractions[0]] = (SECONDS, 0), (NANOSECONDS, 0)
    return keys


def named_columns(cells: Sequence[str]) -> dict[str, int]:
    """Return the columns with known names, from 0; of several columns of one key, the preferred name decides.

    x, y and z are those of the first complete family of names, so that they belong to one position.
    """
    ranked: dict[str, tuple[int, int]] = {}
    for index, known in enumerate(keys_of(cells)):
        if known is None:
            continue
        key, rank = known
        if key not in ranked or rank < ranked[key][0]:
            ranked[key] = (rank, index)
    found = {key: index for key, (_, index) in ranked.items()}
    positions = named_positions(cells)
    if not positions:
        return {key: index for key, index in found.items() if key != DOWN}
    return {key: index for key, index in found.items() if key not in (*POSITION, DOWN)} | positions[0]


def named_positions(cells: Sequence[str]) -> list[dict[str, int]]:
    """Return the columns of x, y, and z or down of each complete family of names."""
    index_of: dict[str, int] = {}
    for index, cell in enumerate(cells):
        known = key_of(cell)
        if known is not None and known[0] in (*POSITION, DOWN):
            index_of.setdefault(NAMES[known[0]][known[1]], index)
    found = []
    for family in FAMILIES:
        columns = {key: index_of[name] for key, names in family.items() for name in names[::-1] if name in index_of}
        if len(columns) == len(family):
            found.append(columns)
    return found


# ---- names in the header


def columns_of_header(head: TableHead) -> PoseColumns | None:
    """Return the columns named by the header, or None without a header; InputError if a name occurs twice.

    The header is the last line before the rows that names a stamp, x, y, and z or down. A line of units may follow.
    """
    for number, line in reversed([*enumerate(head.before)]):
        cells = _aligned(head.cells_of(line), head)
        found = named_columns(cells)
        if found.keys() & {STAMP, SECONDS} and {"x", "y"} <= found.keys() and found.keys() & {"z", DOWN}:
            _check_names_differ(cells, found, head, number)
            _check_names_are_complete(cells, found, head, number)
            return _of_header(cells, found, _units_below(head, number, len(cells)), head)
    return None


def _aligned(cells: Sequence[str], head: TableHead) -> list[str]:
    """Return the names of a header, one for each column of the rows.

    A label before the names (`format: t x y z`) is ignored, as are names beyond the last column. Rows may begin with
    a row number that the header does not name (`write.table` of R).
    """
    names = list(cells)
    if len(names) > 1 and names[0].endswith(":"):
        names = names[1:]
    row_numbers = [str(number + 1) for number in range(len(head.rows))]
    if len(names) == head.width - 1 and [row[0].strip('"') for row in head.rows] == row_numbers:
        names = ["", *names]
    return names[: head.width]


def _check_names_differ(cells: Sequence[str], found: Mapping[str, int], head: TableHead, number: int) -> None:
    """Raise InputError if several columns of the header have the name of a column that would be read."""
    keys = keys_of(cells)
    for index in found.values():
        indices = [other for other, key in enumerate(keys) if key == keys[index]]
        if len(indices) > 1:
            numbers = " and ".join(f"#{other + 1}" for other in indices)
            raise InputError(
                f"{head.name} line {number + 1}: columns {numbers} are both '{cells[index]}': {head.named_by_number()}"
            )


def _check_names_are_complete(cells: Sequence[str], found: Mapping[str, int], head: TableHead, number: int) -> None:
    """Raise InputError if the header names two positions, or has fewer names than the rows have columns.

    The second check is not required for tables with attitudes: if their names were shifted against the columns, the
    attitudes would not be rotations.
    """
    problem = ""
    if len(named_positions(cells)) > 1:
        names = (" ".join(cells[index] for index in position.values()) for position in named_positions(cells))
        problem = f"names several positions: {' and '.join(names)}"
    filled = [len(row) for row in head.rows if row[-1]]
    if filled and min(filled) > len(cells) and not set(QUATERNION) <= found.keys():
        problem = f"has {len(cells)} names, and the rows have {min(filled)} columns"
    if problem:
        raise InputError(f"{head.name} line {number + 1}: the header {problem}: {head.named_by_number()}")


def _units_below(head: TableHead, number: int, count: int) -> list[str]:
    """Return the units of `count` columns in a line between the header and the rows; empty without such a line.

    A comment is such a line only if its units are known, or if it has a unit of time. Any other line without a number
    is also such a line, and `column_detection` refuses its unknown units.
    """
    for line in head.before[number + 1 :]:
        units = _as_units(head.cells_of(line))
        is_comment = line.strip().startswith(COMMENTS)
        has_number = any(is_number(unit) for unit in units)
        if len(units) == count and (_are_units(units) or (any(units) and not is_comment and not has_number)):
            return units
    return []


def _as_units(cells: Sequence[str]) -> list[str]:
    """Return the units in the cells of a line; empty for a dash, which states that a number has no unit."""
    return [symbol_of(cell.strip("()[] -=_")) for cell in cells]


def _are_units(units: Sequence[str]) -> bool:
    return any(units) and (all(unit in UNITS for unit in units) or any(unit in TIMES for unit in units))


def _unit_of(head: TableHead, key: str, title: str, below: str, given: str = "") -> str:
    """Return the unit of a column by its title, the line of units below, and the user; empty if none states a unit.

    A unit of another quantity is part of the title (`pos_s` for a position). InputError if two units differ.
    """
    in_title = split_unit(title)[1]
    others = METRES if key in (STAMP, SECONDS, NANOSECONDS) else TIMES
    stated = {
        head.option.partition(" ")[0]: given,
        f"its title '{title}'": "" if given and in_title in others else in_title,
        "the line of units": below if below in UNITS else "",
    }
    units = {origin: unit for origin, unit in stated.items() if unit}
    if len(set(units.values())) > 1:
        states = " and ".join(f"{unit} by {origin}" for origin, unit in units.items())
        raise InputError(f"{head.name}: the unit of {key} is {states}: one unit is required; correct the wrong one")
    return next(iter(units.values()), below)


def _of_header(cells: Sequence[str], found: Mapping[str, int], below: Sequence[str], head: TableHead) -> PoseColumns:
    """Return the columns of a header; `below` contains the units in the line below the header, or is empty."""
    index_of = dict(found)
    units = {key: _unit_of(head, key, cells[index], below[index] if below else "") for key, index in found.items()}
    if SECONDS in index_of and NANOSECONDS not in index_of and STAMP not in index_of:
        index_of[STAMP] = index_of.pop(SECONDS)
        units[STAMP] = units.pop(SECONDS) or "s"
    if {SECONDS, NANOSECONDS} <= index_of.keys():
        index_of.pop(STAMP, None)
    if DOWN in index_of:  # attitudes in NED describe a body with other axes
        index_of = {key: index for key, index in index_of.items() if key not in QUATERNION}
    units = {key: unit for key, unit in units.items() if key in index_of and unit}
    ignored = tuple(cell for index, cell in enumerate(cells) if index not in index_of.values())
    width = max(head.width, len(cells))
    return PoseColumns(
        "columns by their names",
        head.separator,
        index_of,
        units,
        width,
        by_header=True,
        ignored=ignored,
        is_conjugated=_are_conjugates(head, index_of, cells),
    )


def _are_conjugates(head: TableHead, index_of: Mapping[str, int], titles: Sequence[str]) -> bool:
    """Return whether the titles of the quaternions are those of the suite; InputError if only some of them are."""
    read = [titles[index_of[key]] for key in QUATERNION if key in index_of and index_of[key] < len(titles)]
    of_suite = [title for title in read if _CONJUGATES.search(title)]
    if of_suite and len(of_suite) < len(read):
        other = next(title for title in read if title not in of_suite)
        raise InputError(
            f"{head.name}: the columns '{of_suite[0]}' and '{other}' belong to quaternions of two conventions: name "
            "the four columns of one quaternion"
        )
    return bool(of_suite)


# ---- names given by the user


def columns_of_user(head: TableHead, columns: str) -> PoseColumns:
    """Return the columns that the user names as `NAME=HEADER[UNIT]`, or as `NAME[UNIT]` in the order of columns.

    A unit that the user does not give is that in the header, or in a line of units below the header. InputError if two
    of these units differ.
    """
    header = _header_above(head)
    items = [item.strip() for item in columns.split(",")]
    is_ordered = not any("=" in item for item in items)
    width = max(head.width, len(header))
    index_of: dict[str, int] = {}
    given: dict[str, str] = {}
    for number, item in enumerate(items):
        if is_ordered:
            key, unit = split_unit(item)
            index: int | None = number
        else:
            key, _, text = (part.strip() for part in item.partition("="))
            index, unit = _column(text, header)
        if key == SKIPPED:
            continue
        if key in index_of:
            raise InputError(
                f"{head.name}: {head.option_with(columns)} names {key} twice, the second time by '{item}': name it once"
            )
        if key not in {*NAMES, FRAME, *MATRIX} or index is None or not 0 <= index < width:
            shown = ", ".join(header) or f"{head.width} columns without a header"
            raise InputError(
                f"{head.name}: no column for '{item}': give NAME=HEADER, where NAME is t, sec, nsec, x, y, z, qx, qy, "
                f"qz or qw (_: a column that is not read), and HEADER is the title of a column or its number (#1: the "
                f"first column); found {shown[:200]}"
            )
        if index in index_of.values():
            other = next(name for name, place in index_of.items() if place == index)
            raise InputError(f"{head.name}: column #{index + 1} is named as {other} and as {key}: name it once")
        index_of[key] = index
        given[key] = unit
    number = max((number for number, line in enumerate(head.before) if head.cells_of(line) == header), default=0)
    below = _units_below(head, number, len(header)) if header else []
    titles = header if len(header) == head.width or not is_ordered else []
    units = {}
    for key, index in index_of.items():
        title, unit_below = (cells[index] if index < len(cells) else "" for cells in (titles, below))
        units[key] = _unit_of(head, key, title, unit_below, given[key])
    units = {key: unit for key, unit in units.items() if unit}
    names = [*header, *(f"#{number + 1}" for number in range(len(header), head.width))]
    ignored = tuple(name for index, name in enumerate(names) if index not in index_of.values())
    return PoseColumns(
        "columns as given",
        head.separator,
        index_of,
        units,
        head.width,
        by_header=True,
        ignored=ignored,
        is_conjugated=_are_conjugates(head, index_of, header),
    )


def columns_by_number(index_of: Mapping[str, int], units: Mapping[str, str]) -> str:
    """Return columns as `--columns` names them by their numbers, with their units: `t=#1[ms],x=#2`."""
    named = sorted((index, key) for key, index in index_of.items() if key in {*NAMES, FRAME, *MATRIX} - {DOWN})
    return ",".join(f"{key}=#{index + 1}" + (f"[{units[key]}]" if units.get(key) else "") for index, key in named)


def _header_above(head: TableHead) -> list[str]:
    """Return the cells of the last line before the rows that has a title for most columns and is not a line of units.

    If there is no such line, return the cells of the longest line; empty without lines before the rows.
    """
    lines = [head.cells_of(line) for line in head.before]
    titles = [cells for cells in lines if 2 * sum(map(bool, cells)) > head.width and not _are_units(_as_units(cells))]
    return titles[-1] if titles else max(lines, key=len, default=[])


def _column(text: str, header: Sequence[str]) -> tuple[int | None, str]:
    """Return the index of a column that the user names, `#3[mm]`, `East [mm]` or `East`, and the unit in its name.

    A column is named by its number, or by its title in the header with or without its unit. The index is None if there
    is no such column.
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
                return names.index(_compact(wanted)), unit
    return None, ""


def _compact(title: str) -> str:
    """Return a title in lower case without spaces and comment signs."""
    return re.sub(r"[\s#%]", "", title).lower()


# ---- a header without known names


def unknown_header(before: Sequence[str]) -> int | None:
    """Return the index of the line before the rows that is probably the header; None without such a line.

    The line is not a comment. Of several lines, the first of those that name the most columns is returned.
    """
    texts = [number for number, line in enumerate(before) if line.strip() and not line.strip().startswith(COMMENTS)]
    return max(texts, key=lambda number: len(named_columns(header_cells(before[number], None))), default=None)


def check_is_not_geographic(before: Sequence[str], name: str) -> None:
    """Raise InputError if a line before the rows names latitude and longitude, because these are not lengths."""
    for number, line in enumerate(before, 1):
        titles = {re.sub(r"[^a-z]", "", split_unit(cell)[0].lower()) for cell in header_cells(line, separator_in(line))}
        if all(titles & names for names in _DEGREES):
            raise InputError(
                f"{name} line {number} names latitude and longitude: positions in metres are required; convert them to "
                "columns east, north and height"
            )


def without_names(head: TableHead, number: int, problem: str = "") -> InputError:
    """Return the error for a header that does not name stamps and positions; the message quotes the header's names."""
    header = head.before[number].strip() if head.before else ""
    cells = header_cells(header, separator_in(header))
    found = named_columns(cells)
    needed = (STAMP, "x", "y", "z")
    if not problem and all(key in found for key in needed):
        return InputError(
            f"{head.name} line {number + 1} names {len(cells)} columns, but the rows have at most {head.width}: a "
            "value for each column is required; complete the rows, or correct the header"
        )
    problem = problem or f"{', '.join(key for key in needed if key not in found)} not found"
    if not header:
        return InputError(f"{head.name}: {problem} among the columns: {head.named_by_number()}")
    own = [cells[found[key]] if key in found else "HEADER" for key in needed]
    example = ",".join(f"{key}={cell}" for key, cell in zip(needed, own, strict=True))
    return InputError(
        f"{head.name} line {number + 1} is '{header[:80]}': the header has no known names for t, x, y, z "
        f"({problem}): {head.named_by(example)}"
    )
