"""Parameters as YAML: reading of a file, and the lines of a file with the description of each parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.configuration.parameters import ParamInfo, parameters
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import read_text
from sfr_loc_map.json_yaml import parse_yaml


def load_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds one mapping; raises ConfigError if the file is missing, not YAML or not a mapping."""
    try:
        content = parse_yaml(read_text(path))
    except OSError as error:
        raise ConfigError(f"cannot read '{path}': {error.strerror}; give an existing YAML file") from error
    except (yaml.YAMLError, ValueError) as error:
        detail = " ".join(str(error).split())
        raise ConfigError(f"'{path}' is not valid YAML: {detail}; correct the file") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"'{path}' contains {content!r:.40}: names with values (NAME: VALUE) are required")
    return content


def entries_by_name(content: Mapping[Any, Any], origin: str) -> dict[str, Any]:
    """Return a mapping with texts as its keys; raises ConfigError if two keys are one text, such as 1 and '1'."""
    entries: dict[str, Any] = {}
    for key, value in content.items():
        if str(key) in entries:
            raise ConfigError(f"{origin}: '{key}' is given twice, as a text and as another value: give each name once")
        entries[str(key)] = value
    return entries


def to_yaml_lines(config_type: type, indent: str) -> list[str]:
    """Return the defaults of a configuration class as lines of YAML, each below the description of the parameter."""
    lines: list[str] = []
    groups: list[str] = []
    for info in parameters(config_type):
        *parents, name = info.name.split(".")
        for depth, parent in enumerate(parents):
            if groups[: depth + 1] != parents[: depth + 1]:
                lines.append(f"{indent}{'  ' * depth}{parent}:")
                groups = parents[: depth + 1]
        groups = parents
        inner = indent + "  " * len(parents)
        lines += [f"{inner}# {_comment(info)}", f"{inner}{name}: {yaml_text(info.default)}"]
    return lines


def _comment(info: ParamInfo) -> str:
    parts = [info.doc]
    if info.unit:
        parts.append(f"[{info.unit}]")
    if info.choices:
        parts.append(f"One of: {', '.join(info.choices)}.")
    if info.low is not None and info.high is not None:
        parts.append(f"({info.low:g} .. {info.high:g})")
    return " ".join(parts)


class _OneLineDumper(yaml.SafeDumper):
    """Writes texts that are empty or contain line breaks in double quotes, with escape sequences."""


def _one_line_text(dumper: yaml.SafeDumper, value: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if value.splitlines() == [value] else '"')


_OneLineDumper.add_representer(str, _one_line_text)


def yaml_text(value: object) -> str:
    """Return a value as one line of YAML."""
    plain = list(value) if isinstance(value, tuple) else value
    text: str = yaml.dump(plain, Dumper=_OneLineDumper, default_flow_style=True, width=math.inf)
    return text.removesuffix("\n").removesuffix("\n...")
