"""The configuration of a source: the `sfr.yaml` beside it, and changes by the options of a command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.parameters import flatten, is_empty, suggestion
from sfr_loc_map.configuration.sections import SECTIONS, Configuration, Key, check_form, check_one_name
from sfr_loc_map.errors import ConfigError, SfrError, naming_key
from sfr_loc_map.inputs import parent_of
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig, file_in, file_or_topic
from sfr_loc_map.io.source_format import is_bag

NAME = "sfr.yaml"
_REMAP_FORM = "{FOUND: EXPECTED}"  #: Form of a remapping in messages.
FILE_SETTINGS: Mapping[Key, Callable[[str, Path], str]] = {
    Key("calibration", "file"): file_in,
    Key("truth", "source"): file_or_topic,
    Key("limits"): file_in,
}
"""The settings that name files. Each has the function `(name, folder)` that makes the name an absolute path."""


def config_beside(source: Path) -> Path | None:
    """Return the `sfr.yaml` in the folder of a source or in its parent folder.

    None if there is no such file, or if the source is not a bag and the file belongs to a bag beside it.
    """
    folders = (source, parent_of(source)) if source.is_dir() else (parent_of(source),)
    found = next((folder / NAME for folder in folders if (folder / NAME).is_file()), None)
    if found is not None and found.parent != source and not is_bag(source) and _is_of_bag(found):
        return None  # the file belongs to a bag beside the source
    return found


def _is_of_bag(path: Path) -> bool:
    """Return whether a configuration names topics, which only bags have."""
    try:
        config = SourceConfig.of(Configuration.read(path))
    except SfrError:
        return False  # reported when the configuration is read
    return bool(config.topics) or bool(config.truth.topic)


def with_settings(
    given: Configuration,
    values: Mapping[str, Any],
    calibration: Path | None = None,
    remap: Mapping[str, str] | None = None,
) -> Configuration:
    """Return a configuration with changed values, whose names are `SECTION.KEY` or `SECTION`.

    A mapping changes the values that it contains, and keeps the other values of its section or group. `remap` is
    applied before the settings.

    File names in `values` and `calibration` are relative to the working directory. ConfigError if a section is unknown,
    if a value does not have the form of its section, or if two settings give a key different values.
    """
    sections = copied(given.sections)
    if remap:
        sections["topics"] = _renamed_topics(given.section("topics"), remap)
    settings = [*values.items()]
    if calibration is not None:
        settings.append(("calibration.file", str(calibration)))
    check_one_name(values, "settings")
    given_before: dict[Key, object] = {}
    for name, value in settings:
        with naming_key(f"setting '{name}'"):
            flat = flatten({name: value}, keeps_empty=True)
        for dotted, item in flat.items():
            key = Key.parse(dotted)
            if key.section not in SECTIONS:
                raise ConfigError(f"setting '{dotted}': no section '{key.section}'{suggestion(key.section, SECTIONS)}")
            check_form(key, item, f"setting '{dotted}'")
            before = given_before.setdefault(key, item)
            if before != item:
                raise ConfigError(f"setting '{dotted}' is {item!r:.40}, but another is {before!r:.40}: omit one")
            if key.name or not is_empty(item):
                key.put(_in_working_directory(key, item), sections)
    return replace(given, sections=sections, is_changed=given.is_changed or sections != given.sections)


def copied(sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of sections whose mappings can be changed."""
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in sections.items()}


def _renamed_topics(topics: Mapping[str, Any], remap: Mapping[str, str]) -> dict[str, Any]:
    """Return the section `topics` after the changes of `remap`.

    `topics` maps names in the suite to topics of the bag, and `remap` maps topics of the bag to names in the suite.
    A topic that is remapped, or a name that is given to another topic, loses its entry. ConfigError if `remap` does not
    map names of topics, or gives one name to several topics.
    """
    by_name: dict[str, str] = {}
    for topic, name in remap.items():
        if not isinstance(topic, str) or not isinstance(name, str):
            raise ConfigError(
                f"remap gives {topic!r:.40} the name {name!r:.40}: names of topics are required, {_REMAP_FORM}"
            )
        other = by_name.setdefault(name.strip("/"), topic)
        if other != topic:
            raise ConfigError(
                f"remap gives the name '{name}' to two topics, '{other}' and '{topic}': give it to one, {_REMAP_FORM}"
            )
    remapped = {topic.strip("/") for topic in remap}
    kept = {name: topic for name, topic in topics.items() if str(topic).strip("/") not in remapped}
    return kept | by_name


def _in_working_directory(key: Key, value: Any) -> Any:  # noqa: ANN401 - any value of a setting
    """Return the value of a setting with the absolute paths of the files that it names (`FILE_SETTINGS`)."""
    path_of = FILE_SETTINGS.get(key)
    return value if path_of is None or not isinstance(value, str) else path_of(value, Path())


def check_remap(source: Path, remap: Mapping[str, str]) -> None:
    """Raise ConfigError if `remap` is not a mapping, or if topics of a source without topics are remapped."""
    if not isinstance(remap, Mapping):
        raise ConfigError(f"remap has the type {type(remap).__name__}: names of topics are required, {_REMAP_FORM}")
    if remap and source.exists() and not is_bag(source):
        raise ConfigError(f"remap applies only to topics of a bag, but '{source}' is not a bag: omit it")


def source_config(source: Path, path: Path | None = None, remap: Mapping[str, str] | None = None) -> SourceConfig:
    """Return the configuration in a file, by default the `sfr.yaml` beside the source; `remap` overrides topics."""
    if remap is not None:
        check_remap(source, remap)
    path = path or config_beside(source)
    if path is None and not remap:
        return DEFAULT_SOURCE
    return SourceConfig.of(with_settings(Configuration.read(path), {}, remap=remap))


def truth_config(truth: Path, config: SourceConfig, settings: Mapping[str, Any], columns: str) -> SourceConfig:
    """Return a configuration of a truth that is changed by settings `truth.KEY` and by the columns of a table.

    ConfigError for a setting of another section.
    """
    for name in settings:
        if Key.parse(name).section != "truth":
            raise ConfigError(f"setting '{name}': only settings of the truth apply here: give truth.KEY=VALUE")
    values = dict(settings)
    if columns:
        values["truth.columns"] = columns
    if not truth.is_dir() and not is_bag(truth):
        values = {"truth.source": ""} | values  # the truth itself is the file
    return SourceConfig.of(with_settings(config.configuration, values)) if values else config
