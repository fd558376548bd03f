"""The configuration of all commands and nodes: the sections of an `sfr.yaml` or of a ROS parameter file.

A value of the file takes these steps:

1. `Configuration.read` reads the YAML, and returns the values by section and dotted name;
2. `io.source_config` overrides values with the options of a command (`--set`, `--remap`, `--calibration`);
3. `Configuration.build` converts a section to its dataclass, with a check of every name, type and range. The sections
   `topics` to `truth` become an `io.source_config.SourceConfig`, and the others the parameters of localiser, mapper and
   monitor.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sfr_loc_map.configuration.nodes import NODE_SECTIONS, has_nodes, sections_of_nodes
from sfr_loc_map.configuration.parameters import MAPPING, build, flatten, is_empty, parameters, suggestion
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, naming_key

C = TypeVar("C")

SECTIONS = (
    *("topics", "frames", "calibration", "extrinsics", "sync", "truth"),
    *("localisation", "mapping", "monitor", "conditions", "limits"),
)
"""Sections of `sfr.yaml`, the configuration file of all commands and nodes.

`topics` contains the name in the bag by name in the suite; `--remap FOUND:=EXPECTED` has the inverse order.
"""
TOPICS = "topics"  #: Section of the names of topics.
ALIAS, ALIASED = NODE_SECTIONS["extrinsics"].prefix, "extrinsics"
"""Second name of a section, which is that of its node parameters, and the name of the section."""


class Key(NamedTuple):
    """The place of a value: a name in a section, or a section whose value has no names, such as `limits`."""

    section: str
    name: str = ""  #: Name in the section; empty for the value of the section itself.

    @classmethod
    def parse(cls, text: str) -> Key:
        """Return the key of a text `SECTION.NAME` or `SECTION`; the section may be unknown.

        A slash at the beginning or end of a name in `topics` is removed, because names of the suite are relative.
        """
        section, _, name = text.partition(".")
        if section == TOPICS:
            name = name.strip("/")
        return cls(ALIASED if section == ALIAS else section, name)

    def __str__(self) -> str:
        return f"{self.section}.{self.name}" if self.name else self.section

    def value_in(self, sections: Mapping[str, Any]) -> Any:  # noqa: ANN401 - any value of a configuration
        """Return the value in sections; None if it is missing."""
        return sections.get(self.section, {}).get(self.name) if self.name else sections.get(self.section)

    def put(self, value: object, sections: dict[str, Any]) -> None:
        """Set the value in sections."""
        if self.name:
            sections.setdefault(self.section, {})[self.name] = value
        else:
            sections[self.section] = value


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
    check_one_name(flat, str(path))
    sections: dict[str, Any] = {}
    for name, value in flat.items():
        key = Key.parse(name)
        if key.section not in SECTIONS:
            raise ConfigError(
                f"{path}: unknown section '{key.section}'{suggestion(key.section, SECTIONS)}: parameters belong to a "
                "section, such as localisation or mapping"
            )
        if not key.name and is_empty(value):
            continue
        check_form(key, value, f"{path}: '{name}'")
        if key.value_in(sections) is not None:
            raise ConfigError(f"{path}: '{key}' is given twice: give it once")
        key.put(value, sections)
    return sections


def _check_others(others: Iterable[tuple[str, str]], path: Path) -> None:
    """Raise ConfigError if a parameter of a node has the name of a section, which is not a parameter of any node."""
    for node, parameter in others:
        section = parameter.partition(".")[0]
        if section in SECTIONS:
            advice = f"name it '{ALIAS}'" if section == ALIASED else "move it to an sfr.yaml"
            raise ConfigError(f"{path}: '{section}' of '{node}' is a section of sfr.yaml, not of a node: {advice}")


def check_one_name(names: Iterable[str], origin: str) -> None:
    """Raise ConfigError if names of values contain both names of the section `extrinsics`."""
    if {ALIAS, ALIASED} <= {name.partition(".")[0] for name in names}:
        raise ConfigError(f"{origin}: '{ALIAS}' and '{ALIASED}' are names of one section: give one of them")


def check_form(key: Key, value: object, where: str) -> None:
    """Raise ConfigError if a value does not have the form of its section: a file name, a list, or names with values.

    `where` begins the message.
    """
    if key.section == "limits":
        is_valid, required = not key.name and isinstance(value, str) and value != "", "a file name"
    elif key.section == "conditions":
        is_list = isinstance(value, list) and len(value) > 0 and all(isinstance(item, str) for item in value)
        is_valid, required = not key.name and is_list, "a list such as [distance=5]"
    else:
        is_valid, required = bool(key.name) or isinstance(value, Mapping), MAPPING
    if not is_valid:
        raise ConfigError(f"{where} is {value!r:.40}: {required} is required for '{key.section}'")


@dataclass(frozen=True, slots=True)
class Configuration:
    """The sections of a configuration file, possibly changed by the options of a command."""

    path: Path | None = None  #: The file; None if all values are those of options.
    sections: Mapping[str, Any] = field(default_factory=dict)
    """Values by section; a section is a mapping of dotted names, except `conditions` and `limits` (`check_form`)."""
    is_changed: bool = False  #: Whether options changed values of the file.
    #: Node, or `ALL_NODES`, and name of the parameters of a ROS parameter file that belong to no section.
    others: tuple[tuple[str, str], ...] = ()

    @classmethod
    def read(cls, path: Path | None) -> Configuration:
        """Read an `sfr.yaml` or a ROS parameter file (`/**: ros__parameters:` or `NODE: ros__parameters:`).

        None gives a configuration without values. Raises ConfigError.
        """
        if path is None:
            return cls()
        flat = _read_flat(path)
        if not has_nodes(flat):
            return cls(path, _sections_of_file(flat, path))
        sections, others = sections_of_nodes(flat, path)
        _check_others(others, path)
        return cls(path, sections, others=others)

    @property
    def origin(self) -> str:
        """The beginning of messages about the values: the file and the options that changed it, or only settings."""
        if self.path is None:
            return "settings"
        return f"{self.path} and the options" if self.is_changed else str(self.path)

    @property
    def folder(self) -> Path:
        """The folder to which names of files in the values are relative; without a file, the working directory."""
        return Path() if self.path is None else self.path.parent

    def section(self, name: str) -> Mapping[str, Any]:
        """Return the values of a section; empty if it is missing."""
        return self.sections.get(name) or {}

    def build(self, config_type: type[C], name: str) -> C:
        """Return the parameters of a section, such as `localisation`.

        ConfigError if a value is invalid, or if a ROS parameter file has one of the names without its prefix.
        """
        if name in NODE_SECTIONS:
            prefix, nodes = NODE_SECTIONS[name]
            known = {info.name for info in parameters(config_type)} if prefix else set()
            for node, parameter in self.others:
                if node in nodes and parameter in known:
                    raise ConfigError(
                        f"{self.origin}: unknown parameter '{parameter}' of '{node}' (did you mean "
                        f"'{prefix}.{parameter}'?)"
                    )
        return build(config_type, self.section(name), origin=f"{self.origin}, {name}")


NOTHING_GIVEN = Configuration()  #: The configuration without values.
