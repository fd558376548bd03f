"""The configuration file of all commands and nodes: the sections of an `sfr.yaml` or of a ROS parameter file."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sfr_loc_map.config import build, flatten, suggestion
from sfr_loc_map.config_yaml import load_yaml
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.suite_names import MONITOR_NODE, SUITE_NODES, Task

C = TypeVar("C")

SECTIONS = (
    *("topics", "frames", "calibration", "extrinsics", "sync", "truth"),
    *("localisation", "mapping", "monitor", "conditions", "limits"),
)
"""Sections of `sfr.yaml`, the configuration file of all commands and nodes."""
SECTIONS_WITHOUT_KEYS = ("conditions", "limits")  #: Sections that are a list or a file name.


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
ROS_PARAMETERS = "ros__parameters"  #: Name of the parameters of a node in a ROS parameter file.
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
    flat = flatten(load_yaml(path))
    if any(ROS_PARAMETERS in name.split(".") for name in flat):
        return _sections_of_nodes(flat, path)
    return _sections_of_file(flat, path)


def _sections_of_nodes(flat: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the sections of a ROS parameter file; values of a node have priority over those of all nodes (`/**`).

    Other parameters of nodes are ignored. A misspelt prefix raises a ConfigError.
    """
    sections: dict[str, Any] = {}
    for key, value in sorted(flat.items(), key=lambda item: not item[0].startswith("/**")):
        node, _, name = key.partition(f".{ROS_PARAMETERS}.")
        prefix, _, parameter = name.partition(".")
        section = _SECTION_OF_PREFIX.get(prefix)
        is_of_suite = node.rpartition("/")[2] in ("**", *SUITE_NODES)
        if section is None and is_of_suite and _is_misspelt(prefix, _SECTION_OF_PREFIX):
            raise ConfigError(f"{path}: unknown parameter '{name}' of '{node}'{suggestion(prefix, _SECTION_OF_PREFIX)}")
        if section is None or (section == "sync" and parameter != "stamp_tolerance_s"):
            continue
        if node.rpartition("/")[2] in ("**", NODE_SECTIONS[section].nodes[0]):
            sections.setdefault(section, {})[parameter] = value
    return sections


def _sections_of_file(flat: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the sections of an `sfr.yaml`."""
    sections: dict[str, Any] = {}
    for key, value in flat.items():
        section, _, name = key.partition(".")
        section = "extrinsics" if section == NODE_SECTIONS["extrinsics"].prefix else section
        if section not in SECTIONS:
            raise ConfigError(
                f"{path}: unknown section '{section}'{suggestion(section, SECTIONS)}: parameters belong to a section, "
                "such as localisation or mapping"
            )
        if name:
            sections.setdefault(section, {})[name] = value
        elif section in SECTIONS_WITHOUT_KEYS or value is None:
            sections[section] = value or {}
        else:
            raise ConfigError(f"{path}: '{section}' is {value!r:.40}: names with values are required")
    return sections


def _is_misspelt(name: str, known: Collection[str]) -> bool:
    """Return whether an unknown name is similar to a known name."""
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=SIMILAR))


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
