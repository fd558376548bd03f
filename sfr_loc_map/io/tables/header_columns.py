"""Columns that a header names, and the error for a header without known names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.pose_columns import DOWN, NANOSECONDS, QUATERNION, SECONDS, STAMP, PoseColumns
from sfr_loc_map.io.tables.table_head import TableHead, header_cells, separator_in, unit_of_column, units_below
from sfr_loc_map.io.tables.text_table import COMMENTS
from sfr_loc_map.io.tables.titles import are_conjugates, known_titles, named_columns, named_positions


def columns_of_header(head: TableHead) -> PoseColumns | None:
    """Return the columns named by the header, or None without a header; InputError if a name occurs twice.

    The header is the last line before the rows that names a stamp, x, y, and z or down. A line of units may follow.
    """
    for number, line in reversed([*enumerate(head.before)]):
        titles = _aligned(head.cells_of(line), head)
        named = named_columns(titles)
        if named.keys() & {STAMP, SECONDS} and {"x", "y"} <= named.keys() and named.keys() & {"z", DOWN}:
            _check_names_differ(titles, named, head, number)
            _check_names_are_complete(titles, named, head, number)
            return _of_header(titles, named, units_below(head, number, len(titles)), head)
    return None


def _aligned(titles: Sequence[str], head: TableHead) -> list[str]:
    """Return the titles of a header, one for each column of the rows.

    A label before the titles (`format: t x y z`) is ignored, as are titles beyond the last column. Rows may begin with
    a row number that the header does not name (`write.table` of R).
    """
    aligned = list(titles)
    if len(aligned) > 1 and aligned[0].endswith(":"):
        aligned = aligned[1:]
    row_numbers = [str(number + 1) for number in range(len(head.rows))]
    if len(aligned) == head.width - 1 and [row[0].strip('"') for row in head.rows] == row_numbers:
        aligned = ["", *aligned]
    return aligned[: head.width]


def _check_names_differ(titles: Sequence[str], named: Mapping[str, int], head: TableHead, number: int) -> None:
    """Raise InputError if several columns of the header have the name of a column that would be read."""
    known = known_titles(titles)
    for index in named.values():
        indices = [other for other, title in enumerate(known) if title == known[index]]
        if len(indices) > 1:
            numbers = " and ".join(f"#{other + 1}" for other in indices)
            raise InputError(
                f"{head.name} line {number + 1}: columns {numbers} are both '{titles[index]}':", head.named_by_number()
            )


def _check_names_are_complete(titles: Sequence[str], named: Mapping[str, int], head: TableHead, number: int) -> None:
    """Raise InputError if the header names two positions, or has fewer names than the rows have columns.

    The second check is not required for tables with attitudes: if their names were shifted against the columns, the
    attitudes would not be rotations.
    """
    problem = ""
    positions = named_positions(titles)
    if len(positions) > 1:
        names = (" ".join(titles[index] for index in position.values()) for position in positions)
        problem = f"names several positions: {' and '.join(names)}"
    filled = [len(row) for row in head.rows if row[-1]]
    if filled and min(filled) > len(titles) and not set(QUATERNION) <= named.keys():
        problem = f"has {len(titles)} names, and the rows have {min(filled)} columns"
    if problem:
        raise InputError(f"{head.name} line {number + 1}: the header {problem}:", head.named_by_number())


def _of_header(titles: Sequence[str], named: Mapping[str, int], below: Sequence[str], head: TableHead) -> PoseColumns:
    """Return the columns of a header; `below` contains the units in the line below the header, or is empty."""
    index_of = dict(named)
    units = {
        key: unit_of_column(head, key, titles[index], below[index] if below else "") for key, index in named.items()
    }
    if SECONDS in index_of and NANOSECONDS not in index_of and STAMP not in index_of:
        index_of[STAMP] = index_of.pop(SECONDS)
        units[STAMP] = units.pop(SECONDS) or "s"
    if {SECONDS, NANOSECONDS} <= index_of.keys():
        index_of.pop(STAMP, None)
    if DOWN in index_of:  # attitudes in NED describe a body with other axes
        index_of = {key: index for key, index in index_of.items() if key not in QUATERNION}
    return PoseColumns(
        "columns by their names",
        head.separator,
        len(head.before),
        max(head.width, len(titles)),
        index_of,
        {key: unit for key, unit in units.items() if key in index_of and unit},
        are_named=True,
        ignored=tuple(title for index, title in enumerate(titles) if index not in index_of.values()),
        is_conjugated=are_conjugates(titles, index_of, head.name),
    )


# ---- a header without known names


def unknown_header(head: TableHead) -> int | None:
    """Return the index of the line before the rows that is probably the header; None without such a line.

    The line is not a comment. Of several lines, that which names the most columns is returned, then that with the most
    titles, then the first.
    """
    texts = [
        number for number, line in enumerate(head.before) if line.strip() and not line.strip().startswith(COMMENTS)
    ]

    def titles_in(number: int) -> tuple[int, int]:
        cells = head.cells_of(head.before[number])
        return len(named_columns(cells)), sum(map(bool, cells))

    return max(texts, key=titles_in, default=None)


def without_names(head: TableHead, number: int, problem: str = "") -> InputError:
    """Return the error for a header that does not name stamps and positions; the message quotes the header's names."""
    header = head.before[number].strip() if head.before else ""
    titles = header_cells(header, separator_in(header))
    named = named_columns(titles)
    required = (STAMP, "x", "y", "z")
    if not problem and all(key in named for key in required):
        return InputError(
            f"{head.name} line {number + 1} names {len(titles)} columns, but the rows have at most {head.width}: a "
            "value for each column is required;",
            "complete the rows, or correct the header",
        )
    problem = problem or f"{', '.join(key for key in required if key not in named)} not found"
    if not header:
        return InputError(f"{head.name}: {problem} among the columns:", head.named_by_number())
    own = [titles[named[key]] if key in named else "HEADER" for key in required]
    example = ",".join(f"{key}={title}" for key, title in zip(required, own, strict=True))
    return InputError(
        f"{head.name} line {number + 1} is '{header[:80]}': the header has no known names for t, x, y, z ({problem}):",
        head.named_by(example),
    )
