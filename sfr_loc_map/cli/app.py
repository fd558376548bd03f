"""The application `sfr` that the subcommands join: options in groups, the last line.

The last line of a command says what is useful next. It goes to standard error behind all other lines, as the hints of
git do. There is none after bad input or an interruption, none where JSON goes to standard output (a program reads it),
and none at all with `sfr --no-hints` or `SFR_HINTS=0`.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Callable
from copy import copy
from dataclasses import fields, is_dataclass
from inspect import Parameter, Signature, cleandoc, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperGroup
from typer.models import OptionInfo

from sfr_loc_map import __version__
from sfr_loc_map.errors import ConfigError, ExitCode

EXIT_CODES = (
    "Exit codes: 0 all well; 1 a limit was missed, or the doctor found something; 2 bad input or usage; "
    "3 something could not be judged (0 with --lenient); 130 interrupted, with what was finished reported."
)
PANELS = {
    "Look": ("info", "doctor", "init"),
    "Run": ("replay", "localise", "map", "live", "run", "record"),
    "Judge": ("score", "report"),
    "Many runs": ("suite",),
    "Methods of your own": ("bench",),
    "Data": ("convert", "simulate"),
}
"""Subcommands in the order of the help, that of a user's day, below their titles."""
MOVED = {
    "sfr compare": "sfr report A.json B.json",
    "sfr plot": "sfr report T.csv --truth TRUTH -o paths.html",
    "sfr perturb": "sfr simulate DST --from SRC --fault KIND",
    "sfr history": "sfr suite history DIR...",
    "sfr methods": "sfr bench methods",
    "sfr monitor": "sfr run monitor",
    "sfr suite compare": "sfr report A B",
}
"""Former subcommands and what replaces each."""
HINTS = "SFR_HINTS"
_proposed: list[str] = []
GIVEN: list[Path] = []  #: Files and folders on the command line of the command that runs: inputs and outputs.


def propose(*words: str | Path, why: str = "") -> None:
    """Set what the command shows in its last line: a command line, quoted here unless it is one word; none for none.

    A first word `...` stands for the command line as it was given.
    """
    line = str(words[0]) if len(words) == 1 else shlex.join(map(str, words))
    if line.startswith("..."):
        line = shlex.join(["sfr", *sys.argv[1:]]) + line[3:]
    _proposed[:] = [f"{line}    # {why}" if why else line] if line else []


def last_line(code: int) -> str:
    """Return the last line of a command that ended with an exit code, empty for none, and forget it."""
    lines, _proposed[:] = list(_proposed), []
    wanted = os.environ.get(HINTS, "1") != "0" and code in (ExitCode.OK, ExitCode.FAILED, ExitCode.NOT_JUDGED)
    return f"next: {lines[0]}" if lines and wanted else ""


class _Group(TyperGroup):
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - click's, or the copy within typer
        """Return a subcommand and its arguments; raise ConfigError for the name of a former one."""
        former = " ".join(("sfr", *([] if ctx.parent is None else [ctx.info_name]), args[0]))
        if former in MOVED:
            raise ConfigError(f"'{former}' does not exist any more: use {MOVED[former]}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401 - as above
        """Return the subcommands of `sfr` in the order of PANELS; those of a group as they were added."""
        names = super().list_commands(ctx)
        order = {name: place for place, name in enumerate(name for names in PANELS.values() for name in names)}
        return sorted(names, key=lambda name: order.get(name, len(order))) if ctx.parent is None else names


def help_without_command(context: typer.Context) -> None:
    """Show the help where no subcommand is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


class App(typer.Typer):
    """A group of commands, whose parameters may be dataclasses of options."""

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - those of typer
        names = {"help_option_names": ["-h", "--help"]}
        super().__init__(cls=_Group, pretty_exceptions_enable=False, context_settings=names, **settings)
        self.callback(invoke_without_command=True)(help_without_command)

    def command(
        self,
        name: str | None = None,
        *,
        hint: str = "",
        first: str = "",
        **settings: Any,  # noqa: ANN401 - those of typer
    ) -> Callable[[Any], Any]:
        """Return the decorator of a subcommand.

        `hint` is its last line where it proposes nothing better. `first` names the options that most users need: they
        come first in its help, in that order, and all others below their titles.
        """
        add = super().command

        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            text = cleandoc(settings.pop("help", function.__doc__))
            shown = re.sub(r"(?<!\n)\n(?!\n)", " ", text).replace("[", r"\[")  # wrapped by the terminal, no markup
            add(name, help=shown, **settings)(_with_groups(function, hint, first.split()))
            return function

        return register


def _with_groups(function: Callable[..., Any], hint: str, first: list[str]) -> Callable[..., Any]:
    """Return a command with an option for each field of its parameters that are dataclasses, under their title."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[Parameter] = []

    def add(name: str, annotation: Any, default: object, title: str | None) -> None:  # noqa: ANN401 - a type
        kind, option = get_args(annotation)
        place = -1  # arguments stay first
        if isinstance(option, OptionInfo):
            option = copy(option)
            if kind is bool and option.default is ...:  # it names none: one that has no `--no-NAME`
                option.param_decls = (f"--{name.replace('_', '-')}",)
            option.rich_help_panel = None if name in first else title
            place = first.index(name) if name in first else len(first)
        annotation = Annotated[kind, option]
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation))
        places[name] = place

    places: dict[str, int] = {}
    for name, given in signature(function).parameters.items():
        if name not in groups:
            add(name, hints[name], given.default, "More" if first else None)
            continue
        types = get_type_hints(groups[name], include_extras=True)
        for item in fields(groups[name]):
            add(item.name, types[item.name], item.default, groups[name].__doc__.rstrip("."))
    parameters.sort(key=lambda item: places[item.name])

    def call(**values: Any) -> Any:  # noqa: ANN401 - those of the options
        propose(hint)
        listed = (value if isinstance(value, list) else [value] for value in values.values())
        GIVEN[:] = [item for items in listed for item in items if isinstance(item, Path)]
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
