"""Configuration of a source: its sections and the settings of `--set`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.source_config import (
    DEFAULT_SOURCE,
    SourceConfig,
    config_beside,
    source_config,
    with_settings,
    with_truth_settings,
)
from sfr_loc_map.localisation.config import LocalisationConfig

FOR_TIME = Configuration(None, {"conditions": ["time=1"]})


def of(sections: Mapping[str, Any], path: Path | None = None) -> SourceConfig:
    return SourceConfig.of(Configuration(path, sections))


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
        with_settings(FOR_TIME, {key: value})


def test_an_orientation_of_the_head_that_is_not_a_rotation_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"frames: head_to_navsb_quat_xyzw: .* is not a rotation"):
        of({"frames": {"head_to_navsb_quat_xyzw": [0.5, 0.0, 0.0, 0.0]}})


def test_settings_of_sections_add_them() -> None:
    settings: dict[str, Any] = {"conditions": ["distance=5"], "limits": "/l.yaml", "sync": {"stamps": "record"}}
    assert with_settings(FOR_TIME, settings).sections == settings


@pytest.mark.parametrize("other", ["/zed/left", "zed/left"])
def test_one_topic_under_two_names_is_refused(other: str) -> None:
    topics = {"loc/left/image_rect": "/zed/left", "nav/left/image_rect": other}
    with pytest.raises(ConfigError, match=r"topics\.loc/left/image_rect and topics\.nav/left/image_rect are both"):
        of({"topics": topics})


def test_a_remapped_topic_loses_its_former_name() -> None:
    sections = {"topics": {"loc/left/image_rect": "/zed/left", "loc/right/image_rect": "/zed/right"}}
    changed = with_settings(Configuration(None, sections), {}, remap={"/zed/left": "nav/left/image_rect"})
    assert changed.sections["topics"] == {"loc/right/image_rect": "/zed/right", "nav/left/image_rect": "/zed/left"}
    assert SourceConfig.of(changed).topics == {"nav/left/image_rect": "/zed/left", "loc/right/image_rect": "/zed/right"}


@pytest.mark.parametrize("given_name", ["loc/left/image_raw", "/loc/left/image_raw"])
@pytest.mark.parametrize("new_name", ["loc/left/image_raw", "/loc/left/image_raw"])
@pytest.mark.parametrize("is_remapped", [True, False])
def test_a_slash_before_a_name_of_the_suite_makes_no_second_name(
    tmp_path: Path, given_name: str, new_name: str, is_remapped: bool
) -> None:
    (tmp_path / "sfr.yaml").write_text(f"topics: {{{given_name}: /old}}\n")
    given = Configuration.read(tmp_path / "sfr.yaml")
    remap, settings = ({"/new": new_name}, {}) if is_remapped else (None, {f"topics.{new_name}": "/new"})
    assert SourceConfig.of(with_settings(given, settings, remap=remap)).topics == {"loc/left/image_raw": "/new"}


def test_two_topics_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sfr.yaml").write_text("topics: {/loc/left/image_raw: /old, loc/left/image_raw: /new}\n")
    with pytest.raises(ConfigError, match=r"'topics.loc/left/image_raw' is given twice"):
        Configuration.read(tmp_path / "sfr.yaml")
    with pytest.raises(ConfigError, match=r"'topics.loc/left/image_raw' is given twice"):
        of({"topics": {"/loc/left/image_raw": "/old", "loc/left/image_raw": "/new"}})


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
    config = of(sections, data / "sfr.yaml")
    assert config.truth.source == str(data / "gt.csv")
    assert config.truth.file is None
    assert config.calibration.file == str(data / "cal.yaml")
    (data / "gt.csv").write_text("t x y z\n")
    assert of(sections, data / "sfr.yaml").truth.file == data / "gt.csv"


@pytest.mark.parametrize("is_section", [False, True])
def test_files_of_settings_are_relative_to_the_working_directory(data: Path, is_section: bool) -> None:
    (data / "gt.csv").write_text("t x y z\n")
    settings: dict[str, Any] = {"truth.source": "gt.csv", "calibration.file": "cal.yaml", "limits": "limits.yaml"}
    if is_section:
        settings = {"truth": {"source": "gt.csv"}, "calibration": {"file": "cal.yaml"}, "limits": "limits.yaml"}
    changed = with_settings(Configuration(data / "sfr.yaml"), settings)
    config = SourceConfig.of(changed)
    assert config.truth.file == Path("gt.csv").resolve()
    assert config.calibration.file == str(Path("cal.yaml").resolve())
    assert changed.sections["limits"] == str(Path("limits.yaml").resolve())
    of_score = with_truth_settings(data / "e.csv", DEFAULT_SOURCE, {"truth.source": "gt.csv"}, "")
    assert of_score.truth.file == Path("gt.csv").resolve()


def test_a_bag_as_truth_is_not_a_topic(data: Path) -> None:
    """The path of a folder has the form of the name of a topic."""
    (data / "station").mkdir()
    (data / "station" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    config = of({"truth": {"source": "station"}}, data / "sfr.yaml")
    assert config.truth.file == data / "station"
    assert config.topics == {}
    for topic in ("/station", "station/pose"):
        assert of({"truth": {"source": topic}}, data / "sfr.yaml").truth.source == topic


def test_the_parameters_are_those_of_the_time_when_the_file_was_read(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(data)
    Path("q.yaml").write_text("localisation: {max_features: 300}\n")
    config = source_config(data, Path("q.yaml"))
    Path("q.yaml").unlink()
    monkeypatch.chdir(data.parent)
    assert config.configuration.build(LocalisationConfig, "localisation").max_features == 300


@pytest.mark.parametrize(
    "settings",
    [
        {"localisation.motion.max_speed_m_s": 2.0},
        {"localisation.motion": {"max_speed_m_s": 2.0}},
        {"localisation": {"motion": {"max_speed_m_s": 2.0}}},
        {"localisation": {"motion.max_speed_m_s": 2.0, "motion": {}}},
        {"localisation": {}, "localisation.motion": {"max_speed_m_s": 2.0}},
    ],
)
def test_a_setting_replaces_the_value_of_a_file_however_it_is_nested(settings: dict[str, Any]) -> None:
    given = Configuration(None, {"localisation": {"motion.max_speed_m_s": 1.0, "max_features": 300}})
    found = with_settings(given, settings).build(LocalisationConfig, "localisation")
    assert (found.motion.max_speed_m_s, found.max_features) == (2.0, 300)


@pytest.mark.parametrize(
    "settings", [{"extrinsics.translation_m": [1, 2, 3]}, {"T_rb_locsb": {"translation_m": [1, 2, 3]}}]
)
def test_a_mapping_keeps_the_other_values_of_its_section(settings: dict[str, Any]) -> None:
    given = Configuration(None, {"extrinsics": {"translation_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1]}})
    changed = with_settings(given, settings)
    assert changed.sections == {"extrinsics": {"translation_m": [1, 2, 3], "quat_xyzw": [0, 0, 0, 1]}}


def test_a_value_that_one_setting_contains_twice_is_refused() -> None:
    settings = {"localisation": {"motion.max_speed_m_s": 1.0, "motion": {"max_speed_m_s": 2.0}}}
    with pytest.raises(ConfigError, match=r"^setting 'localisation': '.*max_speed_m_s' is given twice"):
        with_settings(Configuration(), settings)


def test_two_settings_of_one_key_are_refused_however_they_are_nested(tmp_path: Path) -> None:
    for settings in ({"sync.stamps": "header", "sync": {"stamps": "record"}}, {"sync": {"stamps": "header"}}):
        calibration = None if len(settings) > 1 else tmp_path / "a.yaml"
        other = {"calibration": {"file": "b.yaml"}} if len(settings) == 1 else {}
        with pytest.raises(ConfigError, match="but another is "):
            with_settings(Configuration(), settings | other, calibration)


@pytest.mark.parametrize("section", ["extrinsics", "T_rb_locsb"])
def test_a_setting_has_either_name_of_the_extrinsics_and_not_both(section: str) -> None:
    quat = [0.0, 0.0, 0.0, 1.0]
    changed = with_settings(Configuration(), {f"{section}.quat_xyzw": quat})
    assert changed.sections == {"extrinsics": {"quat_xyzw": quat}}
    other = {"extrinsics": "T_rb_locsb", "T_rb_locsb": "extrinsics"}[section]
    with pytest.raises(ConfigError, match="'T_rb_locsb' and 'extrinsics' are names of one section"):
        with_settings(Configuration(), {f"{section}.quat_xyzw": quat, f"{other}.quat_xyzw": quat})


@pytest.mark.parametrize(
    ("section", "translation", "rotation"),
    [("extrinsics", "translation_m", "quat_xyzw"), ("frames", "head_to_navsb_m", "head_to_navsb_quat_xyzw")],
)
def test_a_translation_without_a_rotation_is_refused(section: str, translation: str, rotation: str) -> None:
    with pytest.raises(ConfigError, match=f"^a/sfr.yaml, {section}: {translation} is given but {rotation} is not"):
        of({section: {translation: [1.0, 0.0, 0.0]}}, Path("a/sfr.yaml"))
    assert of({section: {rotation: [0.0, 0.0, 0.0, 1.0]}})


@pytest.mark.parametrize("name", ["sigma_m", "sync.stamps", "localisation.max_features", "truht.sigma_m"])
def test_a_truth_has_only_settings_of_its_section(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=f"^setting '{name}': only settings of the truth apply"):
        with_truth_settings(tmp_path / "t.csv", DEFAULT_SOURCE, {name: 1}, "")


@pytest.mark.parametrize("name", ["sigma", "sigma_m.x"])
def test_an_unknown_setting_of_a_truth_is_named_as_in_its_section(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=f"^settings, truth: unknown key '{name}' .did you mean 'sigma_m'"):
        with_truth_settings(tmp_path / "t.csv", DEFAULT_SOURCE, {f"truth.{name}": 1}, "")


@pytest.mark.parametrize(
    ("cwd", "source", "found"),
    [
        ("par/d", ".", "par"),
        ("par/d", "./", "par"),
        ("par/d", "../d", "par"),
        ("par/d/sub", "..", "par"),
        ("par/d/sub", "../.", "par"),
        ("par/d/sub", "../../d", "par"),
        ("par/d", "sub", "par/d"),
        ("par/d", "sub/..", "par"),
        ("par/link", ".", "par"),
        ("par", "link", "par"),
        (".", "par/link/..", "."),
    ],
)
def test_the_folder_of_a_source_does_not_depend_on_how_its_path_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cwd: str, source: str, found: str
) -> None:
    (tmp_path / "par" / "d" / "sub").mkdir(parents=True)
    (tmp_path / "par" / "link").symlink_to("d")
    (tmp_path / found / "sfr.yaml").write_text("")
    monkeypatch.chdir(tmp_path / cwd)
    beside = config_beside(Path(source))
    assert beside is not None
    assert beside.resolve() == tmp_path / found / "sfr.yaml"


@pytest.mark.parametrize(("cwd", "source"), [("par/d", "."), ("par/d/sub", "..")])
def test_a_file_of_the_working_directory_below_a_source_is_not_that_of_the_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cwd: str, source: str
) -> None:
    (tmp_path / "par" / "d" / "sub").mkdir(parents=True)
    for folder in ("par", "par/d/sub"):
        (tmp_path / folder / "sfr.yaml").write_text("")
    monkeypatch.chdir(tmp_path / cwd)
    beside = config_beside(Path(source))
    assert beside is not None
    assert beside.resolve() == tmp_path / "par" / "sfr.yaml"


def test_a_wrong_value_of_an_option_is_not_attributed_to_the_file_alone(data: Path) -> None:
    given = Configuration(data / "sfr.yaml", {"sync": {"stamp_tolerance_s": 0.1}})
    with pytest.raises(ConfigError, match=r"sfr\.yaml and the options, sync: 'stamp_tolerance_s' is -1\.0: 0\.0 to"):
        SourceConfig.of(with_settings(given, {"sync.stamp_tolerance_s": -1.0}))
    assert with_settings(given, {"sync.stamp_tolerance_s": 0.1}).origin == str(data / "sfr.yaml")


@pytest.mark.parametrize("value", [False, 5, "Record", ["record"]])
def test_a_wrong_choice_lists_the_choices_for_values_of_all_types(value: object) -> None:
    with pytest.raises(ConfigError, match=r"'stamps' is .*: one of header, record is required"):
        of({"sync": {"stamps": value}})
