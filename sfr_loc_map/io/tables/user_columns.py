"""Columns that the user names by `--columns` or `truth.columns`, for a table without a known header.

Columns are named by their titles in the header or by their numbers (`t=Time[s],x=East[mm],y=#3[mm],z=#4[mm]`), or in
order, where `_` skips a column (`t[ns],_,x,y,z,qw,qx,qy,qz`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.pose_columns import FRAME, MATRIX, PoseColumns
from sfr_loc_map.io.tables.table_head import TableHead, are_units, unit_of_column, units_below, units_in
from sfr_loc_map.io.tables.titles import NAMES, are_conjugates, split_unit

SKIPPED = "_"  #: Name of a column that is not read.
KEYS = {*NAMES, FRAME, *MATRIX}  #: Keys that the user can name.


class _Item(NamedTuple):
    """A column as the user names it."""

    text: str  #: As given: `x=East[mm]`, or `x[mm]`.
    key: str
    column: int | None  #: From 0; None if the table has no such column.
    unit: str  #: Empty if none is given.


def columns_of_user(head: TableHead, columns: str) -> PoseColumns:
    """Return the columns that the user names as `NAME=HEADER[UNIT]`, or as `NAME[UNIT]` in the order of columns.

    A unit that the user does not give is that in the header, or in a line of units below the header. InputError if two
    of these units differ.
    """
    header_index, header = _header_above(head)
    texts = [item.strip() for item in columns.split(",")]
    is_ordered = not any("=" in text for text in texts)
    items = [item for item in _items(texts, header, is_ordered=is_ordered) if item.key != SKIPPED]
    index_of = _checked_columns(head, columns, items, header)
    below = units_below(head, header_index, len(header)) if header else []
    titles = header if len(header) == head.width or not is_ordered else []
    units = {
        key: unit_of_column(head, key, _cell(titles, index_of[key]), _cell(below, index_of[key]), unit)
        for _, key, _, unit in items
    }
    names = [*header, *(f"#{number + 1}" for number in range(len(header), head.width))]
    return PoseColumns(
        "columns as given",
        head.separator,
        len(head.before),
        head.width,
        index_of,
        {key: unit for key, unit in units.items() if unit},
        are_named=True,
        ignored=tuple(name for index, name in enumerate(names) if index not in index_of.values()),
        is_conjugated=are_conjugates(header, index_of, head.name),
    )


def _items(texts: Sequence[str], header: Sequence[str], *, is_ordered: bool) -> Iterator[_Item]:
    """Yield the columns in the texts between the commas."""
    for number, text in enumerate(texts):
        if is_ordered:
            key, unit = split_unit(text)
            yield _Item(text, key, number, unit)
        else:
            key, _, column = (part.strip() for part in text.partition("="))
            yield _Item(text, key, *_column(column, header))


def _cell(cells: Sequence[str], index: int) -> str:
    """Return a cell of a line; empty if the line has fewer cells."""
    return cells[index] if index < len(cells) else ""


def _checked_columns(head: TableHead, columns: str, items: Sequence[_Item], header: Sequence[str]) -> dict[str, int]:
    """Return the column of each key; InputError if a key or a column is unknown, or named twice."""
    width = max(head.width, len(header))
    index_of: dict[str, int] = {}
    for text, key, index, _ in items:
        if key in index_of:
            raise InputError(
                f"{head.name}: {head.option_with(columns)} names {key} twice, the second time by '{text}':",
                "name it once",
            )
        if key not in KEYS or index is None or not 0 <= index < width:
            shown = ", ".join(header) or f"{head.width} columns without a header"
            raise InputError(
                f"{head.name}: no column for '{text}':",
                "give NAME=HEADER, where NAME is t, sec, nsec, x, y, z, qx, qy, "
                f"qz or qw (_: a column that is not read), and HEADER is the title of a column or its number (#1: the "
                f"first column); found {shown[:200]}",
            )
        if index in index_of.values():
            other = next(name for name, place in index_of.items() if place == index)
            raise InputError(f"{head.name}: column #{index + 1} is named as {other} and as {key}:", "name it once")
        index_of[key] = index
    return index_of


def columns_text(index_of: Mapping[str, int], units: Mapping[str, str]) -> str:
    """Return columns with their units as the user names them: in order, or by number if columns are skipped.

    Examples: `t[ms],x,y,z` and `t=#1[ms],x=#3`. Keys that the user cannot name are omitted.
    """
    named = sorted((index, key) for key, index in index_of.items() if key in KEYS)
    is_ordered = [index for index, _ in named] == list(range(len(named)))
    texts = [
        (key if is_ordered else f"{key}=#{index + 1}") + (f"[{units[key]}]" if units.get(key) else "")
        for index, key in named
    ]
    return ",".join(texts)


def _header_above(head: TableHead) -> tuple[int, list[str]]:
    """Return the index in `head.before`, and the cells, of the line with the titles of the columns.

    This is the last line that has a title for most columns and is not a line of units. If there is no such line, this
    is the line with most cells. Without lines before the rows there are no cells.
    """
    lines = [*enumerate(map(head.cells_of, head.before))]
    for index, cells in reversed(lines):
        if 2 * sum(map(bool, cells)) > head.width and not are_units(units_in(cells)):
            return index, cells
    return max(lines, key=lambda line: len(line[1]), default=(0, []))


def _column(text: str, header: Sequence[str]) -> tuple[int | None, str]:
    """Return the index of a column that the user names, `#3[mm]`, `East [mm]` or `East`, and the unit in its name.

    A column is named by its number, or by its title in the header with or without its unit. The index is None if there
    is no such column.
    """
    name, unit = split_unit(text)
    without_bracket = text.rpartition("[")[0] if text.endswith("]") else text
    if re.fullmatch(r"#?[0-9]{1,4}", without_bracket.strip()) and (text.startswith("#") or not header):
        return int(without_bracket.strip(" #")) - 1, unit
    titles = [_compact(title) for title in header]
    names = [_compact(split_unit(title)[0]) for title in header]
    for known in (titles, names):
        for wanted in (text, without_bracket, name):
            if _compact(wanted) in known:
                return known.index(_compact(wanted)), unit
    return None, ""


def _compact(title: str) -> str:
    """Return a title in lower case without spaces and comment signs."""
    return re.sub(r"[\s#%]", "", title).lower()
