"""Configuration of a source: its sections and the settings of `--set`."""

from __future__ import annotations

from typing import Any

import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_settings import changed_sections


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sync", 3),
        ("truth", "gt.csv"),
        ("topics", 3),
        ("conditions.x", 1),
        ("conditions", "distance=5"),
        ("limits", ["limits.yaml"]),
    ],
)
def test_a_setting_that_does_not_fit_its_section_is_refused(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"^setting '{key}' is "):
        changed_sections({"conditions": ["time=1"]}, {key: value})


def test_settings_of_sections_replace_them() -> None:
    settings: dict[str, Any] = {"conditions": ["distance=5"], "limits": "l.yaml", "sync": {"stamps": "record"}}
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
