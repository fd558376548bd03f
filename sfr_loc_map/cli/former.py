"""Commands and arguments of version 0.2 that were removed: each prints what replaces it and exits with code 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from typer import Argument

from sfr_loc_map.errors import ConfigError

COMMANDS = {
    "sfr compare": "sfr report A.json B.json",
    "sfr plot": "sfr report T.csv --truth TRUTH -o paths.html",
    "sfr perturb": "sfr simulate DST --from SRC --fault KIND",
    "sfr history": "sfr suite history DIR...",
    "sfr methods": "sfr bench methods",
    "sfr monitor": "sfr run monitor",
    "sfr suite compare": "sfr report A B",
}
"""Former subcommands and what replaces each."""
FormerArgument = Annotated[list[Path] | None, Argument(hidden=True)]
"""Files that a command accepted in version 0.2."""


def check_command(name: str) -> None:
    """Raise ConfigError for a former subcommand, given as `sfr NAME`."""
    if name in COMMANDS:
        raise ConfigError(f"'{name}' was removed: use {COMMANDS[name]}")


def check_live(files: Sequence[Path] | None) -> None:
    """Raise ConfigError if `sfr live` is given a recording."""
    if files:
        raise ConfigError(
            f"'{files[0]}': sfr live accepts no recording, because it shows running nodes: use sfr replay SRC --live"
        )


def check_doctor(files: Sequence[Path] | None) -> None:
    """Raise ConfigError if `sfr doctor` is given a source, or an estimate and its truth."""
    if files:
        what = "sfr score EST TRUTH --diagnose" if len(files) > 1 else f"sfr info {files[0]}"
        raise ConfigError(
            f"'{files[0]}': sfr doctor accepts no file, because it examines the running graph: use {what}"
        )
