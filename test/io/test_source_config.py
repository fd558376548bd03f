"""Configuration of a source: its sections and the settings of `--set`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_settings import changed_sections, source_config, truth_config
from sfr_loc_map.localisation.config import LocalisationConfig


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sync", 3),
        ("truth", "gt.csv"),
        ("topics", 3),
        ("conditions.x", 1),
        ("conditions", "distance=5"),
        ("conditions", []),
        ("limits", ["limits.yaml"]),
        ("limits", ""),
    ],
)
def test_a_setting_that_does_not_fit_its_section_is_refused(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"^setting '{key}' is "):
        changed_sections({"conditions": ["time=1"]}, {key: value})


def test_an_orientation_of_the_head_that_is_not_a_rotation_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"frames: head_to_navsb_quat_xyzw: .* is not a rotation"):
        SourceConfig.of({"frames": {"head_to_navsb_quat_xyzw": [0.5, 0.0, 0.0, 0.0]}})


def test_settings_of_sections_replace_them() -> None:
    settings: dict[str, Any] = {"conditions": ["distance=5"], "limits": "/l.yaml", "sync": {"stamps": "record"}}
    assert changed_sections({"conditions": ["time=1"]}, settings) == settings


@pytest.mark.parametrize("other", ["/zed/left", "zed/left"])
def test_one_topic_under_two_names_is_refused(other: str) -> None:
    topics = {"loc/left/image_rect": "/zed/left", "nav/left/image_rect": other}
    with pytest.raises(ConfigError, match=r"topics\.loc/left/image_rect and topics\.nav/left/image_rect are both"):
        SourceConfig.of({"topics": topics})


def test_a_remapped_topic_loses_its_former_name() -> None:
    sections = {"topics": {"loc/left/image_rect": "/zed/left", "loc/right/image_rect": "/zed/right"}}
    changed = changed_sections(sections, {}, remap={"/zed/left": "nav/left/image_rect"})
    assert changed["topics"] == {"loc/right/image_rect": "/zed/right", "nav/left/image_rect": "/zed/left"}
    assert SourceConfig.of(changed).remap == {"/zed/left": "nav/left/image_rect", "/zed/right": "loc/right/image_rect"}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder for a configuration; the working directory is another folder and contains gt.csv."""
    (elsewhere := tmp_path / "elsewhere").mkdir()
    (elsewhere / "gt.csv").write_text("t x y z\n")
    monkeypatch.chdir(elsewhere)
    (tmp_path / "data").mkdir()
    return tmp_path / "data"


def test_a_file_of_a_configuration_is_not_taken_from_the_working_directory(data: Path) -> None:
    sections = {"truth": {"source": "gt.csv"}, "calibration": {"file": "cal.yaml"}}
    config = SourceConfig.of(sections, data / "sfr.yaml")
    assert config.truth.source == str(data / "gt.csv")
    assert config.truth.file is None
    assert config.calibration.file == str(data / "cal.yaml")
    (data / "gt.csv").write_text("t x y z\n")
    assert SourceConfig.of(sections, data / "sfr.yaml").truth.file == data / "gt.csv"


@pytest.mark.parametrize("is_section", [False, True])
def test_files_of_settings_are_relative_to_the_working_directory(data: Path, is_section: bool) -> None:
    (data / "gt.csv").write_text("t x y z\n")
    settings: dict[str, Any] = {"truth.source": "gt.csv", "calibration.file": "cal.yaml", "limits": "limits.yaml"}
    if is_section:
        settings = {"truth": {"source": "gt.csv"}, "calibration": {"file": "cal.yaml"}, "limits": "limits.yaml"}
    changed = changed_sections({}, settings)
    config = SourceConfig.of(changed, data / "sfr.yaml")
    assert config.truth.file == Path("gt.csv").resolve()
    assert config.calibration.file == str(Path("cal.yaml").resolve())
    assert changed["limits"] == str(Path("limits.yaml").resolve())
    of_score = truth_config(data / "e.csv", None, {"truth.source": "gt.csv"}, "")
    assert of_score is not None
    assert of_score.truth.file == Path("gt.csv").resolve()


def test_a_bag_as_truth_is_not_a_topic(data: Path) -> None:
    """The path of a folder has the form of the name of a topic."""
    (data / "station").mkdir()
    (data / "station" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    config = SourceConfig.of({"truth": {"source": "station"}}, data / "sfr.yaml")
    assert config.truth.file == data / "station"
    assert config.topics == {}
    for topic in ("/station", "station/pose"):
        assert SourceConfig.of({"truth": {"source": topic}}, data / "sfr.yaml").truth.source == topic


def test_the_parameters_are_those_of_the_time_when_the_file_was_read(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(data)
    Path("q.yaml").write_text("localisation: {max_features: 300}\n")
    config = source_config(data, Path("q.yaml"))
    Path("q.yaml").unlink()
    monkeypatch.chdir(data.parent)
    assert config.parameters(LocalisationConfig, "localisation").max_features == 300
