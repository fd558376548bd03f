"""The application `sfr` that the subcommands join, and the form of its help."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup

from sfr_loc_map import __version__
from sfr_loc_map.cli.next_step import SWITCH, propose_default

EXIT_CODES = (
    "Exit codes: 0 all well; 1 a limit was missed, or the doctor found something; 2 bad input or usage; "
    "3 something could not be judged (0 with --lenient); 130 interrupted, with what was finished reported."
)


class _Command(TyperCommand):
    """A command whose help shows no Python type beside an argument or a switch, which have names of their own."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - click's own, or the copy within typer, by its version
        """Return the parameters."""
        return _without_types(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 - as above
        """Run the command; its last line is the usual one until it proposes another."""
        propose_default(ctx.command_path.partition(" ")[2])
        return super().invoke(ctx)


class _Group(TyperGroup):
    """The same for a group of commands."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - as above
        """Return the parameters."""
        return _without_types(super().get_params(ctx))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - as above
        """Return a subcommand and its arguments; `sfr monitor` is `sfr run monitor`."""
        return super().resolve_command(ctx, ["run", *args] if ctx.parent is None and args[0] == "monitor" else args)


def _without_types(params: list[Any]) -> list[Any]:
    for param in params:
        if isinstance(param, TyperArgument) or getattr(param, "is_flag", False):
            param.display_type_rich = _no_type
    return params


def _no_type(ctx: object) -> None:
    """Return what stands in the column of types."""


class App(typer.Typer):
    """A group of commands with help of that form."""

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - those of typer
        """Make a group that shows its help where no subcommand is given."""
        super().__init__(cls=_Group, pretty_exceptions_enable=False, **settings)

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:  # noqa: ANN401 - those of typer
        """Return the decorator of a subcommand."""
        return super().command(name, cls=_Command, **settings)


def examples(*lines: str) -> str:
    """Return the end of a command's help: one example a line."""
    return "\n\n".join(("Examples:", *lines))


app = App(help="Stereo localisation, terrain mapping and the metrics that evaluate them.", epilog=EXIT_CODES)


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
    no_hints: bool = typer.Option(False, "--no-hints", help="Leave out the last line, which says what is useful next."),
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
) -> None:
    if debug:
        os.environ["SFR_DEBUG"] = "1"
    if no_hints:
        os.environ[SWITCH] = "0"
    help_without_command(context)
