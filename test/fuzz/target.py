"""What one format is to the fuzzer."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mutations import Mutation

from sfr_loc_map.errors import SfrError

Command = tuple[str, ...]
Reader = Callable[[Path], None]
"""Takes the mutated file; may raise an `SfrError`."""


@dataclass(frozen=True)
class Target:
    """One format.

    Attributes:
        name: How it is called.
        place: The valid file within the world; the mutated one takes its place.
        mutations: What is done to it.
        uses: Commands (`{w}` is the world, `{o}` a folder for outputs) and readers; one is taken, by the content.
        readable: Whether the valid file is accepted; formats that are refused by name are fuzzed too.
    """

    name: str
    place: str
    mutations: tuple[Mutation, ...]
    uses: tuple[Command | Reader, ...]
    readable: bool = True


def run_command(command: Command, world: Path, out: Path) -> int:
    """Run a command of `sfr` in this process; return its exit code."""
    from sfr_loc_map.cli.main import main  # not needed by readers

    sys.argv = ["sfr", *(word.replace("{w}", str(world)).replace("{o}", str(out)) for word in command)]
    return main()


def expected_error(error: BaseException) -> bool:
    return isinstance(error, SfrError)
