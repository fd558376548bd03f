"""The first steps of a user: files to start from, and the proposed next command."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import broken_sources as broken
from helpers.cli_result import Sfr
from helpers.made_scores import whole_score
from sfr_loc_map.configuration.parameters import parameters
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.judging.limits_file import load_limits
from sfr_loc_map.metrics.score.limits import LIMITED_NUMBERS
from sfr_loc_map.metrics.stored.score_json import to_json

TUM = "".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(60))


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
    assert Configuration.read(configuration).build(LocalisationConfig, "localisation") == LocalisationConfig()
    assert Configuration.read(configuration).build(MappingConfig, "mapping") == MappingConfig()
    text = configuration.read_text()
    for info in (*parameters(LocalisationConfig), *parameters(MappingConfig)):
        assert f"# {info.doc}" in text, info.name
        assert info.low is None or f"({info.low:g} .. {info.high:g})" in text, info.name
    expected = (
        f"next: sfr replay SRC --start truth --config {configuration} --limits {folder / 'limits.yaml'} --out out/"
    )
    assert result.err.splitlines()[-1].startswith(expected)


def test_info_does_not_overwrite_a_ros_parameter_file(sfr: Sfr, tmp_path: Path) -> None:
    text = "other_node:\n  ros__parameters: {gain: 3.0}\n"
    (parameters_file := tmp_path / "params.yaml").write_text(text)
    result = sfr("info", broken.good_folder(tmp_path / "data"), "--config", parameters_file, "--write")
    assert result.code == 2
    assert "sfr init DIR --from" in result.err
    assert parameters_file.read_text() == text


def test_limits_of_init_are_taken_and_name_every_figure(sfr: Sfr, tmp_path: Path, trajectory: Path) -> None:
    sfr("init", tmp_path)
    limits = tmp_path / "limits.yaml"
    assert {item.name for item in load_limits(limits).limits} <= set(LIMITED_NUMBERS[LimitSection.TRAJECTORY])
    whole = limits.read_text()
    assert not [name for names in LIMITED_NUMBERS.values() for name in names if f"{name}: " not in whole]
    measured = "".join(f"{k} {1.0001 * k:.4f} 0 0 0 0 0 1\n" for k in range(60))
    (estimate := tmp_path / "e.tum").write_text(measured)
    result = sfr("score", estimate, trajectory, "--limits", limits)
    assert result.code == 0
    assert "verdict: pass. 3 of 3 limits met, 0 missed, 0 without enough data." in result.out
    limits.write_text(re.sub(r"(?m)^# (  \w+: .*|\w+:)$", r"\1", whole))
    assert {item.section for item in load_limits(limits).limits} == set(LIMITED_NUMBERS)


@pytest.mark.parametrize("edit", [(": 0.1", ": 0.0777"), ("condition: ", "condition: time=60,")])
@pytest.mark.parametrize("has_source", [False, True])
def test_init_keeps_edited_limits_and_replaces_placeholders(
    sfr: Sfr, tmp_path: Path, edit: tuple[str, str], has_source: bool
) -> None:
    source = ["--from", broken.good_folder(tmp_path / "data")] if has_source else []
    folder = tmp_path / "rover"
    limits = folder / "limits.yaml"
    sfr("init", folder, *source)
    written = limits.read_text()
    sfr("init", folder, *source, "--overwrite")
    assert limits.read_text() == written
    edited = written.replace(*edit, 1)
    for text in (edited, edited.rsplit("\n", 2)[0]):
        limits.write_text(text)
        assert f"{limits} (the existing file is kept)" in sfr("init", folder, *source, "--overwrite").out
        assert limits.read_text() == text
    limits.unlink()
    limits.mkdir()
    assert f"cannot write '{limits}': it is a folder" in sfr("init", folder, *source, "--overwrite").err


@pytest.mark.parametrize("name", ["sfr.yaml", ""])
def test_init_requires_the_name_of_a_folder(
    sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert sfr("init", name).code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("conditions=[distance=-5]", "settings, conditions: "),
        ("mapping.foo=2", "settings, mapping: unknown key 'foo'"),
        ("localisation.max_features=-4", "settings, localisation: 'max_features' is -4"),
        ("limits=nofile.yaml", "nofile.yaml': No such file"),
        ("frames.bas=3", "settings, frames: unknown key 'bas'"),
    ],
)
def test_init_and_info_refuse_settings_that_other_commands_refuse(
    sfr: Sfr, tmp_path: Path, setting: str, words: str
) -> None:
    source = broken.good_folder(tmp_path / "data")
    for command in (("init", tmp_path / "rover", "--from", source), ("info", source)):
        result = sfr(*command, "--set", setting)
        assert result.code == 2
        assert words in result.err
    assert not (tmp_path / "rover").exists()


def test_a_missing_truth_may_be_a_file_of_poses(sfr: Sfr, trajectory: Path) -> None:
    assert "give a file of poses" in sfr("score", trajectory, trajectory.with_name("nope")).err


@pytest.mark.parametrize(
    ("setting", "make"),
    [("truth.source", broken.good_bag), ("truth.source", broken.good_folder), ("calibration.file", broken.good_bag)],
)
def test_an_invalid_truth_or_calibration_is_a_blocking_issue_beside_the_facts(
    sfr: Sfr, tmp_path: Path, setting: str, make: Callable[[Path], Path]
) -> None:
    (wrong := tmp_path / "wrong.csv").write_text("a,b\n1,2\n")
    result = sfr("info", make(tmp_path / "x.mcap"), "--set", f"{setting}={wrong}")
    assert result.code == 1
    assert "cannot be read" in result.out
    assert "BLOCKING" in result.out


def test_the_fix_of_a_wrong_frame_of_the_rover_names_its_setting(sfr: Sfr, tmp_path: Path) -> None:
    result = sfr("info", broken.good_bag(tmp_path / "x.mcap"), "--set", "frames.base=nope")
    assert result.code == 1
    assert re.search(r"fix: set extrinsics\.translation_m .* or\s+correct frames\.base", result.out)
    assert "T_rb_locsb.translation_m" not in result.out


def test_the_next_step_repeats_the_options_that_were_given(hints: Sfr, trajectory: Path) -> None:
    given = ("score", trajectory, trajectory, "--condition", "frames=3")
    steps = [hints(*given).err.splitlines()[-1].partition("    #")[0]]
    steps.append(hints(*given, "--limits", trajectory.with_name("none.yaml")).err)
    assert steps[0] == f"next: sfr {' '.join(map(str, given))} --limits limits.yaml --html report.html"
    assert "next:" not in steps[1]
    again = hints(*given, "--json", trajectory.with_name("s.json")).err.splitlines()[-1]
    assert "--overwrite --limits limits.yaml" in again  # the file exists now


def test_no_next_step_is_printed_beside_json(hints: Sfr, tmp_path: Path) -> None:
    (score := tmp_path / "score.json").write_text(to_json(whole_score()))
    report = ("report", score, "-o", tmp_path / "page.html")
    assert hints(*report).err.splitlines()[-1].startswith("next: open ")
    assert "next:" not in hints(*report, "--overwrite", "--json", "-").err


def test_the_next_step_of_a_recording_with_true_attitudes_starts_at_the_truth(hints: Sfr, tmp_path: Path) -> None:
    for source in (broken.good_bag(tmp_path / "x.mcap"), broken.good_folder(tmp_path / "drive")):
        assert f"next: sfr replay {source} --start truth --out out" in hints("info", source).err
