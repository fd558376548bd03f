"""The application `sfr`, to which the subcommands are added, and the last line of a command.

The last line of a command proposes the next command. The line is printed to standard error after all other lines, like
the hints of git. It is omitted after bad input or an interruption, if JSON is printed to standard output (for a
program), and with `sfr --no-hints` or `SFR_HINTS=0`.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from sfr_loc_map import __version__
from sfr_loc_map.cli import former
from sfr_loc_map.errors import ExitCode

EXIT_CODES = (
    "Exit codes: 0 success; 1 a limit was missed or a blocking issue was found; 2 bad input or usage; "
    "3 something could not be judged (0 with --lenient); 70 fault of the program; "
    "130 interrupted (finished results are reported)."
)
PANELS = {
    "Look": ("info", "doctor", "init"),
    "Run": ("replay", "localise", "map", "live", "run", "record"),
    "Judge": ("score", "report", "check"),
    "Many runs": ("suite",),
    "Methods of your own": ("bench",),
    "Data": ("convert", "simulate"),
}
"""Subcommands in the order of the help, grouped by the titles of its panels.

A new command requires an entry here, and a module of `cli` with its name. The module has a function with
`@app.command`, or the `group` (`command_group`) of its subcommands.
"""
HINTS = "SFR_HINTS"


# ---- one run of a command


def _state_of(path: Path) -> tuple[int, int] | None:
    """Return number and time of a file, which differ after the file is written; None if the file does not exist."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


@dataclass(slots=True)
class CommandRun:
    """What a running command notes for its last line, its exit code and the message after an interruption."""

    next_line: str = ""  #: Proposed next command; empty if there is none.
    prints_json: bool = False  #: Whether JSON is printed to standard output.
    failed_outputs: list[str] = field(default_factory=list)  #: Failures of secondary outputs.
    #: Files that the command writes, each with its state before (`_state_of`).
    outputs: dict[Path, tuple[int, int] | None] = field(default_factory=dict)

    def add_output(self, path: Path) -> None:
        """Note a file that the command writes, before it is written."""
        self.outputs.setdefault(path, _state_of(path))

    @property
    def finished_outputs(self) -> list[Path]:
        """The noted files that have been written. They are complete, because files are written atomically."""
        return [path for path, before in self.outputs.items() if _state_of(path) not in (None, before)]

    def last_line(self, code: int) -> str:
        """Return the last line of a command that ended with an exit code; empty if there is none."""
        if self.prints_json or os.environ.get(HINTS, "1") == "0":
            return ""
        is_shown = code in (ExitCode.OK, ExitCode.FAILED, ExitCode.NOT_JUDGED)
        return f"next: {self.next_line}" if self.next_line and is_shown else ""


_current: ContextVar[CommandRun] = ContextVar("command_run")


@contextmanager
def command_run() -> Iterator[CommandRun]:
    """Yield the record of one command; `current_run` returns this record within the block."""
    run = CommandRun()
    token = _current.set(run)
    try:
        yield run
    finally:
        _current.reset(token)


def current_run() -> CommandRun:
    """Return the record of the running command; outside of `command_run` return a new record, which is not shown."""
    return _current.get(CommandRun())


def command_line() -> str:
    """Return the command line of the user, with `sfr` as its first word."""
    return shlex.join(["sfr", *sys.argv[1:]])


def propose(*words: str | Path, why: str = "") -> None:
    """Propose a command line as the last line of the command; several words are quoted for the shell."""
    line = str(words[0]) if len(words) == 1 else shlex.join(map(str, words))
    current_run().next_line = f"{line}    # {why}" if why else line


def propose_again(*options: str, why: str) -> None:
    """Propose the command line of the user with further options."""
    propose(" ".join((command_line(), *options)), why=why)


def propose_page(page: str | Path, more: str = "") -> None:
    """Propose to open a page in a browser; `more` is added to the text."""
    propose(f"open {shlex.quote(str(page))} in a browser{more}")


# ---- the application


class _Group(TyperGroup):
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - click's, or the copy within typer
        """Return a subcommand and its arguments; raise ConfigError for a removed subcommand."""
        former.check_command(" ".join(("sfr", *([] if ctx.parent is None else [ctx.info_name]), args[0])))
        return super().resolve_command(ctx, args)


class _Commands(_Group):
    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401 - as above
        """Return the subcommands of `sfr` in the order of PANELS; those of a group are in the order of definition."""
        in_panels = [name for panel in PANELS.values() for name in panel]
        return sorted(super().list_commands(ctx), key=in_panels.index)


def help_without_command(context: typer.Context) -> None:
    """Show the help if no subcommand is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def command_group(text: str, epilog: str | None = None, kind: type[TyperGroup] = _Group) -> typer.Typer:
    """Return a group of commands with its help."""
    group = typer.Typer(
        cls=kind,
        help=text,
        epilog=epilog,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    group.callback(invoke_without_command=True)(help_without_command)
    return group


def examples(*lines: str) -> str:
    """Return the epilog of a command's help, with one example per line."""
    return "\n\n".join(("Examples:", *lines))


app = command_group("Stereo localisation, terrain mapping and the metrics that evaluate them.", EXIT_CODES, _Commands)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sfr {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    no_hints: bool = typer.Option(False, "--no-hints", help="Omit the last line, which proposes the next command."),
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
) -> None:
    if debug:
        os.environ["SFR_DEBUG"] = "1"
    if no_hints:
        os.environ[HINTS] = "0"
    help_without_command(context)
