"""The configuration file of all commands and nodes: the sections of an `sfr.yaml` or of a ROS parameter file."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sfr_loc_map.config import build, flatten, is_empty, suggestion
from sfr_loc_map.config_yaml import load_yaml
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.suite_names import MONITOR_NODE, SUITE_NODES, Task

C = TypeVar("C")

SECTIONS = (
    *("topics", "frames", "calibration", "extrinsics", "sync", "truth"),
    *("localisation", "mapping", "monitor", "conditions", "limits"),
)
"""Sections of `sfr.yaml`, the configuration file of all commands and nodes.

`topics` contains the name in the bag by name in the suite; `--remap FOUND:=EXPECTED` has the inverse order.
"""


class NodeSection(NamedTuple):
    """Node parameters that a section of `sfr.yaml` contains."""

    prefix: str  #: First part of the names of the node parameters; empty if the names have no prefix.
    nodes: tuple[str, ...]  #: Nodes with these parameters. A ROS parameter file is read for the first of them.


_LOCALISER, _MAPPER = Task.LOCALISATION.node, Task.MAPPING.node
NODE_SECTIONS = {
    "localisation": NodeSection("localisation", (_LOCALISER,)),
    "mapping": NodeSection("mapping", (_MAPPER,)),
    "monitor": NodeSection("", (MONITOR_NODE,)),
    "truth": NodeSection("truth", (MONITOR_NODE,)),
    "extrinsics": NodeSection("T_rb_locsb", (_LOCALISER,)),
    "sync": NodeSection("input", (_LOCALISER, _MAPPER)),
}
"""Sections that contain node parameters."""
SIMILAR = 0.8
"""Minimum similarity (`difflib`) of an unknown prefix to the prefix that it misspells. No parameter of another node is
as similar to a prefix."""
SIMILAR_NODES = 0.9
"""Minimum similarity (`difflib`) of an unknown node to the node of the suite that it misspells: one or two letters."""
STAMP_TOLERANCE = "stamp_tolerance_s"  #: Parameter of a node's input that the section `sync` has, too.
ROS_PARAMETERS = "ros__parameters"  #: Name of the parameters of a node in a ROS parameter file.
ALL_NODES = "**"  #: Name of all nodes in a ROS parameter file.
_SECTION_OF_PREFIX = {known.prefix: name for name, known in NODE_SECTIONS.items() if known.prefix}


def node_parameters(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node from the values of `NODE_SECTIONS` by dotted name."""
    found: dict[str, dict[str, Any]] = {node: {} for node in SUITE_NODES}
    for section, values in sections.items():
        prefix, nodes = NODE_SECTIONS[section]
        for node in nodes:
            for name, value in values.items():
                found[node][f"{prefix}.{name}" if prefix else name] = value
    return found


def read_sections(path: Path) -> dict[str, Any]:
    """Return the values of a configuration file by section, as mappings of dotted names.

    The file is an `sfr.yaml` or a ROS parameter file (`/**: ros__parameters:` or `NODE: ros__parameters:`). Raises
    ConfigError.
    """
    flat = _read_flat(path)
    return _sections_of_nodes(flat, path) if _has_nodes(flat) else _sections_of_file(flat, path)


def is_ros_parameter_file(path: Path) -> bool:
    """Return whether a YAML file has the layout of ROS parameter files; raises ConfigError if it cannot be read."""
    return _has_nodes(_read_flat(path))


def _read_flat(path: Path) -> dict[str, Any]:
    """Return the values of a YAML file by dotted name."""
    content = load_yaml(path)
    try:
        return flatten(content, keeps_empty=True)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _has_nodes(flat: Mapping[str, Any]) -> bool:
    """Return whether dotted names are those of a ROS parameter file."""
    return any(ROS_PARAMETERS in name.split(".") for name in flat)


def _sections_of_nodes(flat: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the sections of a ROS parameter file; values of a node have priority over those of all nodes (`/**`).

    Other parameters of nodes are ignored. Raises the errors of `_by_node` and `_by_suite_node`.
    """
    parameters = _by_suite_node(_by_node(flat, path), path)
    sections: dict[str, Any] = {}
    for name in (ALL_NODES, *SUITE_NODES):
        for parameter, value in parameters.get(name, {}).items():
            prefix, _, key = parameter.partition(".")
            section = _SECTION_OF_PREFIX.get(prefix)
            if not key and is_empty(value):
                continue
            if section is None or name not in (ALL_NODES, NODE_SECTIONS[section].nodes[0]):
                continue
            if section == "sync" and key != STAMP_TOLERANCE:  # nodes have other settings of their inputs
                continue
            sections.setdefault(section, {})[key] = value
    return sections


def _by_node(flat: Mapping[str, Any], path: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node by its name in the file; ConfigError for a value of no node."""
    nodes: dict[str, dict[str, Any]] = {}
    for key, value in flat.items():
        node, is_parameter, name = key.partition(f".{ROS_PARAMETERS}.")
        if is_parameter:
            nodes.setdefault(node, {})[name] = value
        elif not is_empty(value):
            raise ConfigError(
                f"{path}: '{key}' is not in {ROS_PARAMETERS}, but the file has parameters of nodes: move '{key}' to a "
                "file without parameters of nodes"
            )
    return nodes


def _by_suite_node(nodes: Mapping[str, dict[str, Any]], path: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of all nodes and of the nodes of the suite, by their names without a namespace.

    ConfigError for a misspelt prefix or node, and for several nodes with one name.
    """
    found: dict[str, dict[str, Any]] = {}
    node_of_name: dict[str, str] = {}
    for node, values in nodes.items():
        name = node.replace(".", "/").rpartition("/")[2]
        _check_spelling(node, name, values, path)
        if name not in (ALL_NODES, *SUITE_NODES):
            continue
        other = node_of_name.setdefault(name, node)
        if other != node:
            raise ConfigError(f"{path}: '{other}' and '{node}' are nodes of one name: give a file for each of them")
        found[name] = values
    return found


def _check_spelling(node: str, name: str, values: Mapping[str, Any], path: Path) -> None:
    """Raise ConfigError if the prefix of a parameter of the suite, or the name of its node, is misspelt."""
    is_of_suite = name in (ALL_NODES, *SUITE_NODES)
    is_similar = not is_of_suite and _is_misspelt(name, SUITE_NODES, SIMILAR_NODES)
    for parameter in values:
        prefix = parameter.partition(".")[0]
        is_known = prefix in _SECTION_OF_PREFIX
        is_misspelt = not is_known and _is_misspelt(prefix, _SECTION_OF_PREFIX, SIMILAR)
        if is_similar and (is_known or is_misspelt):
            raise ConfigError(f"{path}: unknown node '{node}' with '{parameter}'{suggestion(name, SUITE_NODES)}")
        if is_of_suite and is_misspelt:
            hint = suggestion(prefix, _SECTION_OF_PREFIX)
            raise ConfigError(f"{path}: unknown parameter '{parameter}' of '{node}'{hint}")


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
        is_valid, required = not name and isinstance(value, str), "a file name"
    elif section == "conditions":
        is_list = isinstance(value, list) and all(isinstance(item, str) for item in value)
        is_valid, required = not name and is_list, "a list such as [distance=5]"
    else:
        is_valid, required = bool(name) or isinstance(value, Mapping), "a mapping of names to values"
    if not is_valid:
        raise ConfigError(f"{where} is {value!r:.40}: {required} is required for '{section}'")


def _is_misspelt(name: str, known: Collection[str], similar: float) -> bool:
    """Return whether an unknown name has at least this similarity to a known name."""
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=similar))


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
        found: Mapping[str, Any] = self.sections.get(name, {})
        return found

    def build(self, config_type: type[C], name: str) -> C:
        """Return the parameters of a section, such as `localisation`."""
        return build(config_type, self.section(name), origin=f"{self.path}, {name}")


def read_config(config_type: type[C], path: Path | None, part: str) -> C:
    """Read the parameters of a section, such as `localisation`, from a configuration file; None gives the defaults."""
    return Configuration.read(path).build(config_type, part)
