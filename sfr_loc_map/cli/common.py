"""What several subcommands share: options, sources, configuration files, progress bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sfr_loc_map.cli.output import say
from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.errors import (
    ConfigError,
    GeometryError,
    InputError,
    LocalisationError,
    MappingError,
    MissingExtraError,
)

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import LocSequence, NavSequence

C = TypeVar("C")

SourceArgument = Annotated[
    Path, typer.Argument(metavar="SRC", help="Data set folder, ROS 2 bag (mcap, sqlite3), KITTI or EuRoC sequence.")
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
        show_default="distance=5",
        help="End of a sub-trajectory; repeatable.",
    ),
]
StartOption = Annotated[
    str, typer.Option("--start", metavar="identity|truth", help="First pose: the identity, or the true one.")
]

MethodOption = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="NAME|package.module:Class|lib:FILE.so",
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

    sequence = open_source(source, parse_remaps(remap)).loc
    if sequence is None or not len(sequence):
        raise InputError(f"no drive (localisation pairs) in '{source}': give a source that has one")
    return sequence


def open_panorama(source: Path, remap: list[str] | None) -> NavSequence:
    """Return the mapping pairs of a source.

    Raises:
        InputError: If it has none.
    """
    from sfr_loc_map.io.registry import open_source

    sequence = open_source(source, parse_remaps(remap)).nav
    if sequence is None or not len(sequence):
        raise InputError(f"no mapping pairs in '{source}': give a source that has them")
    return sequence


@contextmanager
def naming(source: Path) -> Iterator[None]:
    """Let the errors that come of a source name it."""
    try:
        yield
    except (InputError, GeometryError, LocalisationError, MappingError) as error:
        if str(source) in str(error):
            raise
        raise type(error)(f"'{source}': {error}") from error


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


def read_config(config_type: type[C], path: Path | None, section: str) -> C:
    """Read the parameters of one part from a YAML file.

    The file is either a ROS parameter file (`/**: ros__parameters:` or `NODE: ros__parameters:`), of which the keys of
    this part are taken, or a plain mapping of parameter names, optionally below the part's name.

    Args:
        config_type: Configuration class.
        path: File, or None for the defaults.
        section: Name of the part: `localisation` or `mapping`.

    Raises:
        ConfigError: If the file or a value in it is not valid.
    """
    if path is None:
        return config_type()
    content = load_yaml(path)
    blocks = {
        key: block["ros__parameters"]
        for key, block in content.items()
        if isinstance(block, dict) and isinstance(block.get("ros__parameters"), dict)
    }
    values: dict[str, Any] = {}
    for key in ("/**", f"{section}_node", f"/{section}_node", f"/**/{section}_node"):
        values.update(_section(blocks.get(key, {}), section))
    if not blocks:
        other = {"localisation", "mapping"} - {section}
        values = (
            content[section]
            if isinstance(content.get(section), dict)
            else {name: value for name, value in content.items() if name not in other}
        )
    return build(config_type, values, origin=str(path))


def _section(block: dict[str, Any], section: str) -> dict[str, Any]:
    """Return the parameters of a part, written below its name or with dotted names."""
    prefix = f"{section}."
    dotted = {name.removeprefix(prefix): value for name, value in block.items() if name.startswith(prefix)}
    nested = block.get(section)
    return {**(nested if isinstance(nested, dict) else {}), **dotted}


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
