"""What subcommands write: JSON to a file or to standard output, texts, tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfr_loc_map.tables.table import Table

STANDARD_OUTPUT = "-"

JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="F", help="Write all figures as JSON; - for standard output.")
]


def check_output(path: Path | None, endings: tuple[str, ...] = ()) -> None:
    """Check an output before the work for it is done.

    Args:
        path: Where it shall be; None for no output.
        endings: What its name may end in; empty for anything.

    Raises:
        OutputError: If the name ends otherwise, or it cannot be written.
    """
    from sfr_loc_map.io.atomic import check_output as check

    if path is None:
        return
    if endings and path.suffix not in endings:
        raise OutputError(f"cannot write '{path}': its name must end in one of {', '.join(endings)}")
    check(path)


def check_json(place: str | None) -> None:
    """Check the place of a `--json` before the work for it is done."""
    check_output(None if place in (None, STANDARD_OUTPUT) else Path(str(place)))


def write_text(text: str, path: Path) -> None:
    """Write a text file, whole or not at all."""
    from sfr_loc_map.io.atomic import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def show(json_text: str, place: str | None, tables: Iterable[Table]) -> None:
    """Write the JSON where `--json` says and print the tables; the JSON alone where it goes to standard output."""
    if place == STANDARD_OUTPUT:
        sys.stdout.write(json_text)
        return
    if place is not None:
        write_text(json_text, Path(place))
    from sfr_loc_map.tables.terminal import print_tables

    print_tables(tables)
