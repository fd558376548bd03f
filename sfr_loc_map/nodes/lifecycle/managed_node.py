"""What the three nodes have in common: states, parameters, a thread for the work, services and health.

A managed node (design.ros2.org, "Managed nodes") is configured, activated, deactivated and cleaned up by a lifecycle
manager or by `ros2 lifecycle set`; with the parameter `autostart` it does the first two by itself. What it holds in
each state:

    unconfigured   parameters, and its health on /diagnostics
    inactive       + publishers, machine code, the thread
    active         + subscriptions and timers: only now anything is received or published
"""

from __future__ import annotations

import ctypes
import gc
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.config import param
from sfr_loc_map.constants import JUMP_BACK_NS
from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.nodes.diagnostics.health import Health, HealthConfig
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC as DIAGNOSTICS
from sfr_loc_map.nodes.diagnostics.key_values import Level, array_msg, status_msg
from sfr_loc_map.nodes.lifecycle.parameters import Parameters
from sfr_loc_map.nodes.lifecycle.qos import RELIABILITIES, profile, publisher_events, subscription_events
from sfr_loc_map.nodes.lifecycle.worker import Overload, Worker
from sfr_loc_map.nodes.messages.fields import header_msg

QUEUE_DEPTH = 1000
"""Statuses that are kept for a subscriber that is held up."""
WARN_EVERY_S = 5.0
MOST_LETTERS = 500
SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


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


@dataclass(frozen=True, slots=True)
class PairNodeConfig(NodeConfig):
    """Parameters that each node has whose work is stereo pairs."""

    overload: str = param(
        "every_pair",
        doc="What is worked on when more comes than can be done: every_pair in order, as far as queue_size allows, or "
        "newest_first, which drops all that waits when something newer comes.",
        choices=("every_pair", "newest_first"),
    )
    queue_size: int = param(
        30, doc="Most pairs that wait to be worked on (every_pair); the oldest are dropped.", low=1, high=1000
    )


def _short(text: str) -> str:
    """Return a text cut to what a log can bear: it may quote a message of any length."""
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]} ... ({len(text)} letters)"


def _give_memory_back() -> None:
    """Free what cycles hold, and let the C library return what is free to the system where it can (glibc)."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


class ManagedNode(LifecycleNode):
    """A managed node whose work is done in a thread of its own.

    A subclass says in `make`, `listen`, `free`, `clock_back` and `adopt` what it does in each step; these are called
    in the executor's thread. Jobs given to `worker` are done in its thread, in order.

    Attributes:
        task: What it does, in one word: `localisation`, `mapping` or `monitor`.
        health: How well it is.
    """

    def __init__(
        self,
        name: str,
        task: str,
        config_type: type[NodeConfig],
        live: tuple[str, ...],
        **options: Any,  # noqa: ANN401
    ) -> None:
        """Declare the parameters.

        Args:
            name: Name of the node.
            task: One word.
            config_type: Its parameters.
            live: Beginnings of names of parameters that may change while the node runs.
            options: Of `rclpy.node.Node` (namespace, parameter_overrides, ...).

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(name, **options)
        self.task = task
        self._settings = Parameters(self, config_type, live=live, check=self.check, changed=self._on_change)
        self._worker: Worker | None = None
        self._starting = False
        self._fault: Exception | None = None
        self._closing: list[Callable[[], object]] = []  # ends what only an active node has
        self._removing: list[Callable[[], object]] = []  # ends what a configured node has
        self._topics: dict[str, list[str]] = {"listens to": [], "publishes": [], "offers": []}
        self._service_group = MutuallyExclusiveCallbackGroup()
        self.health = Health(self.common.health)
        self._last_health: tuple[str, ...] = ()
        self.diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=QUEUE_DEPTH))
        self._topics["publishes"] = [self.diagnostics.topic_name]
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self.common.health.period_s, self.report_health, clock=self._steady)
        self._guard_transitions()

    # ---- what a subclass says

    def check(self, config: Any) -> None:  # noqa: ANN401 - the subclass' configuration
        """Raise an `SfrError` where valid values do not fit together; called before `__init__` has ended, too."""

    def make(self) -> None:
        """Prepare: publishers by `publish_on`, machine code."""

    def listen(self) -> None:
        """Receive: subscriptions by `listen_to`, timers by `every`, services by `offer`."""

    def free(self) -> None:
        """Forget all state and results."""

    def clock_back(self) -> None:
        """Begin a new run: the clock has gone back."""

    def adopt(self, config: Any) -> None:  # noqa: ANN401 - the subclass' configuration
        """Work with another configuration from now on."""

    def queue_limits(self) -> tuple[Overload, int]:
        """Return what is dropped when the thread cannot keep up, and how many jobs may wait."""
        return self.config.overload, self.config.queue_size

    def expects_more(self) -> bool:
        """Tell whether an active node should be receiving, so that silence makes it stale."""
        return True

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return {"dropped_overload": self._worker.dropped if self._worker is not None else 0}

    # ---- what a subclass uses

    @property
    def config(self) -> Any:  # noqa: ANN401 - the subclass' configuration
        """The configuration in force."""
        return self._settings.config

    @property
    def common(self) -> NodeConfig:
        """The part of it that each node has."""
        return self._settings.config

    @property
    def configuration(self) -> str:
        """The same by dotted names, as JSON."""
        return self._settings.to_json()

    @property
    def state(self) -> str:
        """State of the managed node: unconfigured, inactive, active or finalized."""
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

    def publish_on(self, kind: type[Any], topic: str, depth: int, *, latched: bool = False) -> Any:  # noqa: ANN401
        """Return a publisher that is mute unless the node is active."""
        qos = profile(self.common.output_reliability, depth)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        events = publisher_events(self.resolve_topic_name(topic), self._warn_of_qos)
        publisher = self.create_lifecycle_publisher(kind, topic, qos, event_callbacks=events)
        self._removing.append(lambda: self.destroy_lifecycle_publisher(publisher))
        self._topics["publishes"].append(publisher.topic_name)
        return publisher

    def listen_to(self, kind: type[Any], topic: str, callback: Callable[..., None], qos: QoSProfile) -> None:
        """Subscribe while the node is active."""
        events = subscription_events(self.resolve_topic_name(topic), self._warn_of_qos)
        subscription = self.create_subscription(kind, topic, callback, qos, event_callbacks=events)
        self._closing.append(lambda: self.destroy_subscription(subscription))
        self._topics["listens to"].append(subscription.topic_name)

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call something again and again while the node is active, by a clock that does not jump."""
        timer = self.create_timer(period_s, callback, clock=self._steady)
        self._closing.append(lambda: self.destroy_timer(timer))

    def offer(self, name: str, work: Callable[[], str], first: Callable[[], object] = lambda: None) -> None:
        """Offer a Trigger service whose work is done by the thread, after what waits there; others go on meanwhile.

        Args:
            name: Name of the service.
            work: Returns what to answer; an `SfrError` is answered as a failure.
            first: Done at once, in the executor's thread.
        """
        name = self.resolve_service_name(name)
        self._topics["offers"].append(name)
        if any(service.srv_name == name for service in self.services):
            return  # it stays for good: an answer may be on its way

        async def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            if self.state != "active":
                response.success, response.message = False, f"the node is {self.state}: activate it first"
                return response
            first()
            response.success, response.message = await self._ask(work)
            return response

        self.create_service(Trigger, name, serve, callback_group=self._service_group)

    def report_problem(self, text: str) -> None:
        """Say that something keeps the node from working: log, /diagnostics, health. May be called in any thread."""
        text = _short(text)
        self.get_logger().error(text, throttle_duration_sec=WARN_EVERY_S)
        self.health.problem(Level.ERROR, text)
        status = status_msg(f"{self._label}: input", Level.ERROR, text, {"task": self.task, **self.counts()})
        self.diagnostics.publish(array_msg(header_msg(self.get_clock().now().nanoseconds, ""), status))
        self.report_health(only_changes=True)

    def warn(self, text: str) -> None:
        """Say that something is not as it should be, though the node works. May be called in any thread."""
        text = _short(text)
        self.get_logger().warning(text, throttle_duration_sec=WARN_EVERY_S)
        self.health.problem(Level.WARN, text)
        self.report_health(only_changes=True)

    def report_health(self, *, only_changes: bool = False) -> None:
        """Publish the health. May be called in any thread."""
        waiting = self._worker.waiting if self._worker is not None else 0
        verdict = self.health.judge(self.state, self.counts(), waiting, expecting=self.expects_more())
        if only_changes and verdict.kind == self._last_health:
            return
        self._last_health = verdict.kind
        status = status_msg(f"{self._label}: health", verdict.level, verdict.message, verdict.values)
        self.diagnostics.publish(array_msg(header_msg(self.get_clock().now().nanoseconds, ""), status))

    # ---- states

    def start(self) -> None:
        """Become active, if `autostart` is on.

        Raises:
            SfrError: If that fails for a reason known.
        """
        if not self.common.autostart:
            self.get_logger().info("unconfigured: waits for a lifecycle manager")
            return
        self._starting = True
        try:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != SUCCESS and self._fault is not None:
                    raise self._fault
        finally:
            self._starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make what an inactive node has."""
        return self._step("configure", self._configure, undo=self._clean_up)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Receive and publish."""

        def activate() -> None:
            self.health.begin()
            super(ManagedNode, self).on_activate(state)
            self._activate()

        return self._step("activate", activate, undo=self._deactivate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Receive nothing more, finish what is under way, fall silent."""

        def deactivate() -> None:
            self._deactivate()
            super(ManagedNode, self).on_deactivate(state)
            self.get_logger().info("inactive")

        return self._step("deactivate", deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything back."""
        return self._step("cleanup", self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything back, from whatever state."""
        return self._step("shutdown", self._deactivate, self._clean_up)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything back after a transition that broke: the node can then be configured anew."""
        result = self._step("error", self._deactivate, self._clean_up)
        self.health.problem(Level.ERROR, f"a transition broke: {self._fault}")
        return result

    def destroy_node(self) -> None:
        """End the thread and leave the graph."""
        if self._worker is not None:
            self._worker.stop()
        super().destroy_node()

    def _step(
        self, name: str, *steps: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        try:
            for step in steps:
                step()
        except SfrError as error:
            if undo is not None:
                undo()
            return self._failed(name, error, FAILURE)
        except Exception as error:  # the state machine would swallow it without a word
            self.get_logger().error(traceback.format_exc())
            return self._failed(name, error, ERROR)
        return SUCCESS

    def _failed(self, name: str, error: Exception, result: TransitionCallbackReturn) -> TransitionCallbackReturn:
        self._fault = error
        if not self._starting:
            self.get_logger().error(f"{name} failed: {error}")
            self.health.problem(Level.ERROR, f"{name} failed: {error}")
        return result

    def _configure(self) -> None:
        self.get_logger().info(f"configuration {self.configuration}")
        self._worker = Worker(self.task, *self.queue_limits(), self._on_fault)
        self._configuration = self.publish_on(String, f"{self.task}/configuration", 1, latched=True)
        self.make()

    def _activate(self) -> None:
        self.listen()
        jump = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-JUMP_BACK_NS), on_clock_change=False)
        handle = self.get_clock().create_jump_callback(jump, post_callback=self._on_clock_back)
        self._closing.append(handle.unregister)
        parts = [f"{verb} {', '.join(names)}" for verb, names in self._topics.items()]
        self.get_logger().info("; ".join(parts))
        self._publish_configuration()

    def _deactivate(self) -> None:
        for close in self._closing:
            close()
        self._closing.clear()
        self._topics["listens to"].clear()
        self._topics["offers"].clear()
        if self._worker is not None:
            self._worker.clear()
            self._worker.wait_idle()
        self.health.begin()

    def _clean_up(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        for remove in self._removing:
            remove()
        self._removing.clear()
        self._topics["publishes"] = [self.diagnostics.topic_name]
        self.free()
        _give_memory_back()

    def _guard_transitions(self) -> None:
        """Let a transition that is not there from the present state be answered by failure: rclpy ends the node."""
        service = self._service_change_state
        change = service.callback

        def guarded(request: Any, response: Any) -> Any:  # noqa: ANN401 - lifecycle_msgs/ChangeState
            try:
                response = change(request, response)
            except rclpy_implementation.RCLError:
                response.success = False
            self.report_health(only_changes=True)
            return response

        service.callback = guarded

    # ---- what happens to it

    @property
    def _label(self) -> str:
        return str(self.get_fully_qualified_name()).lstrip("/")

    def _ask(self, work: Callable[[], str]) -> Future:
        """Let the thread do something and answer whether it succeeded and what it says."""
        executor = self.executor
        future = Future(executor=executor)
        future.add_done_callback(lambda _: executor.wake() if executor is not None else None)

        def job() -> None:
            answer = (False, f"{self.task} failed: see the log")
            try:
                answer = (True, work())
            except SfrError as error:
                answer = (False, str(error))
            finally:
                future.set_result(answer)

        self.worker.put(job)
        return future

    def _on_fault(self, error: Exception) -> None:
        """Survive what no one foresaw: say so, and begin anew."""
        if not self.context.ok():
            return  # a signal has shut ROS down while the thread worked: what it touched next failed
        self.get_logger().error("".join(traceback.format_exception(error)))
        self.report_problem(f"internal fault, {self.task} starts anew: {type(error).__name__}: {error}")
        self.restart_after_fault()

    def restart_after_fault(self) -> None:
        """Begin anew after an exception that was not foreseen; called in the thread."""

    def _on_clock_back(self, jump: TimeJump) -> None:
        self.clock_back()

    def _on_change(self, config: Any) -> None:  # noqa: ANN401 - the subclass' configuration
        self.get_logger().info(f"parameters have changed; configuration {self.configuration}")
        if self._worker is not None:
            self.adopt(config)
            self._publish_configuration()

    def _publish_configuration(self) -> None:
        self._configuration.publish(String(data=self.configuration))

    def _warn_of_qos(self, text: str) -> None:
        self.warn(text)
