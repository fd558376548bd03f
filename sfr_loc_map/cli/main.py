"""The command `sfr`: prints errors in one line and returns exit codes.

The modules of subcommands import NumPy, and modules that require NumPy, inside their functions, so that `sfr --help` is
fast. They raise `SfrError`. This module prints the error that ends a command, and returns its code (`errors.ExitCode`).
"""

from __future__ import annotations

import logging
import os
import sys
import traceback
from contextlib import suppress
from importlib import import_module

import typer

from sfr_loc_map.cli.app import PANELS, app, command_run, current_run
from sfr_loc_map.errors import ExitCode, SfrError
from sfr_loc_map.message_text import one_line, printable
from sfr_loc_map.signals import handle_signals, hold, ignore_signals

UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # the class of click, or of typer's copy of click

_panel_of = {name: panel for panel, names in PANELS.items() for name in names}
for _name, _panel in _panel_of.items():
    _module = import_module(f"sfr_loc_map.cli.{_name}")  # a function of the module joins `app`, or it has a `group`
    if hasattr(_module, "group"):
        app.add_typer(_module.group, name=_name, rich_help_panel=_panel)
for _command in app.registered_commands:
    _command.name = _command.name or str(getattr(_command.callback, "__name__", ""))
    _command.rich_help_panel = _panel_of[_command.name]


class _LineFormatter(logging.Formatter):
    """Writes a warning of the library as one printable line."""

    def format(self, record: logging.LogRecord) -> str:
        return f"sfr: {record.levelname.lower()}: {one_line(record.getMessage())}"


class _Once(logging.Filter):
    """Drops repeated warnings, because one command may open and read a source several times."""

    def __init__(self) -> None:
        super().__init__()
        self._written: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        text = record.getMessage()
        if text in self._written:
            return False
        self._written.add(text)
        return True


def main() -> int:
    """Run the command line; return the exit code."""
    handle_signals()
    with command_run() as record:
        code = _run()
    hold()
    if record.failed_outputs and code == ExitCode.OK:
        code = ExitCode.BAD_INPUT
    if line := record.last_line(code):
        with suppress(OSError):  # the reader has closed the stream
            print(printable(line), file=sys.stderr)
    ignore_signals()
    return code


def _run() -> int:
    if logging.lastResort is not None:  # the handler if logging is not set up
        logging.lastResort.setFormatter(_LineFormatter())
        logging.lastResort.filters = [_Once()]
    try:
        code = app(standalone_mode=False, prog_name="sfr")
    except SystemExit:  # the reader of the output (`| head`) has closed it
        return ExitCode.INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        hold()  # a second signal must not interrupt the message
        code = ExitCode.INTERRUPTED
    except Exception as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # otherwise the interrupt made an import fail
            return _reported(error)
        code = ExitCode.INTERRUPTED
    if code == ExitCode.INTERRUPTED:
        finished = ", ".join(str(path) for path in current_run().finished_outputs)
        print(f"sfr: interrupted: {one_line(finished or 'nothing')} was finished", file=sys.stderr)
    return code if isinstance(code, int) else 0


def _reported(error: Exception) -> ExitCode:
    """Print an error in one line, with `--debug` after its traceback; return its exit code."""
    code = _code_of(error)
    if os.environ.get("SFR_DEBUG") and code in (ExitCode.BAD_INPUT, ExitCode.FAULT):
        traceback.print_exception(error)
    print(f"sfr: {one_line(_line(error))}", file=sys.stderr)
    return code


def _code_of(error: Exception) -> ExitCode:
    if isinstance(error, SfrError):
        return error.exit_code
    return ExitCode.BAD_INPUT if isinstance(error, (UsageError, OSError)) else ExitCode.FAULT


def _line(error: Exception) -> str:
    if isinstance(error, UsageError):
        context: typer.Context | None = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "sfr"
        message: str = error.format_message()  # type: ignore[attr-defined]
        message = message.replace(": Value error, ", ": ").rstrip(".")  # the validation of option values adds this
        return f"{message}: see '{command} --help'"
    if isinstance(error, OSError) and error.strerror and not error.filename:  # an error of an open stream names no file
        return f"cannot write to standard output, or read or write an open file: {error.strerror}; check the disk"
    if isinstance(error, (SfrError, OSError)):
        return str(error)
    return f"{type(error).__name__}: {error}: this is a fault of the program, run 'sfr --debug ...' and report it"
