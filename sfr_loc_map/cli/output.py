"""Outputs of the subcommands: files, JSON, messages, tables and progress bars.

A command refuses to replace an existing output unless `--overwrite` is given, and checks this before it starts to work.
Only a regular file, or a folder that contains only a data set or a bag, can be replaced.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sfr_loc_map import atomic
from sfr_loc_map import suffixes as file_suffixes
from sfr_loc_map.atomic import atomic_path, check_output, output_target, replace_by, write_text
from sfr_loc_map.cli.app import current_run
from sfr_loc_map.cli.source_files import has_only_data_set, source_of_file
from sfr_loc_map.errors import OutputError, SfrError
from sfr_loc_map.message_text import one_line, printable

if TYPE_CHECKING:
    from sfr_loc_map.tables.model import Table

STANDARD_OUTPUT = "-"
RESULT_SUFFIXES = (".json", ".xml")  #: Suffixes of results that other programs read: JSON and JUnit.


def check_suffix(path: Path | None, suffixes: Collection[str]) -> None:
    """Raise OutputError if the name of an output, if given, does not end in one of the suffixes."""
    if path is not None:
        file_suffixes.check_suffix(path, suffixes)


def claim_outputs(*outputs: Path | str | None, inputs: Iterable[Path | None] = (), overwrite: bool) -> None:
    """Check and note the files that the command will write, before the work is done; None and the text `-` are ignored.

    Raises OutputError if a file cannot be written. Noted files are named in the message after an interruption.
    Only `--json` can be standard output, and its value is a text; the path `-` is a file. An output must differ from
    the inputs of the command and from the files of its sources. With `overwrite`, results that exist are removed, so
    that a command that fails does not leave the verdict of an earlier command.
    """
    given = {path.resolve() for path in inputs if path is not None}
    taken = dict.fromkeys(given, "it is also an input of this command")
    results: list[Path] = []
    for path in (Path(item) for item in outputs if item is not None and item != STANDARD_OUTPUT):
        if reason := _why_not_writable(path, given, taken, overwrite=overwrite):
            raise OutputError(f"cannot write '{path}': {reason}")
        check_output(path)
        taken[path.resolve()] = "another output has this name"
        current_run().add_output(path)
        results += [output_target(path)] if file_suffixes.suffix_of(path) in RESULT_SUFFIXES else []
    for path in results:
        path.unlink(missing_ok=True)


def _why_not_writable(path: Path, inputs: set[Path], taken: Mapping[Path, str], *, overwrite: bool) -> str:
    """Return why a file must not be written, with advice; empty if it may be written.

    `taken` has the reasons by path.
    """
    place = path.resolve()
    if path.is_file() and (owner := source_of_file(place, inputs)) is not None:
        return f"it belongs to '{owner}', an input of this command; choose another name"
    if place in taken:
        return f"{taken[place]}; choose another name"
    if path.is_dir():
        return "it is a folder; choose another name"
    if path.exists() and not path.is_file():
        return "it is not a regular file; choose another name"
    if not overwrite and (path.exists() or path.is_symlink()):
        return "a file exists; choose another name or give --overwrite"
    return ""


@contextmanager
def output_folder(
    path: Path, *, overwrite: bool, inputs: Sequence[Path] = (), resumable: bool = False
) -> Iterator[Path]:
    """Yield the path at which the block writes a folder or a bag.

    With `overwrite` the existing output is replaced in one step after the block has succeeded. If `resumable`, the new
    output is written to `.NAME.unfinished`, which is kept if the block fails.
    """
    place = path.resolve()
    if any(place in (item.resolve(), *item.resolve().parents) for item in inputs):
        raise OutputError(f"cannot write '{path}': it is or contains an input of this command; choose another name")
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        yield path
        return
    what = "a folder that is not empty" if path.is_dir() else "a file"
    if not overwrite:
        raise OutputError(f"cannot write '{path}': {what} exists; remove it, choose another name or give --overwrite")
    if path.is_dir() and not has_only_data_set(path):
        raise OutputError(
            f"cannot write '{path}': the folder has files that belong to neither a data set nor a bag, so "
            "--overwrite does not replace it; choose another name"
        )
    if not resumable:
        with atomic_path(path, any_folder=True) as temporary:
            yield temporary
        return
    target = output_target(path, any_folder=True)
    new = target.with_name(f".{target.name}.unfinished")
    yield new
    replace_by(new, path)


@contextmanager
def secondary_output() -> Iterator[None]:
    """Report the failure of a secondary output as a warning; the command continues and exits with code 2."""
    try:
        yield
    except (SfrError, OSError) as error:
        warn(str(error))
        current_run().failed_outputs.append(str(error))


def make_folder(path: Path, option: str) -> None:
    """Create the folder that an option or argument names, if it does not exist."""
    atomic.make_folder(path, f"choose another {option}")


def show(content: object, place: str | None, tables: Iterable[Table]) -> None:
    """Write a record as JSON to the file of `--json` and print the tables; with `-`, print only the JSON."""
    from sfr_loc_map.metrics.stored.score_json import json_line
    from sfr_loc_map.tables.formats import print_tables

    if place == STANDARD_OUTPUT:
        current_run().prints_json = True
        typer.echo(json_line(content), nl=False)
        return
    if place is not None:
        with secondary_output():
            write_text(json_line(content), Path(place))
    print_tables(tables)


def warn(text: str) -> None:
    """Print a warning, one line on standard error."""
    say(f"sfr: warning: {one_line(text)}", err=True)


def say(text: str, *, err: bool = False) -> None:
    """Print a text on standard output or standard error, with unprintable characters escaped."""
    typer.echo(printable(text), err=err)


def progress_bar(unit: str) -> Progress:
    """Return a progress bar on standard error, disabled if standard error is not a terminal."""
    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(TextColumn("{task.description}"), *columns, console=console, disable=not console.is_terminal)


@contextmanager
def pairs_progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar of pairs while the block runs; yield a function that sets the number of finished pairs."""
    with progress_bar("pairs") as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def counting(bar: Progress, what: str, total: int) -> Callable[[], None]:
    """Return a function that counts a step on the bar; without a terminal, it prints a line after each tenth."""
    shown = bar.add_task(what, total=total)
    tenths = {total * tenth // 10 for tenth in range(1, 11)}
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        bar.advance(shown)
        if bar.disable and done in tenths:
            say(f"{what}: {done} of {total}", err=True)

    return advance
