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

COMMANDS = ("localise", "map", "convert", "score", "replay", "report", "simulate", "perturb", "compare")
MODULES = {"map": "map_cloud"}
FUNCTIONS = {"map": "map_cloud"}

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Stereo localisation, terrain mapping and the metrics that prove how good they are.",
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sfr {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
) -> None:
    if debug:
        os.environ["SFR_DEBUG"] = "1"


for _name in COMMANDS:
    _module = importlib.import_module(f"sfr_loc_map.cli.{MODULES.get(_name, _name)}")
    app.command(_name)(getattr(_module, FUNCTIONS.get(_name, _name)))


def main() -> int:
    """Run the command line; return the exit code."""
    try:
        app(standalone_mode=True)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    except FailedVerdictError as verdict:
        print(f"sfr: {verdict}", file=sys.stderr)
        return 1
    except (SfrError, OSError) as error:
        if os.environ.get("SFR_DEBUG"):
            raise
        print("sfr: " + " ".join(str(error).split()), file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("sfr: stopped by the user", file=sys.stderr)
        return 130
    return 0
