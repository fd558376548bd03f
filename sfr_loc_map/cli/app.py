"""The application `sfr` that the subcommands join."""

from __future__ import annotations

import os

import typer

from sfr_loc_map import __version__

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Stereo localisation, terrain mapping and the metrics that evaluate them.",
)


def help_without_command(context: typer.Context) -> None:
    """Show the help where no subcommand is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


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
    help_without_command(context)
