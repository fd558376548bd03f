"""The command `sfr`: one module per subcommand, errors in one line, exit codes.

A subcommand's module defines one function of the subcommand's name and imports what is heavy inside it, so that
`sfr --help` is quick. It raises `SfrError`; only this module prints errors: exit 2 for bad input or usage, 1 for a
failed verdict (`FailedVerdictError`), 0 otherwise.
"""

from __future__ import annotations

import importlib
import os
import sys

import typer

from sfr_loc_map import __version__
from sfr_loc_map.errors import FailedVerdictError, SfrError

COMMANDS = (
    "localise",
    "map",
    "convert",
    "score",
    "replay",
    "run",
    "record",
    "report",
    "simulate",
    "perturb",
    "compare",
    "doctor",
)
GROUPS = ("bench", "campaign")
MODULES = {"map": "map_cloud"}
FUNCTIONS = {"map": "map_cloud"}
PASSES_ON = ("run",)
PASSED_ON = {"ignore_unknown_options": True}
"""Settings of commands that pass on what they do not know to ROS."""
INTERRUPTED = 130

UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # of click or of the copy within typer, by its version

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Stereo localisation, terrain mapping and the metrics that prove how good they are.",
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sfr {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
) -> None:
    if debug:
        os.environ["SFR_DEBUG"] = "1"
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


for _name in COMMANDS:
    _module = importlib.import_module(f"sfr_loc_map.cli.{MODULES.get(_name, _name)}")
    _settings = PASSED_ON if _name in PASSES_ON else None
    app.command(_name, context_settings=_settings)(getattr(_module, FUNCTIONS.get(_name, _name)))
for _name in GROUPS:
    app.add_typer(importlib.import_module(f"sfr_loc_map.cli.{_name}").app, name=_name)


def main() -> int:
    """Run the command line; return the exit code."""
    try:
        code = app(standalone_mode=False, prog_name="sfr")
    except SystemExit:  # whoever read the output has closed it
        return 0
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except FailedVerdictError as verdict:
        return _say(str(verdict), 1)
    except Exception as error:
        if os.environ.get("SFR_DEBUG"):
            raise
        return _say(_line(error), 2)
    if code == INTERRUPTED:
        return _say("stopped by the user", INTERRUPTED)
    return code if isinstance(code, int) else 0


def _line(error: Exception) -> str:
    """Return what to say of an error."""
    if isinstance(error, UsageError):
        context: typer.Context | None = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "sfr"
        message: str = error.format_message()  # type: ignore[attr-defined]
        return f"{message.rstrip('.')}: see '{command} --help'"
    if isinstance(error, (SfrError, OSError)):
        return str(error)
    return f"{type(error).__name__}: {error}: this is a fault of the program, run 'sfr --debug ...' and report it"


def _say(message: str, code: int) -> int:
    print("sfr: " + " ".join(message.split()), file=sys.stderr)
    return code
