"""ROS parameters from configuration dataclasses, and the parameters common to all nodes.

Each parameter is declared once, as a field of a dataclass, which gives its name, type, default, description, unit and
range. All parameters except `autostart` may be set while the node is unconfigured, live parameters at any time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from sfr_loc_map.configuration.parameters import ParamInfo, is_misspelt, param
from sfr_loc_map.nodes.lifecycle.diagnostics import HealthConfig
from sfr_loc_map.ros.qos import RELIABILITIES
from sfr_loc_map.worker import Overload

BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Names and name prefixes of parameters that ROS itself declares on a node."""
AUTOSTART = "autostart"  #: Parameter that is read once, when the node starts.


@dataclass(frozen=True, slots=True)
class NodeConfig(ABC):
    """Parameters common to all nodes."""

    autostart: bool = param(
        True, doc="Become active at the start. false: wait for a lifecycle manager or `ros2 lifecycle set`."
    )
    output_reliability: str = param(
        "reliable", doc="Reliability offered to the subscribers of results.", choices=RELIABILITIES
    )
    health: HealthConfig = field(default_factory=HealthConfig)

    @abstractmethod
    def queue(self) -> tuple[Overload, int]:
        """Return the overload policy of the worker, and the maximum number of waiting jobs."""


def descriptor(info: ParamInfo) -> ParameterDescriptor:
    """Return the descriptor of a parameter, which ROS tools show: description with unit, range, choices."""
    message = ParameterDescriptor(description=f"{info.doc} [{info.unit}]" if info.unit else info.doc)
    message.additional_constraints = f"one of: {', '.join(info.choices)}" if info.choices else ""
    if info.low is None or info.high is None or isinstance(info.default, tuple):
        return message
    if isinstance(info.default, float):
        message.floating_point_range = [FloatingPointRange(from_value=float(info.low), to_value=float(info.high))]
    else:
        message.integer_range = [IntegerRange(from_value=int(info.low), to_value=int(info.high), step=1)]
    return message


def is_near_miss(name: str, known: Collection[str]) -> bool:
    """Return whether an unknown name is probably misspelt: in a section of the node, or similar to a known name."""
    section, dot, _ = name.rpartition(".")
    if dot and any(other.startswith(f"{section}.") for other in known):
        return True
    return is_misspelt(name, known)


def as_list(value: Any) -> Any:  # noqa: ANN401 - any parameter type
    """Return arrays of any kind as lists, other values unchanged."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, (str, bytes)) else value
