"""The help names what a user gives, and each command has examples that it would take."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from cli_result import Sfr

from sfr_loc_map.cli.main import app

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
        with COMMANDS[name].make_context(name, words[len(name.split()) :]):
            pass


@pytest.mark.parametrize(
    ("words", "found"),
    [("sfr sco", "score"), ("sfr score --cond", "--condition"), ("sfr replay a --start tr", "truth")],
)
def test_the_shell_completes_commands_options_and_choices(
    sfr: Sfr, monkeypatch: pytest.MonkeyPatch, words: str, found: str
) -> None:
    monkeypatch.setenv("_SFR_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    assert found in re.findall(r"[\w=-]+", sfr().out)


def test_every_command_has_a_next_step_that_exists() -> None:
    own = {"init", "localise", "map", "convert", "score", "simulate", "perturb", "record"}  # by their paths
    for name, command in COMMANDS.items():
        program, *words = (command.callback.hint or "sfr doctor" * (name in own)).split()
        assert program == "sfr", name
        assert words[0] in COMMANDS or " ".join(words[:2]) in COMMANDS, name
