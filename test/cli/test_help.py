"""The help names what a user gives, and each command has examples that it would take."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import shellingham
import typer
from cli_result import Sfr

from sfr_loc_map.cli.main import app
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.simulation.faults import KINDS

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


def test_options_of_the_field_have_names_defaults_and_kinds(sfr: Sfr, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    score = sfr("score", "--help").out
    assert "distance=M|time=S|frames=N" in score
    (default,) = TrajectoryScoreConfig().conditions
    assert f"(distance={float(default.removeprefix('distance=')):g})" in score
    perturb = sfr("perturb", "--help").out
    assert not [kind for kind in KINDS if kind not in perturb]


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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_of_the_shell_that_runs_it_is_shown(
    sfr: Sfr, monkeypatch: pytest.MonkeyPatch, shell: str
) -> None:
    monkeypatch.setattr(shellingham, "detect_shell", lambda *_: (shell, f"/bin/{shell}"))
    result = sfr("--show-completion")
    assert result.code == 0
    assert f"_SFR_COMPLETE=complete_{shell}" in result.out
