"""ROS parameters from configuration dataclasses, and the parameters that each node has.

A field of a dataclass is the only declaration of a parameter: ROS gets its name, type, default, text, unit and range.
All but `autostart` may be set while the node is unconfigured, the live ones always.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter

from sfr_loc_map.config import ParamInfo, build, flatten, param, parameters
from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.nodes.diagnostics import HealthConfig, State
from sfr_loc_map.nodes.lifecycle.endpoints import RELIABILITIES
from sfr_loc_map.nodes.lifecycle.worker import Overload

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


C = TypeVar("C", bound=NodeConfig)


class ConfiguredNode(LifecycleNode, Generic[C]):
    """A node whose parameters are one configuration, which live changes replace as a whole."""

    config_type: type[C]  #: Its parameters; a subclass may have more, by a dataclass that derives from this one.
    live: tuple[str, ...] = ()  #: Beginnings of the names of parameters that may be set at any time.

    def __init__(self, name: str, **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters with the values from parameter files and command line."""
        try:
            super().__init__(name, **options)
        except InvalidParameterTypeException as error:  # of a parameter that ROS itself declares
            raise ConfigError(f"parameters of {name}: {error}") from error
        self._origin = f"parameters of {self.get_fully_qualified_name()}"
        self._infos = {info.name: info for info in parameters(self.config_type)}
        given = {n: as_list(p.value) for n, p in self._parameter_overrides.items() if not n.startswith(BUILT_IN)}
        self.config: C = build(self.config_type, given, origin=self._origin)
        self.check_config(self.config)
        for key, value in flatten(self.config).items():
            self.declare_parameter(key, as_list(value), _descriptor(self._infos[key]), ignore_override=True)
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._on_set_done)

    @property
    def state(self) -> str:
        """State of the managed node: one of `State`, or that of a transition."""
        return str(self._state_machine.current_state[1])

    def check_config(self, config: C) -> None:
        """Raise an `SfrError` where valid values do not fit together; called before `__init__` has ended, too."""

    def on_config(self) -> None:
        """Follow the configuration, which has changed."""

    def config_json(self) -> str:
        """Return the active configuration by dotted names."""
        return json.dumps({name: as_list(value) for name, value in flatten(self.config).items()})

    def _with(self, changes: Sequence[Parameter]) -> C:
        values = flatten(self.config) | {p.name: as_list(p.value) for p in changes if p.name in self._infos}
        return build(self.config_type, values, origin=self._origin)

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        infos = sorted((info for c in changes if (info := self._infos.get(c.name))), key=lambda info: info.name)
        held = [info.name for info in infos if not (info.live or info.name.startswith(self.live))]
        if held and self.state != State.UNCONFIGURED:
            reason = f"'{held[0]}' is read-only while the node is {self.state}: deactivate and clean it up first"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self.check_config(self._with(changes))
        except SfrError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _on_set_done(self, changes: list[Parameter]) -> None:
        config = self._with(changes)
        if config != self.config:
            self.config = config
            self.on_config()

    def _set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set what changes: of the others, as in a dump of this node, ROS refuses those that are read-only."""

        def differs(new: Parameter) -> bool:
            now = self.get_parameter(new.name) if self.has_parameter(new.name) else None
            return now is None or now.type_ != new.type_ or as_list(now.value) != as_list(new.value)

        changes = list(filter(differs, parameter_list))
        if parameter_list and not changes:
            return SetParametersResult(successful=True)
        return super()._set_parameters_atomically(changes)


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
