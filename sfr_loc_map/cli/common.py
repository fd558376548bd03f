"""What several subcommands share: options, sources, configuration files, progress bars."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.output import say
from sfr_loc_map.config import read_config as read_config
from sfr_loc_map.errors import ConfigError, MissingExtraError
from sfr_loc_map.errors import naming as naming

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import LocSequence, NavSequence

_NAMESPACE = re.compile(r"/?([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?/?")


def checked_namespace(text: str) -> str:
    """Return a namespace of ROS, the value of an option.

    Raises:
        ConfigError: If it is none.
    """
    if not _NAMESPACE.fullmatch(text):
        raise ConfigError(f"--namespace '{text}' is none of ROS: give names of letters, digits and _ joined by /")
    return text


NamespaceOption = Annotated[
    str, typer.Option("--namespace", metavar="NS", callback=checked_namespace, help="Namespace of the rover.")
]
SourceArgument = Annotated[
    Path,
    typer.Argument(
        metavar="SRC", help="Data set folder, bag of ROS 2 or 1, or sequence of KITTI, EuRoC, MADMAX, Katwijk, LuSNAR."
    ),
]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="P.yaml", help="File with parameters.")]
RemapOption = Annotated[
    list[str] | None,
    typer.Option("--remap", metavar="FOUND:=EXPECTED", help="Topic of a bag under another name; repeatable."),
]
ConditionOption = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        metavar="distance=M|time=S|frames=N",
        autocompletion=completion.conditions,
        show_default="distance=5",
        help="End of a sub-trajectory; repeatable.",
    ),
]
StartOption = Annotated[
    str,
    typer.Option(
        "--start",
        metavar="identity|truth",
        help="First pose: the identity, or the true one.",
        autocompletion=completion.words("identity", "truth"),
    ),
]

MethodOption = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="NAME|package.module:Class|lib:FILE.so",
        autocompletion=completion.methods,
        help="Method under test (sfr methods); --config is then the file with its configuration.",
    ),
]
CallTimeoutOption = Annotated[
    float, typer.Option("--call-timeout", metavar="S", help="Longest time of a call of a method under test.")
]
MemoryLimitOption = Annotated[
    int, typer.Option("--memory-limit", metavar="MB", help="Resident memory at which a method under test is ended.")
]


def check_start(start: str) -> str:
    """Return a valid `--start`.

    Raises:
        ConfigError: If it is another word.
    """
    if start not in ("identity", "truth"):
        raise ConfigError(f"'--start {start}': must be identity or truth")
    return start


def require_ros(command: str) -> None:
    """Check that ROS can be imported.

    Args:
        command: Subcommand that needs it.

    Raises:
        MissingExtraError: If it cannot.
    """
    try:
        from sfr_loc_map.nodes.lifecycle import qos  # noqa: F401 - does it import?
        from sfr_loc_map.nodes.messages import pose  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"sfr {command} needs ROS 2 ({error}): source a ROS 2 installation, or pip install 'sfr_loc_map[ros]'"
        ) from error


def open_drive(source: Path, remap: list[str] | None) -> LocSequence:
    """Return the localisation pairs of a source.

    Raises:
        InputError: If it has none.
    """
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import drive_of

    return drive_of(open_source(source, parse_remaps(remap)))


def open_panorama(source: Path, remap: list[str] | None) -> NavSequence:
    """Return the mapping pairs of a source.

    Raises:
        InputError: If it has none.
    """
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import panorama_of

    return panorama_of(open_source(source, parse_remaps(remap)))


def parse_remaps(remaps: list[str] | None) -> dict[str, str]:
    """Return remappings `FOUND:=EXPECTED` as a mapping.

    Raises:
        ConfigError: If one has another form.
    """
    parsed: dict[str, str] = {}
    for item in remaps or []:
        found, separator, expected = item.partition(":=")
        if not separator or not found or not expected:
            raise ConfigError(
                f"'--remap {item}': must have the form FOUND:=EXPECTED, as /cam0/image:=loc/left/image_rect"
            )
        parsed[found] = expected
    return parsed


def each_tenth(doing: str, unit: str) -> Callable[[int, int], None]:
    """Return what takes how many of how many are done and prints a line each 10 %, where no progress bar is drawn."""
    tenth = 0

    def report(done: int, total: int) -> None:
        nonlocal tenth
        before, tenth = tenth, max(tenth, 10 * done // max(total, 1))
        if tenth > before and not Console(stderr=True).is_terminal:
            say(f"{doing}: {10 * tenth} % ({done} of {total} {unit})", err=True)

    return report


def progress_bar(unit: str) -> Progress:
    """Return a progress bar on standard error; nothing is drawn where that is not a terminal."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
