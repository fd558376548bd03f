"""Check that a ROS parameter file is one, and that its sections apply to the nodes that are started.

ROS ignores sections of other nodes without a message, so a misspelt node name or another namespace would leave all
parameters at their defaults.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError

PARAMETERS = "ros__parameters"
SIMILAR = 0.8  #: Smallest similarity (`difflib`) of a misspelt node name to the name of a node.


def check_sections(path: Path, nodes: Sequence[str], namespace: str) -> None:
    """Raise a ConfigError if a file has no parameters of nodes, or if a section resembles a node but applies to none.

    `nodes` are the names of the nodes that are started in a namespace. A section applies to a node in any namespace if
    it begins with `/**`.
    """
    sections = list(_sections(load_yaml(path), ""))
    if not sections:
        raise ConfigError(
            f"'{path}' has no {PARAMETERS}: give a parameter file such as those in config/, or an sfr.yaml by --config"
        )
    space = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    names = [f"{space}/{node}" for node in nodes]
    if any(_applies(section, name) for section in sections for name in names):
        return
    for section in sections:
        if get_close_matches(section.rpartition("/")[2], nodes, n=1, cutoff=SIMILAR):
            raise ConfigError(
                f"'{path}': the section {section} applies to none of {', '.join(names)}: name it as the node, or "
                f"/**/{nodes[0]} for any namespace"
            )


def _sections(content: dict[Any, Any], prefix: str) -> Iterator[str]:
    """Yield the full names of the sections with parameters; namespaces may be nested."""
    for key, value in content.items():
        if not isinstance(value, dict):
            continue
        name = f"{prefix}/{str(key).strip('/')}"
        if PARAMETERS in value:
            yield name
        else:
            yield from _sections(value, name)


def _applies(section: str, name: str) -> bool:
    """Return whether a section applies to a node; `**` stands for any namespaces, even for none."""
    return fnmatchcase(name, section) or fnmatchcase(name, section.replace("/**/", "/"))
