"""What helps in the first hour: files to begin with and the next step."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cli_result import Sfr

from sfr_loc_map.config import parameters, read_config
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.limits import NAMES, load_limits

TUM = "".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(40))


@pytest.fixture
def trajectory(tmp_path: Path) -> Path:
    path = tmp_path / "t.tum"
    path.write_text(TUM)
    return path


@pytest.fixture
def hints(monkeypatch: pytest.MonkeyPatch, sfr: Sfr) -> Sfr:
    monkeypatch.delenv("SFR_HINTS")
    return sfr


def test_init_writes_every_parameter_at_its_default(hints: Sfr, tmp_path: Path) -> None:
    folder = tmp_path / "rover"
    result = hints("init", folder)
    assert result.code == 0
    configuration = folder / "configuration.yaml"
    assert read_config(LocalisationConfig, configuration, "localisation") == LocalisationConfig()
    assert read_config(MappingConfig, configuration, "mapping") == MappingConfig()
    text = configuration.read_text()
    for info in (*parameters(LocalisationConfig), *parameters(MappingConfig)):
        assert f"# {info.doc}" in text, info.name
        assert info.low is None or f"({info.low:g} .. {info.high:g})" in text, info.name
    expected = (
        f"next: sfr replay SRC --start truth --config {configuration} --limits {folder / 'limits.yaml'} --out out/"
    )
    assert result.err.splitlines()[-1].startswith(expected)


def test_limits_of_init_are_taken_and_name_every_figure(sfr: Sfr, tmp_path: Path, trajectory: Path) -> None:
    sfr("init", tmp_path)
    limits = tmp_path / "limits.yaml"
    assert {item.key for item in load_limits(limits).limits} <= set(NAMES["trajectory"])
    whole = limits.read_text()
    assert not [name for names in NAMES.values() for name in names if f"{name}: " not in whole]
    result = sfr("score", trajectory, trajectory, "--limits", limits)
    assert result.code == 0
    assert "verdict: pass. 3 of 3 limits met, 0 missed, 0 without enough data." in result.out
    limits.write_text(re.sub(r"(?m)^# (  \w+: .*|\w+:)$", r"\1", whole))
    assert {item.part for item in load_limits(limits).limits} == set(NAMES)


def test_init_replaces_nothing_unless_told(sfr: Sfr, tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text("mine")
    refused = sfr("init", tmp_path)
    assert refused.code == 2
    assert "limits.yaml': a file is there" in refused.err
    assert not (tmp_path / "configuration.yaml").exists()
    assert sfr("init", tmp_path, "--overwrite").code == 0
    assert "PLACEHOLDERS" in (tmp_path / "limits.yaml").read_text()


def test_the_last_line_says_the_next_step(hints: Sfr, trajectory: Path) -> None:
    result = hints("score", trajectory, trajectory)
    assert result.err.splitlines()[-1].startswith("next: sfr init")
    assert "next:" not in result.out


@pytest.mark.parametrize(
    "arguments",
    [
        ("score", "{}", "{}", "--json", "-"),
        ("score", "{}", "missing.tum"),
        ("--no-hints", "score", "{}", "{}"),
        ("score", "--help"),
    ],
)
def test_programs_errors_and_helps_have_no_next_step(
    hints: Sfr, monkeypatch: pytest.MonkeyPatch, trajectory: Path, arguments: tuple[str, ...]
) -> None:
    monkeypatch.setenv("SFR_HINTS", "1")  # what the switch sets is taken back after the test
    result = hints(*(word.format(trajectory) for word in arguments))
    assert "next:" not in result.err + result.out


def test_a_missed_limit_has_its_next_step_behind_the_error(hints: Sfr, tmp_path: Path, trajectory: Path) -> None:
    moved = tmp_path / "moved.tum"
    moved.write_text(TUM.replace(" 0 0 0 0 0 1", " 0 0 0 0 0.6 0.8"))
    limits = tmp_path / "limits.yaml"
    limits.write_text("trajectory: [{condition: distance=5, position_mean_m: 1.0e-9}]")
    result = hints("score", moved, trajectory, "--limits", limits, "--lenient")
    assert result.code == 1
    error, last = result.err.splitlines()[-2:]
    assert error.startswith("sfr: 1 of 1 limits missed")
    assert last.startswith("next: sfr score ... --html")  # without its limits it would be another score
    json_path = tmp_path / "score.json"
    result = hints("score", moved, trajectory, "--limits", limits, "--lenient", "--json", json_path)
    assert f"next: sfr report {json_path} " in result.err.splitlines()[-1]
