"""ROS parameters from configuration dataclasses, and the parameters that each node has.

A field of a dataclass is the only declaration of a parameter: ROS gets its name, type, default, text, unit and range.
All but `autostart` may be set while the node is unconfigured, the live ones always.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from sfr_loc_map.config import ParamInfo, build, flatten, param, parameters
from sfr_loc_map.errors import SfrError
from sfr_loc_map.nodes.diagnostics import HealthConfig, State
from sfr_loc_map.nodes.lifecycle.endpoints import RELIABILITIES
from sfr_loc_map.nodes.lifecycle.worker import Overload

C = TypeVar("C")
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that ROS itself declares on a node."""
FIXED = "autostart"  #: Is read once, when the node starts.


@dataclass(frozen=True, slots=True)
class NodeConfig:
    """Parameters that each node has."""

    autostart: bool = param(
        True, doc="Become active at start; false: wait for a lifecycle manager or `ros2 lifecycle set`."
    )
    output_reliability: str = param(
        "reliable", doc="Reliability offered to the subscribers of results.", choices=RELIABILITIES
    )
    health: HealthConfig = field(default_factory=HealthConfig)

    @abstractmethod
    def queue(self) -> tuple[Overload, int]:
        """Return what is dropped when the worker cannot keep up, and how many jobs may wait."""


class Parameters(Generic[C]):
    """The parameters of a node as one configuration, which live changes replace as a whole."""

    def __init__(
        self,
        node: Node,
        config_type: type[C],
        *,
        live: tuple[str, ...] = (),
        state: Callable[[], str] = lambda: State.ACTIVE,
        check: Callable[[C], None] = lambda config: None,
        changed: Callable[[C], None] = lambda config: None,
    ) -> None:
        """Declare the parameters with the values from parameter files and command line."""
        self._type, self._state, self._check, self._changed = config_type, state, check, changed
        self._origin = f"parameters of {node.get_fully_qualified_name()}"
        self._infos = {info.name: info for info in parameters(config_type)}
        given = {n: as_list(p.value) for n, p in node._parameter_overrides.items() if not n.startswith(BUILT_IN)}
        self.config = build(config_type, given, origin=self._origin)
        check(self.config)
        values = flatten(self.config)
        self._live = {name for name, info in self._infos.items() if info.live or name.startswith(live or ("\0",))}
        for name, info in self._infos.items():
            node.declare_parameter(name, as_list(values[name]), _descriptor(info), ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_changed)

    def to_json(self) -> str:
        """Return the active configuration by dotted names."""
        return json.dumps({name: as_list(value) for name, value in flatten(self.config).items()})

    def _with(self, changes: Sequence[Parameter]) -> C:
        values = flatten(self.config) | {p.name: as_list(p.value) for p in changes if p.name in self._infos}
        return build(self._type, values, origin=self._origin)

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        state = self._state()
        held = sorted({change.name for change in changes} & (self._infos.keys() - self._live))
        if held and state != State.UNCONFIGURED:
            reason = f"'{held[0]}' is read-only while the node is {state}: deactivate and clean it up first"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self._check(self._with(changes))
        except SfrError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _on_changed(self, changes: list[Parameter]) -> None:
        config = self._with(changes)
        if config != self.config:
            self.config = config
            self._changed(config)


def _descriptor(info: ParamInfo) -> ParameterDescriptor:
    """Return what ROS tools show of a parameter: text with unit, range, choices."""
    message = ParameterDescriptor(description=f"{info.doc} [{info.unit}]" if info.unit else info.doc)
    message.read_only = info.name == FIXED
    message.additional_constraints = f"one of: {', '.join(info.choices)}" if info.choices else ""
    if info.low is None or info.high is None or isinstance(info.default, tuple):
        return message
    if isinstance(info.default, float):
        message.floating_point_range = [FloatingPointRange(from_value=float(info.low), to_value=float(info.high))]
    else:
        message.integer_range = [IntegerRange(from_value=int(info.low), to_value=int(info.high), step=1)]
    return message


def as_list(value: Any) -> Any:  # noqa: ANN401 - any parameter type
    """Return arrays of any kind as lists."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, (str, bytes)) else value
