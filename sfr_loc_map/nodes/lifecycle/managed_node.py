"""The transitions of a managed node.

A managed node (design.ros2.org, "Managed nodes") is configured, activated, deactivated and cleaned up by a lifecycle
manager or by `ros2 lifecycle set`; with the parameter `autostart` it does the first two by itself. What it holds in
each state:

    unconfigured   parameters, and its health on /diagnostics
    inactive       + publishers, compiled code, the worker's thread
    active         + subscriptions and timers: only now anything is received or published
"""

from __future__ import annotations

from typing import Any

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import String

from sfr_loc_map.inputs import JUMP_BACK_NS
from sfr_loc_map.nodes.diagnostics.key_values import Level
from sfr_loc_map.nodes.lifecycle.base_node import BaseNode, C
from sfr_loc_map.nodes.lifecycle.heap import release_memory
from sfr_loc_map.nodes.lifecycle.transitions import SUCCESS, Transitions, answer_invalid_transitions
from sfr_loc_map.nodes.lifecycle.worker import Worker


class ManagedNode(BaseNode[C]):
    """A node that is configured, activated, deactivated and cleaned up."""

    _worker: Worker | None = None  # from Kilted on the context destroys its nodes, also those whose making failed

    def __init__(
        self,
        name: str,
        task: str,
        config_type: type[C],
        live: tuple[str, ...],
        **options: Any,  # noqa: ANN401
    ) -> None:
        """Declare the parameters; see `BaseNode`."""
        super().__init__(name, task, config_type, live, **options)
        self._transitions = Transitions(self._report_failure, self._log_error)
        answer_invalid_transitions(self, lambda: self.status.publish_health(only_changes=True))

    def start(self) -> None:
        """Become active, if `autostart` is on.

        Raises:
            SfrError: If that fails for a known reason.
        """
        if not self.config.autostart:
            self.get_logger().info("unconfigured: waits for a lifecycle manager")
            return
        self._transitions.quiet = True
        try:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != SUCCESS and self._transitions.last_error is not None:
                    raise self._transitions.last_error
        finally:
            self._transitions.quiet = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create what an inactive node has."""
        return self._transitions.run("configure", self._configure, undo=self._clean_up)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Receive and publish."""
        enable = super().on_activate
        return self._transitions.run("activate", lambda: enable(state), self._activate, undo=self._deactivate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Receive nothing more, finish the running job, stop publishing."""
        disable = super().on_deactivate
        return self._transitions.run("deactivate", self._deactivate, lambda: disable(state), self._log_inactive)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything."""
        return self._transitions.run("cleanup", self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything, from any state."""
        return self._transitions.run("shutdown", self._deactivate, self._clean_up)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything after a transition that raised: the node can then be configured again."""
        result = self._transitions.run("error", self._deactivate, self._clean_up)
        self.status.health.note_problem(Level.ERROR, f"a transition broke: {self._transitions.last_error}")
        return result

    def destroy_node(self) -> None:
        """End the thread and leave the graph."""
        if self._worker is not None:
            self._worker.stop()
        super().destroy_node()

    def _configure(self) -> None:
        self.check_config(self.config)  # again: a file that it names may be gone
        self.get_logger().info(f"configuration {self.config_json()}")
        self.teardown()  # begin with the parameters that were set meanwhile
        self._worker = Worker(self.task, *self.config.queue(), self._on_fault)
        self._config_publisher = self.endpoints.add_publisher(String, f"{self.task}/configuration", 1, latched=True)
        self.setup()

    def _activate(self) -> None:
        self.status.health.reset()
        self.subscribe()
        for name in self.endpoints.unused_overrides():
            self.get_logger().warning(f"parameter {name} is of no subscription of this node: ignored")
        jump = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-JUMP_BACK_NS), on_clock_change=False)
        handle = self.get_clock().create_jump_callback(jump, post_callback=lambda _: self.clock_jumped_back())
        self.endpoints.at_deactivate(handle.unregister)
        self.get_logger().info(self.endpoints.summary(self.status.publisher.topic_name))
        self._publish_config()

    def _deactivate(self) -> None:
        self.endpoints.destroy_active()
        if self._worker is not None:
            self._worker.clear()
            self._worker.wait_idle()
        self.status.health.reset()

    def _clean_up(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        self.endpoints.destroy_configured()
        self.teardown()
        release_memory()

    def _report_failure(self, text: str) -> None:
        self._log_error(text)
        self.status.health.note_problem(Level.ERROR, text)

    def _log_error(self, text: str) -> None:
        if self.context.ok():  # else a signal has shut ROS down within the transition, which then failed of it
            self.get_logger().error(text)

    def _log_inactive(self) -> None:
        self.get_logger().info("inactive")
