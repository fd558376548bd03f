"""The unit of a column as its title, a line of units below the header, and the user state it."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.number_text import is_number
from sfr_loc_map.io.stamps.stamp_text import TIMES, UTC_UNIT
from sfr_loc_map.io.tables.cells.text_table import COMMENTS
from sfr_loc_map.io.tables.columns.length_units import METRES
from sfr_loc_map.io.tables.columns.pose_columns import NANOSECONDS, SECONDS, STAMP
from sfr_loc_map.io.tables.columns.table_head import TableHead
from sfr_loc_map.io.tables.columns.titles import split_unit, symbol_of

UNITS = {*METRES, *TIMES, UTC_UNIT, "rad", "deg", "1"}  #: Contents of a line of units below a header.


def units_below(head: TableHead, number: int, count: int) -> list[str]:
    """Return the units of `count` columns in a line between the header and the rows; empty without such a line.

    `number` is the index of the header. A comment is such a line only if its units are known, or if it has a unit of
    time. Any other line without a number is also such a line, and `check_units_are_supported` refuses its
    unknown units.
    """
    for line in head.before[number + 1 :]:
        units = units_in(head.cells_of(line))
        is_comment = line.strip().startswith(COMMENTS)
        has_number = any(is_number(unit) for unit in units)
        if len(units) == count and (are_units(units) or (any(units) and not is_comment and not has_number)):
            return units
    return []


def units_in(cells: Sequence[str]) -> list[str]:
    """Return the units in the cells of a line; empty for a dash, which states that a number has no unit."""
    return [symbol_of(cell.strip("()[] -=_")) for cell in cells]


def are_units(units: Sequence[str]) -> bool:
    """Return whether all texts are known units, or at least one is a unit of time."""
    return any(units) and (all(unit in UNITS for unit in units) or any(unit in TIMES for unit in units))


def unit_of_column(head: TableHead, key: str, title: str, below: str, given: str = "") -> str:
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
