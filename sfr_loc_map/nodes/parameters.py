"""ROS parameters from configuration dataclasses.

A field of a dataclass is the only declaration of a parameter: ROS gets its name, type, default, text, unit and range.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from sfr_loc_map.config import ParamInfo, build, flatten, parameters
from sfr_loc_map.errors import ConfigError

C = TypeVar("C")
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that ROS itself declares on a node."""
_LARGEST_INTEGER = 2**63 - 1


def declare(node: Node, *config_types: type[Any]) -> list[Any]:
    """Declare the parameters of configuration classes on a node and return the configurations.

    Args:
        node: A node that has declared none of them yet.
        config_types: Frozen dataclasses with fields by `sfr_loc_map.config.param`; names differ between them.

    Returns:
        One configuration for each class, with what the parameter files and the command line gave.

    Raises:
        ConfigError: For an unknown name, a wrong type or a value out of range.
    """
    given = {n: _plain(p.value) for n, p in node._parameter_overrides.items() if not n.startswith(BUILT_IN)}
    origin = f"parameters of {node.get_fully_qualified_name()}"
    configs = _build_all(config_types, given, origin)
    for config_type, config in zip(config_types, configs, strict=True):
        values = flatten(config)
        for info in parameters(config_type):
            value = values[info.name]
            value = list(value) if isinstance(value, tuple) else value
            node.declare_parameter(info.name, value, descriptor(info), ignore_override=True)
    return configs


def descriptor(info: ParamInfo) -> ParameterDescriptor:
    """Return what ROS tools show of a parameter: text with unit, range, choices, whether it may change."""
    text = f"{info.doc} [{info.unit}]" if info.unit else info.doc
    message = ParameterDescriptor(description=text, read_only=not info.live)
    if info.choices:
        message.additional_constraints = "one of: " + ", ".join(info.choices)
    if info.low is None and info.high is None:
        return message
    if isinstance(info.default, float):
        low, high = _or(info.low, -sys.float_info.max), _or(info.high, sys.float_info.max)
        message.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif isinstance(info.default, int):
        low, high = _or(info.low, -_LARGEST_INTEGER), _or(info.high, _LARGEST_INTEGER)
        message.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return message


def _build_all(config_types: tuple[type[Any], ...], given: Mapping[str, Any], origin: str) -> list[Any]:
    owners = {info.name: kind for kind in config_types for info in parameters(kind)}
    unknown = sorted(set(given) - set(owners))
    if unknown:
        known = ", ".join(sorted(owners))
        raise ConfigError(f"{origin}: unknown key {', '.join(map(repr, unknown))}; known are: {known}")
    return [build(kind, {n: v for n, v in given.items() if owners[n] is kind}, origin=origin) for kind in config_types]


def _plain(value: Any) -> Any:  # noqa: ANN401 - any parameter type
    """Return arrays of any kind as lists."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, (str, bytes)) else value


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
