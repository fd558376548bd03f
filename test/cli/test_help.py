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
PYTHON_TYPES = ("<bool>", "<path>", "<str>", "<int>", "<float>", " range>", "list[", "TEXT", "INTEGER", "FLOAT", "PATH")


UNITS = {"S", "MINUTES", "HZ", "MB", "PX", "FRAMES", "FROM_M TO_M", "M", "N", "R", "P"}
"""Of numbers: seconds, ..., a count, a ratio, a port."""


def commands(group: Any = ROOT, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(commands())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_no_python_types(sfr: Sfr, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    result = sfr(*name.split(), "--help")
    assert result.code == 0
    assert not [word for word in PYTHON_TYPES if word in result.out]
    assert "Examples:" in result.out


@pytest.mark.parametrize("name", COMMANDS)
def test_options_with_numbers_name_their_unit(name: str) -> None:
    for option in COMMANDS[name].params:
        default = getattr(option, "default", None)
        if isinstance(default, (int, float, tuple)) and not isinstance(default, bool):
            assert option.metavar in UNITS, option.opts


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
    [
        ("sfr sco", "score"),
        ("sfr score --cond", "--condition"),
        ("sfr score a b --condition dis", "distance="),
        ("sfr perturb a b --fault tor", "torn"),
        ("sfr localise a --method sf", "sfr"),
        ("sfr map a --method sg", "sgbm"),
        ("sfr replay a --start tr", "truth"),
        ("sfr run map", "mapping"),
    ],
)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_commands_options_and_values(
    sfr: Sfr, monkeypatch: pytest.MonkeyPatch, words: str, found: str, shell: str
) -> None:
    monkeypatch.setenv("_SFR_COMPLETE", f"complete_{shell}")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", words)
    monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
    assert found in re.findall(r"[\w=-]+", sfr().out)


def test_every_command_has_a_next_step_that_exists() -> None:
    own = {
        "init",
        "localise",
        "map",
        "convert",
        "score",
        "simulate",
        "perturb",
        "record",
    }  # by the paths they were given
    hints = {name: command.callback.hint for name, command in COMMANDS.items() if name not in own}
    assert all(hints.values()), hints
    for line in hints.values():
        program, *words = line.split()
        assert program == "sfr"
        assert words[0] in COMMANDS or " ".join(words[:2]) in COMMANDS, line
