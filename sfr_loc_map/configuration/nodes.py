"""The parameters of nodes: sections of `sfr.yaml` that contain them, and ROS parameter files.

A ROS parameter file has the parameters of all nodes below `/**: ros__parameters:`, and those of a node below `NODE:
ros__parameters:`. In the name of a node, `*` stands for one part, and `**` for any number of parts. Namespaces are
ignored, because commands have none. `sections_of_nodes` returns the parameters of such a file as the sections of an
`sfr.yaml`, and `node_parameters` returns the parameters of each node from sections.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from sfr_loc_map.configuration.parameters import MAPPING, is_empty, is_misspelt, suggestion
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.suite_names import MONITOR_NODE, SUITE_NODES, Task


class NodeSection(NamedTuple):
    """Node parameters that a section of `sfr.yaml` contains."""

    prefix: str  #: First part of the names of the node parameters; empty if the names have no prefix.
    nodes: tuple[str, ...]  #: Nodes with these parameters.


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
STAMP_TOLERANCE = "stamp_tolerance_s"  #: Parameter of a node's input that the section `sync` has, too.
ROS_PARAMETERS = "ros__parameters"  #: Name of the parameters of a node in a ROS parameter file.
ALL_NODES = "**"  #: Wildcard for all nodes in a ROS parameter file.
WILDCARDS = ("*", ALL_NODES)  #: Names that include every node of the suite, without their namespaces.
_SECTION_OF_PREFIX = {known.prefix: name for name, known in NODE_SECTIONS.items() if known.prefix}


def node_parameters(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node from the values of `NODE_SECTIONS` by dotted name."""
    parameters: dict[str, dict[str, Any]] = {node: {} for node in SUITE_NODES}
    for section, values in sections.items():
        prefix, nodes = NODE_SECTIONS[section]
        for node in nodes:
            for name, value in values.items():
                parameters[node][f"{prefix}.{name}" if prefix else name] = value
    return parameters


def has_nodes(flat: Mapping[str, Any]) -> bool:
    """Return whether dotted names are those of a ROS parameter file."""
    return any(ROS_PARAMETERS in name.split(".") for name in flat)


def sections_of_nodes(flat: Mapping[str, Any], path: Path) -> tuple[dict[str, Any], tuple[tuple[str, str], ...]]:
    """Return the sections of a ROS parameter file, and node and name of the parameters that belong to no section.

    Values of a node have priority over those of all nodes (`ALL_NODES`). ConfigError if a section is not a mapping or
    is that of another node, if two nodes have different values of a parameter that a section has once, or if all
    parameters are those of nodes of other programs. Raises the errors of `_by_node` and `_by_suite_node`.
    """
    nodes = _by_node(flat, path)
    parameters = _by_suite_node(nodes, path)
    if nodes and not parameters:
        raise ConfigError(
            f"{path}: all parameters are those of other nodes, such as '{min(nodes)}': parameters of "
            f"{alternatives((*SUITE_NODES, '/**'))} are required"
        )
    sections: dict[str, Any] = {}
    others: list[tuple[str, str]] = []
    node_of: dict[str, str] = {}  # by parameter: first node of the suite with a value
    for node in (ALL_NODES, *SUITE_NODES):
        for parameter, value in parameters.get(node, {}).items():
            prefix, _, key = parameter.partition(".")
            section = _SECTION_OF_PREFIX.get(prefix)
            is_without_values = not key and is_empty(value)
            # nodes have other settings of their inputs, too
            is_other_input = section == "sync" and key not in ("", STAMP_TOLERANCE)
            if is_without_values or is_other_input:
                continue
            if section is None:
                others.append((node, parameter))
                continue
            _check_node_of_section(section, node, parameter, value, path)
            values = sections.setdefault(section, {})
            other = node if node == ALL_NODES else node_of.setdefault(parameter, node)
            if other != node and values[key] != value:
                raise ConfigError(
                    f"{path}: '{parameter}' is {values[key]!r:.40} for '{other}' and {value!r:.40} for '{node}': a "
                    "command uses one value for both nodes; give equal values"
                )
            values[key] = value
    return sections, tuple(others)


def _check_node_of_section(section: str, node: str, parameter: str, value: object, path: Path) -> None:
    """Raise ConfigError if a section is that of another node, or if its value is not a mapping."""
    nodes = NODE_SECTIONS[section].nodes
    if node not in (ALL_NODES, *nodes):
        raise ConfigError(f"{path}: '{parameter}' of '{node}' is a parameter of {alternatives(nodes)}")
    if not parameter.partition(".")[2]:
        raise ConfigError(f"{path}: '{parameter}' is {value!r:.40}: {MAPPING} is required")


def _by_node(flat: Mapping[str, Any], path: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node by its name in the file; ConfigError for a value of no node."""
    nodes: dict[str, dict[str, Any]] = {}
    for key, value in flat.items():
        node, is_parameter, name = key.partition(f".{ROS_PARAMETERS}.")
        if is_parameter:
            nodes.setdefault(node, {})[name] = value
        elif is_empty(value):
            continue
        elif key.rpartition(".")[2] == ROS_PARAMETERS:
            raise ConfigError(f"{path}: '{key}' is {value!r:.40}: {MAPPING} is required")
        else:
            raise ConfigError(
                f"{path}: '{key}' is not in {ROS_PARAMETERS}, but the file has parameters of nodes: move '{key}' to a "
                "file without parameters of nodes"
            )
    return nodes


def _by_suite_node(nodes: Mapping[str, dict[str, Any]], path: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of all nodes and of the nodes of the suite, by their names without a namespace.

    ConfigError for a misspelt prefix or node, for several nodes with one name, for a parameter that two wildcards give,
    and for a name with a wildcard beside other characters.
    """
    parameters: dict[str, dict[str, Any]] = {}
    node_of_name: dict[str, str] = {}
    for node, values in nodes.items():
        name = node.replace(".", "/").rpartition("/")[2]
        _check_spelling(node, name, values, path)
        if name in WILDCARDS:
            _add_to_all(parameters.setdefault(ALL_NODES, {}), values, node, path)
        elif "*" in name:
            raise ConfigError(
                f"{path}: '{node}' is not a name of nodes: '*' and '**' stand only for complete parts of a name"
            )
        if name not in SUITE_NODES:
            continue
        other = node_of_name.setdefault(name, node)
        if other != node:
            raise ConfigError(f"{path}: '{other}' and '{node}' are nodes of one name: give a file for each of them")
        parameters[name] = values
    return parameters


def _add_to_all(of_all: dict[str, Any], values: Mapping[str, Any], node: str, path: Path) -> None:
    """Add the parameters of a wildcard to those of all nodes; ConfigError if another wildcard has one of them."""
    if twice := of_all.keys() & values.keys():
        raise ConfigError(f"{path}: '{min(twice)}' is given by '{node}' and by another name of all nodes: give it once")
    of_all |= values


def _check_spelling(node: str, name: str, values: Mapping[str, Any], path: Path) -> None:
    """Raise ConfigError if the prefix of a parameter of the suite, or the name of its node, is misspelt."""
    is_of_suite = name in (*WILDCARDS, *SUITE_NODES)
    is_wrong_node = not is_of_suite and is_misspelt(name, SUITE_NODES)
    for parameter in values:
        prefix = parameter.partition(".")[0]
        is_known = prefix in _SECTION_OF_PREFIX
        is_wrong_prefix = not is_known and is_misspelt(prefix, _SECTION_OF_PREFIX)
        if is_wrong_node and (is_known or is_wrong_prefix):
            raise ConfigError(f"{path}: unknown node '{node}' with '{parameter}'{suggestion(name, SUITE_NODES)}")
        if is_of_suite and is_wrong_prefix:
            hint = suggestion(prefix, _SECTION_OF_PREFIX)
            raise ConfigError(f"{path}: unknown parameter '{parameter}' of '{node}'{hint}")
