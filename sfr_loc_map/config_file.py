"""The configuration file of all commands and nodes: the sections of an `sfr.yaml` or of a ROS parameter file.

A value of the file takes these steps:

1. `read_sections` reads the YAML, and returns the values by section and dotted name;
2. `io.source_settings` changes values by the options of a command (`--set`, `--remap`, `--calibration`);
3. `build` converts each section to its dataclass, with a check of every name, type and range. The sections `topics` to
   `truth` become an `io.source_config.SourceConfig`, and the others the parameters of localiser, mapper and monitor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from sfr_loc_map.config import MAPPING, build, flatten, is_empty, suggestion
from sfr_loc_map.config_nodes import NODE_SECTIONS, has_nodes, sections_of_nodes
from sfr_loc_map.config_yaml import load_yaml
from sfr_loc_map.errors import ConfigError, naming_key

C = TypeVar("C")

SECTIONS = (
    *("topics", "frames", "calibration", "extrinsics", "sync", "truth"),
    *("localisation", "mapping", "monitor", "conditions", "limits"),
)
"""Sections of `sfr.yaml`, the configuration file of all commands and nodes.

`topics` contains the name in the bag by name in the suite; `--remap FOUND:=EXPECTED` has the inverse order.
"""


def read_sections(path: Path) -> dict[str, Any]:
    """Return the values of a configuration file by section, as mappings of dotted names.

    The file is an `sfr.yaml` or a ROS parameter file (`/**: ros__parameters:` or `NODE: ros__parameters:`). Raises
    ConfigError.
    """
    flat = _read_flat(path)
    return sections_of_nodes(flat, path) if has_nodes(flat) else _sections_of_file(flat, path)


def is_ros_parameter_file(path: Path) -> bool:
    """Return whether a YAML file has the layout of ROS parameter files; raises ConfigError if it cannot be read."""
    return has_nodes(_read_flat(path))


def _read_flat(path: Path) -> dict[str, Any]:
    """Return the values of a YAML file by dotted name."""
    content = load_yaml(path)
    with naming_key(str(path)):
        return flatten(content, keeps_empty=True)


def _sections_of_file(flat: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the sections of an `sfr.yaml`; the section `extrinsics` may have the name of its node parameters."""
    alias = NODE_SECTIONS["extrinsics"].prefix
    if {alias, "extrinsics"} <= {key.partition(".")[0] for key in flat}:
        raise ConfigError(f"{path}: '{alias}' and 'extrinsics' are names of one section: give one of them")
    sections: dict[str, Any] = {}
    for key, value in flat.items():
        given, _, name = key.partition(".")
        section = "extrinsics" if given == alias else given
        if section not in SECTIONS:
            raise ConfigError(
                f"{path}: unknown section '{section}'{suggestion(section, SECTIONS)}: parameters belong to a section, "
                "such as localisation or mapping"
            )
        if not name and is_empty(value):
            continue
        check_form(section, name, value, f"{path}: '{key}'")
        if name:
            sections.setdefault(section, {})[name] = value
        else:
            sections[section] = value
    return sections


def check_form(section: str, name: str, value: object, where: str) -> None:
    """Raise ConfigError if a section does not have the form of a value: a file name, a list, or names with values.

    `name` is the name of the value in the section; empty for the value of the section itself. `where` begins the
    message.
    """
    if section == "limits":
        is_valid, required = not name and isinstance(value, str) and value != "", "a file name"
    elif section == "conditions":
        is_list = isinstance(value, list) and len(value) > 0 and all(isinstance(item, str) for item in value)
        is_valid, required = not name and is_list, "a list such as [distance=5]"
    else:
        is_valid, required = bool(name) or isinstance(value, Mapping), MAPPING
    if not is_valid:
        raise ConfigError(f"{where} is {value!r:.40}: {required} is required for '{section}'")


@dataclass(frozen=True, slots=True)
class Configuration:
    """The sections of a configuration file; without a file, there are no sections."""

    path: Path | None
    sections: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path | None) -> Configuration:
        """Read a file (`read_sections`)."""
        return cls(path, {} if path is None else read_sections(path))

    def section(self, name: str) -> Mapping[str, Any]:
        """Return the values of a section; empty if it is missing."""
        return self.sections.get(name) or {}

    def build(self, config_type: type[C], name: str) -> C:
        """Return the parameters of a section, such as `localisation`."""
        return build(config_type, self.section(name), origin=f"{self.path}, {name}")


def read_config(config_type: type[C], path: Path | None, part: str) -> C:
    """Read the parameters of a section, such as `localisation`, from a configuration file; None gives the defaults."""
    return Configuration.read(path).build(config_type, part)
