"""The help names the values that a user gives, and the command accepts its own examples."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import typer

from helpers.cli_result import Sfr
from sfr_loc_map.cli import options
from sfr_loc_map.cli.main import app
from sfr_loc_map.cli.options import refuse_given
from sfr_loc_map.cli.simulate import FAULT_KINDS
from sfr_loc_map.faults.kinds import FaultKind

ROOT: Any = typer.main.get_command(app)


def commands(group: Any = ROOT, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(commands())


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_taken_by_the_command(name: str) -> None:
    first, *lines = COMMANDS[name].epilog.split("\n\n")
    assert first == "Examples:"
    assert lines
    for line in lines:
        sfr, *words = shlex.split(line)
        assert (sfr, " ".join(words[: len(name.split())])) == ("sfr", name)
        with COMMANDS[name].make_context(name, words[len(name.split()) :], help_option_names=["-h", "--help"]):
            pass


def test_only_options_of_the_command_can_be_refused() -> None:
    words = ["SRC", "-o", "c.ply"]
    with COMMANDS["map"].make_context("map", words) as context, pytest.raises(AssertionError, match="refine_pose"):
        refuse_given(context, ("refine_pose",), "has no effect")


def words_of(option: Any) -> list[str]:
    """Return an option with a value that its type accepts."""
    flag = max(option.opts, key=len)
    if option.is_flag:
        return [flag]
    annotation = option.type_descriptor.annotation
    choices = [value for value in get_args(annotation) if isinstance(value, str)]
    value = "table.csv" if annotation is Path else choices[0] if choices else "1"
    return [flag, *option.nargs * [value]]


KINDS = {"poses.csv": (options.CLOUDS,), "cloud.ply": (options.TRAJECTORIES, options.ASSOCIATION, options.CONVENTION)}
OTHER_KIND = [
    (file, option.name, words_of(option))
    for file, panels in KINDS.items()
    for option in COMMANDS["score"].params
    if getattr(option, "rich_help_panel", None) in panels
]


@pytest.mark.parametrize(("file", "name", "words"), OTHER_KIND)
def test_an_option_of_the_other_kind_of_estimate_is_refused(
    sfr: Sfr, tmp_path: Path, file: str, name: str, words: list[str]
) -> None:
    """The panels of the help state which options apply to which kind of estimate."""
    result = sfr("score", tmp_path / file, tmp_path / "truth.csv", *words)
    assert result.code == 2
    assert f"'{words[0]}' applies only to " in result.err


@pytest.mark.parametrize(("name", "rare"), [("replay", "--external"), ("score", "--target")])
def test_the_usual_options_come_before_the_rare_ones(name: str, rare: str, sfr: Sfr) -> None:
    text = sfr(name, "-h").out
    usual = text.partition("─ Options ─")[2].partition("╰──")[0]
    assert "--limits" in usual
    assert rare in text
    assert rare not in usual


def test_the_help_needs_no_numpy() -> None:
    code = "import sys; sys.modules['numpy'] = None; import sfr_loc_map.cli.main"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_help_lists_every_kind_of_fault() -> None:
    assert [*FaultKind] == FAULT_KINDS
