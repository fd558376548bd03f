"""Declaration of parameters as fields of frozen dataclasses, from which files and ROS parameters are derived.

The metadata of a field from `param` contain unit, range and description. `flatten` returns the dotted names that ROS
parameters and YAML files use. `build` constructs the dataclass from such names and rejects unknown names.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_type_hints

import msgspec
import yaml

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import read_text
from sfr_loc_map.json_yaml import parse_yaml
from sfr_loc_map.suite_names import MONITOR_NODE, SUITE_NODES, Task

C = TypeVar("C")


def param(
    default: Any,  # noqa: ANN401 - the type is that of the field
    *,
    doc: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:  # noqa: ANN401 - stands for the field's value, as dataclasses.field does
    """Declare a parameter. Numbers require a range."""
    metadata = {"doc": doc, "unit": unit, "low": low, "high": high, "choices": choices}
    if isinstance(default, (list, dict)):
        raise TypeError("use a tuple: defaults are shared")
    if _has_numbers(default) and (low is None or high is None or not -math.inf < low <= high < math.inf):
        raise TypeError(f"a number requires a finite range: low is {low}, high is {high} ({doc})")
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class ParamInfo:
    """Dotted name and declaration of a parameter of a configuration class."""

    name: str
    type: type
    default: Any
    doc: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]


def parameters(config_type: type, prefix: str = "") -> Iterator[ParamInfo]:
    """Yield every parameter of a configuration class. Nested parameters have dotted names."""
    types = get_type_hints(config_type)
    for item in fields(config_type):
        kind = types[item.name]
        name = prefix + item.name
        if is_dataclass(kind) and isinstance(kind, type):
            yield from parameters(kind, name + ".")
            continue
        yield ParamInfo(name=name, type=kind, default=item.default, **item.metadata)


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:  # noqa: ANN401 - a mapping or configuration dataclass
    """Return the values of a configuration, or of a nested mapping, by dotted name."""
    flat: dict[str, Any] = {}
    items = (
        config if isinstance(config, Mapping) else {item.name: getattr(config, item.name) for item in fields(config)}
    )
    for name, value in items.items():
        if isinstance(value, Mapping) or is_dataclass(value):
            flat.update(flatten(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def changed(config: Any, prefix: str = "") -> dict[str, Any]:  # noqa: ANN401 - any configuration dataclass
    """Return the values of a configuration that differ from the defaults, by dotted name; tuples become lists."""
    defaults = flatten(type(config)(), prefix)
    values = {name: value for name, value in flatten(config, prefix).items() if value != defaults[name]}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


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


def yaml_text(value: object) -> str:
    """Return a value as one line of YAML."""
    plain = list(value) if isinstance(value, tuple) else value
    text = yaml.safe_dump(plain, default_flow_style=True, width=10**6, default_style='"' if plain == "" else None)
    return text.removesuffix("\n").removesuffix("\n...")


_KINDS: Mapping[type, str] = {bool: "true or false", int: "a whole number", float: "a number", tuple: "a list"}
"""Words for the types of parameters in a message. Other parameters are texts."""


def build(config_type: type[C], values: Mapping[str, Any], *, origin: str = "configuration") -> C:
    """Return a configuration from values by dotted or nested name; missing values have their defaults.

    Raises ConfigError, whose single line reports all faults.
    """
    flat = flatten(values)
    known = {info.name: info for info in parameters(config_type)}
    problems = [f"unknown key '{name}'{suggestion(name, known)}" for name in flat if name not in known]
    checked: dict[str, Any] = {}
    for name, value in flat.items():
        if name in known:
            try:
                checked[name] = _checked(known[name], value)
            except ConfigError as error:
                problems.append(str(error))
    if problems:
        raise ConfigError(f"{origin}: " + "; ".join(problems))
    try:
        return _construct(config_type, checked, "")
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from error


def _checked(info: ParamInfo, value: Any) -> Any:  # noqa: ANN401 - any parameter type
    value = value.tolist() if hasattr(value, "tolist") else value  # numpy scalars and arrays
    if isinstance(value, bool) and "yes" in info.choices:
        value = "yes" if value else "no"  # YAML 1.1 reads yes and no as Booleans
    try:
        value = msgspec.convert(value, info.type)
    except msgspec.ValidationError as error:
        kind = _KINDS.get(type(info.default), "text")
        raise ConfigError(f"'{info.name}' is {value!r:.40}: {kind} is required") from error
    for item in value if isinstance(value, tuple) else (value,):
        if info.low is not None and info.high is not None and not info.low <= item <= info.high:
            limits = f"{info.low} to {info.high} {info.unit}".rstrip()
            raise ConfigError(f"'{info.name}' is {item}: {limits} is required")
    if info.choices and value not in info.choices:
        raise ConfigError(f"'{info.name}' is '{value}': one of {', '.join(info.choices)} is required")
    return value


def checked(config: C) -> C:
    """Return a configuration with the checks and conversions of `build`."""
    return build(type(config), flatten(config), origin=type(config).__name__)


def load_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds one mapping; raises ConfigError if the file is missing, not YAML or not a mapping."""
    try:
        content = parse_yaml(read_text(path))
    except OSError as error:
        raise ConfigError(f"cannot read '{path}': {error.strerror}; give an existing YAML file") from error
    except (yaml.YAMLError, ValueError) as error:
        detail = " ".join(str(error).split())
        raise ConfigError(f"'{path}' is not valid YAML: {detail}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"'{path}' contains {content!r:.40}: names with values (NAME: VALUE) are required")
    return content


def _has_numbers(default: object) -> bool:
    """Return whether a default is or contains a number. An empty tuple counts as a tuple of numbers."""
    values = default if isinstance(default, tuple) else (default,)
    return not values or any(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)


def suggestion(name: str, known: Collection[str]) -> str:
    """Return the known name most similar to an unknown name, or the first known names, in parentheses."""
    close = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean '{close[0]}'?)" if close else f" (known: {', '.join(sorted(known)[:8])}, ...)"


def _construct(config_type: type[C], values: Mapping[str, Any], prefix: str) -> C:
    types = get_type_hints(config_type)
    chosen: dict[str, Any] = {}
    for item in fields(config_type):  # type: ignore[arg-type]
        kind = types[item.name]
        name = prefix + item.name
        if is_dataclass(kind) and isinstance(kind, type):
            chosen[item.name] = _construct(kind, values, name + ".")
        elif name in values:
            chosen[item.name] = values[name]
    return config_type(**chosen)


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
