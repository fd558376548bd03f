"""What a node of ours has in every state, and what a subclass defines: configuration, worker, endpoints, status."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from rclpy.clock import ROSClock
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import String

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.nodes.diagnostics.health import NodeActivity, State
from sfr_loc_map.nodes.diagnostics.key_values import Level
from sfr_loc_map.nodes.diagnostics.status_reporter import StatusReporter
from sfr_loc_map.nodes.lifecycle.endpoints import Answer, Endpoints
from sfr_loc_map.nodes.lifecycle.node_config import NodeConfig
from sfr_loc_map.nodes.lifecycle.parameters import Parameters
from sfr_loc_map.nodes.lifecycle.services import answer_by
from sfr_loc_map.nodes.lifecycle.worker import Worker

C = TypeVar("C", bound=NodeConfig)
FIXED = ("autostart",)
"""Parameters that are read once, when the node starts."""


class BaseNode(LifecycleNode, Generic[C]):
    """A node with one configuration, whose work is done in a thread of its own.

    A subclass says in `setup`, `subscribe`, `teardown`, `clock_jumped_back` and `apply_config` what it does in each
    step; these are called in the executor's thread. Jobs given to `worker` are done in its thread, in order.

    Attributes:
        task: What it does, in one word: `localisation`, `mapping` or `monitor`.
        status: Reports problems and health.
        endpoints: Creates publishers, subscriptions and timers.
    """

    def __init__(
        self,
        name: str,
        task: str,
        config_type: type[C],
        live: tuple[str, ...],
        **options: Any,  # noqa: ANN401
    ) -> None:
        """Declare the parameters.

        Args:
            name: Name of the node.
            task: One word.
            config_type: Its parameters.
            live: Beginnings of names of parameters that may change while the node is active; the others may as long as
                it is unconfigured.
            options: Of `rclpy.node.Node` (namespace, parameter_overrides, ...).

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        try:
            super().__init__(name, **options)
        except InvalidParameterTypeException as error:  # of a parameter that ROS itself declares
            raise ConfigError(f"parameters of {name}: {error}") from error
        self.task = task
        self._settings = Parameters(
            self,
            config_type,
            live=live,
            fixed=FIXED,
            state=lambda: self.state,
            check=self.check_config,
            changed=self._on_change,
        )
        self._worker: Worker | None = None
        self._config_publisher: Any = None
        self.status = StatusReporter(self, task, self.config.health, self._activity)
        self.endpoints = Endpoints(self, self.config.output_reliability, self.status.warn)

    # ---- what a subclass defines

    def check_config(self, config: C) -> None:
        """Raise an `SfrError` where valid values do not fit together; called before `__init__` has ended, too."""

    def setup(self) -> None:
        """Prepare: publishers, compiled code."""

    def subscribe(self) -> None:
        """Receive: subscriptions, timers, services."""

    def teardown(self) -> None:
        """Forget all state and results."""

    def clock_jumped_back(self) -> None:
        """Start a new run."""

    def apply_config(self, config: C) -> None:
        """Work with another configuration from now on."""

    def expects_input(self) -> bool:
        """Tell whether an active node should be receiving, so that silence makes it stale."""
        return True

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return {"dropped_overload": self._worker.dropped if self._worker is not None else 0}

    def restart_after_fault(self) -> None:
        """Restart after an exception that was not foreseen; called in the worker's thread."""

    # ---- what a subclass uses

    @property
    def config(self) -> C:
        """The active configuration."""
        return self._settings.config

    @property
    def state(self) -> str:
        """State of the managed node: one of `State`, or that of a transition."""
        return str(self._state_machine.current_state[1])

    @property
    def worker(self) -> Worker:
        """The thread.

        Raises:
            NodeError: If the node is not configured.
        """
        if self._worker is None:
            raise NodeError(f"{self.get_fully_qualified_name()} is {self.state}: configure it first")
        return self._worker

    def config_json(self) -> str:
        """Return the active configuration by dotted names."""
        return self._settings.to_json()

    def add_service(self, name: str, work: Callable[[], str], first: Callable[[], object] = lambda: None) -> None:
        """Offer a Trigger service of the active node, answered by the worker after the jobs that wait there.

        Args:
            name: Name of the service.
            work: Returns the answer; an `SfrError` is answered as a failure.
            first: Done at once, in the executor's thread.
        """

        async def answer() -> Answer:
            if self.state != State.ACTIVE:
                return False, f"the node is {self.state}: activate it first"
            first()
            result: Answer = await answer_by(self.worker, work, self.executor, f"{self.task} failed: see the log")
            return result

        self.endpoints.add_service(name, answer)

    # ---- events

    def _activity(self) -> NodeActivity:
        waiting = self._worker.waiting if self._worker is not None else 0
        return NodeActivity(self.state, self.counts(), waiting, self.expects_input(), self._surroundings())

    def _surroundings(self) -> list[tuple[Level, str]]:
        """Return what of the graph and the clock keeps the node from being of use."""
        found: list[tuple[Level, str]] = []
        if self.get_node_names_and_namespaces().count((self.get_name(), self.get_namespace())) > 1:
            text = (
                f"another node of the name {self.get_fully_qualified_name()} is in this ROS domain and publishes, too: "
                f"end one, or give it a namespace (one that was killed shows for up to 20 s)"
            )
            found.append((Level.WARN, text))
        clock = self.get_clock()
        if isinstance(clock, ROSClock) and clock.ros_time_is_active and not clock.now().nanoseconds:
            found.append((Level.WARN, "use_sim_time is on but nothing was received on /clock: its time stands still"))
        return found

    def _on_fault(self, error: Exception) -> None:
        """Survive an exception that was not foreseen: report it and restart."""
        if not self.context.ok():
            return  # a signal has shut ROS down while the thread worked: its next use of ROS failed
        self.get_logger().error("".join(traceback.format_exception(error)))
        self.status.error(f"internal fault, {self.task} restarts: {type(error).__name__}: {error}")
        self.restart_after_fault()

    def _on_change(self, config: C) -> None:
        self.get_logger().info(f"parameters have changed; configuration {self.config_json()}")
        self.endpoints.reliability = config.output_reliability
        self.status.set_config(config.health)
        if self._worker is not None:
            self.apply_config(config)
            self._publish_config()

    def _publish_config(self) -> None:
        self._config_publisher.publish(String(data=self.config_json()))
