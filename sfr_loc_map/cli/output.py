"""What subcommands write: one rule for all outputs; JSON to a file or to standard output, texts, tables.

An output that is there already is refused unless `--overwrite` is given, before the work for it is done. Only a regular
file, or a folder that holds nothing but a data set or a bag, is ever replaced.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.next_step import propose_nothing
from sfr_loc_map.errors import OutputError
from sfr_loc_map.printable import one_line, printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfr_loc_map.tables.table import Table

STANDARD_OUTPUT = "-"
DATA_SET_NAMES = frozenset(
    [
        "rig.json",
        "pairs.csv",
        "groundtruth.csv",
        "simulation.yaml",
        "metadata.yaml",
        "left",
        "right",
        "truth",
        "masks",
        "loc",
        "nav",
    ]
)
"""Names within the folders that the suite writes as a whole."""
DATA_SET_SUFFIXES = (".mcap", ".db3")

JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="F", help="Write all figures as JSON; - for standard output.")
]
HtmlOption = Annotated[Path | None, typer.Option("--html", metavar="F.html", help="Write a page with figures.")]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite/--no-overwrite", help="Replace outputs that exist; without it they are refused.")
]
HTML_SUFFIXES = (".html", ".htm")


def check_suffix(path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Check what the name of an output ends in.

    Raises:
        OutputError: If it is another one.
    """
    if path is not None and path.suffix not in suffixes:
        raise OutputError(f"cannot write '{path}': its name must end in one of {', '.join(suffixes)}")


def check_outputs(*outputs: Path | str | None, overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Check the files that a command writes before the work for them is done.

    Args:
        outputs: Where they shall be; None and `-` are left out.
        overwrite: Whether files that exist may be replaced.
        inputs: What the command reads.

    Raises:
        OutputError: If two outputs, or an output and an input, are one file, one of them exists and `overwrite` is not
            given, or one cannot be written.
    """
    from sfr_loc_map.io.atomic import check_output

    taken = {path.resolve(): "an input of this command" for path in inputs}
    for path in (Path(item) for item in outputs if item is not None and str(item) != STANDARD_OUTPUT):
        place = path.resolve()
        if place in taken:
            raise OutputError(f"cannot write '{path}': it is {taken[place]} too; give each a name of its own")
        taken[place] = "another output"
        _check_free(path, overwrite=overwrite)
        check_output(path)


def _check_free(path: Path, *, overwrite: bool) -> None:
    if not path.exists() and not path.is_symlink():
        return
    if path.is_dir():
        raise OutputError(f"cannot write '{path}': it is a folder; choose another name")
    if not path.is_file() and path.exists():
        raise OutputError(f"cannot write '{path}': it is not a regular file; choose another name")
    if not overwrite:
        raise OutputError(f"cannot write '{path}': a file is there; choose another name or give --overwrite")


@contextmanager
def output_folder(path: Path, *, overwrite: bool, inputs: Sequence[Path] = ()) -> Iterator[None]:
    """Make room for a folder (or a bag) that the block writes as a whole.

    With `overwrite` what is there is moved aside, and moved back where the block leaves nothing in its place.

    Args:
        path: Where it shall be; an empty folder may be there.
        overwrite: Whether a data set or a bag that exists may be replaced.
        inputs: What the command reads; none of it may lie within `path`.

    Raises:
        OutputError: If something else is there, or `overwrite` is not given.
    """
    place = path.resolve()
    if any(place in (item.resolve(), *item.resolve().parents) for item in inputs):
        raise OutputError(f"cannot write '{path}': it is not empty, an input of this command is in it")
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        yield
        return
    what = "a folder that is not empty" if path.is_dir() else "a file"
    if not overwrite:
        raise OutputError(f"cannot write '{path}': {what} is there; remove it, choose another name or give --overwrite")
    if not (path.is_file() or _is_data_set(path)):
        raise OutputError(f"cannot write '{path}': {what} is there, no data set or bag alone; remove it yourself")
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".before", dir=path.parent))
    path.rename(aside / path.name)
    try:
        yield
    finally:
        if not path.exists():
            (aside / path.name).rename(path)
        shutil.rmtree(aside)


def _is_data_set(folder: Path) -> bool:
    """Tell whether a folder holds nothing but what the suite writes into one."""
    return all(item.name in DATA_SET_NAMES or item.suffix in DATA_SET_SUFFIXES for item in folder.iterdir())


def write_text(text: str, path: Path) -> None:
    """Write a text file, whole or not at all."""
    from sfr_loc_map.io.atomic import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def show(json_text: str, place: str | None, tables: Iterable[Table]) -> None:
    """Write the JSON where `--json` says and print the tables; the JSON alone where it goes to standard output."""
    if place == STANDARD_OUTPUT:
        propose_nothing()
        sys.stdout.write(json_text)
        return
    if place is not None:
        write_text(json_text, Path(place))
    from sfr_loc_map.tables.terminal import print_tables

    print_tables(tables)


def warn(text: str) -> None:
    """Print a warning, one line on standard error."""
    say(f"sfr: warning: {one_line(text)}", err=True)


def say(text: str, *, err: bool = False) -> None:
    """Print a text that may hold names and words of files: printable, on standard output or standard error."""
    typer.echo(printable(text), err=err)
