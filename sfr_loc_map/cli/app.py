"""The application `sfr` that the subcommands join: options in groups, the last line.

The last line of a command says what is useful next. It goes to standard error behind all other lines, as the hints of
git do. There is none after bad input or an interruption, none where JSON goes to standard output (a program reads it),
and none at all with `sfr --no-hints` or `SFR_HINTS=0`.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable
from copy import copy
from dataclasses import fields, is_dataclass
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperGroup

from sfr_loc_map import __version__
from sfr_loc_map.errors import ExitCode

EXIT_CODES = (
    "Exit codes: 0 all well; 1 a limit was missed, or the doctor found something; 2 bad input or usage; "
    "3 something could not be judged (0 with --lenient); 130 interrupted, with what was finished reported."
)
HINTS = "SFR_HINTS"
_proposed: list[str] = []


def propose(*words: str | Path, why: str = "") -> None:
    """Set what the command shows in its last line: a command line, quoted here unless it is one word; none for none."""
    line = str(words[0]) if len(words) == 1 else shlex.join(map(str, words))
    _proposed[:] = [f"{line}    # {why}" if why else line] if line else []


def last_line(code: int) -> str:
    """Return the last line of a command that ended with an exit code, empty for none, and forget it."""
    lines, _proposed[:] = list(_proposed), []
    wanted = os.environ.get(HINTS, "1") != "0" and code in (ExitCode.OK, ExitCode.FAILED, ExitCode.NOT_JUDGED)
    return f"next: {lines[0]}" if lines and wanted else ""


class _Group(TyperGroup):
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - click's, or the copy within typer
        """Return a subcommand and its arguments; `sfr monitor` is `sfr run monitor`."""
        return super().resolve_command(ctx, ["run", *args] if ctx.parent is None and args[0] == "monitor" else args)


class App(typer.Typer):
    """A group of commands, whose parameters may be dataclasses of options."""

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - those of typer
        super().__init__(cls=_Group, pretty_exceptions_enable=False, **settings)

    def command(
        self,
        name: str | None = None,
        *,
        hint: str = "",
        **settings: Any,  # noqa: ANN401 - those of typer
    ) -> Callable[[Any], Any]:
        """Return the decorator of a subcommand; `hint` is its last line where it proposes nothing better."""
        add = super().command(name, **settings)

        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            add(_with_groups(function, hint))
            return function

        return register


def _with_groups(function: Callable[..., Any], hint: str) -> Callable[..., Any]:
    """Return a command with an option for each field of its parameters that are dataclasses, under their title."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters = []
    for name, given in signature(function).parameters.items():
        if name not in groups:
            parameters.append(given.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name]))
            continue
        types = get_type_hints(groups[name], include_extras=True)
        for item in fields(groups[name]):
            kind, option = get_args(types[item.name])
            option = copy(option)
            option.rich_help_panel = groups[name].__doc__.rstrip(".")
            annotation = Annotated[kind, option]  # type: ignore[valid-type]
            parameters.append(Parameter(item.name, Parameter.KEYWORD_ONLY, default=item.default, annotation=annotation))

    def call(**values: Any) -> Any:  # noqa: ANN401 - those of the options
        propose(hint)
        for name, kind in groups.items():
            values[name] = kind(**{item.name: values.pop(item.name) for item in fields(kind)})
        return function(**values)

    call.__name__, call.__doc__ = function.__name__, function.__doc__
    call.hint = hint  # type: ignore[attr-defined]
    call.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {item.name: item.annotation for item in parameters}
    return call


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
        os.environ[HINTS] = "0"
    help_without_command(context)
