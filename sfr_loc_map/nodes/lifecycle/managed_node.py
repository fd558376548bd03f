"""A managed node with one configuration and a worker thread.

A managed node (design.ros2.org, "Managed nodes") is configured, activated, deactivated and cleaned up by a lifecycle
manager or by `ros2 lifecycle set`. With the parameter `autostart`, the node configures and activates itself. Contents
of the node in each state:

    unconfigured   parameters, and the health on /diagnostics
    inactive       + publishers, compiled code, the worker thread
    active         + subscriptions and timers; messages are received and published only in this state
"""

from __future__ import annotations

import gc
import json
import traceback
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, JumpThreshold, ROSClock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.configuration.parameters import build, flatten, parameters
from sfr_loc_map.errors import ConfigError, NodeError, SfrError
from sfr_loc_map.message_stamps import JUMP_BACK_NS, NS_PER_S
from sfr_loc_map.message_types import COMPILING, Level
from sfr_loc_map.nodes.lifecycle.diagnostics import DROPS, LOG_PERIOD_S, NodeSnapshot, NodeState, StatusReporter
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.lifecycle.parameters import AUTOSTART, BUILT_IN, NodeConfig, as_list, descriptor, is_near_miss
from sfr_loc_map.topics import configuration_topic
from sfr_loc_map.worker import Worker

C = TypeVar("C", bound=NodeConfig)
IN_PROGRESS = {
    "configure": "configuring",
    "activate": "activating",
    "deactivate": "deactivating",
    "cleanup": "cleaning up",
    "shutdown": "shutting down",
    "error": "processing an error",
}
"""State of a node during a transition, by the name of the transition."""
WAITING_REQUESTS = 1000
"""Queue depth of a service: requests wait for the worker, and the default of 10 overflows during a long job."""


class ManagedNode(LifecycleNode, Generic[C]):
    """A node that is configured, activated, deactivated and cleaned up.

    Its parameters form one configuration, which is replaced as a whole when live parameters change. A subclass
    overrides these methods, which are called in the executor's thread unless their docstrings state another thread:

    - states: `check_config`, `reset_state` and `setup` at a configuration, `subscribe` at an activation
    - events: `apply_config`, `clock_jumped_back`, `restart_after_fault`, `count_failed`
    - health: `expects_input`; `counts` and `report_periodically`, whose overrides must call `super()`

    Jobs given to `worker` are run in order in the worker's thread. Errors are reported by these routes:

    | error | level | counted | then |
    |---|---|---|---|
    | `SfrError` of a job, such as an unusable pair | ERROR, `NODE: input` | `count_failed`, if droppable | continues |
    | other exception of a job | ERROR, `NODE: fault` | `count_failed`, if droppable | `restart_after_fault` |
    | exception of a callback (`Endpoints.guarded`) | as for a job, in the worker's queue | no | as for a job |
    | `SfrError` of a service | none (text in the answer) | no | continues |
    | `SfrError` of a transition | ERROR, `NODE: health` | no | the previous state is restored |

    An optional message that is unusable, such as `initialpose`, is only a warning (`PairNode.ignoring_broken`). A pair
    that cannot be used before it is enqueued is reported and counted by `StereoInput`.
    """

    task: str  #: Task of the node; the default node name is `TASK_node`.
    config_type: type[C]  #: Dataclass of the parameters.
    foreign_parameters: tuple[str, ...] = ()  #: Parameters of other nodes in sections that this node also has.
    live_parameters: tuple[str, ...] = ()  #: Name prefixes of the parameters that may be set at any time.
    _worker: Worker | None = None

    def __init__(self, name: str = "", **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters as set by files and command line, create the state, and check the configuration.

        `options` are passed to `rclpy.node.Node`.
        """
        self.state: str = NodeState.UNCONFIGURED  # state, or transition in progress
        super().__init__(name or f"{self.task}_node", automatically_declare_parameters_from_overrides=True, **options)
        self._origin = f"parameters of {self.get_fully_qualified_name()}"
        self._infos = {info.name: info for info in parameters(self.config_type)}
        self.config: C = build(self.config_type, self._take_overrides(), origin=self._origin)
        for key, value in flatten(self.config).items():
            self.declare_parameter(key, as_list(value), descriptor(self._infos[key]), ignore_override=True)
        self._transition_error: Exception | None = None  # of the last failed transition; rclpy returns only a result
        self._counts_before: dict[str, int] = {}
        self._is_starting = False  # `start` raises the error of a failed transition, which is then not reported here
        self.status = StatusReporter(self, self.task, self.config.health, self._snapshot)
        self.endpoints = Endpoints(
            self, self.config.output_reliability, warn=self.status.warn, on_fault=self._on_callback_fault
        )
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self.endpoints.guarded(self._apply_parameters))
        publish_health = self.endpoints.guarded(self.status.publish_health)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._health_timer = self.create_timer(self.config.health.period_s, publish_health, clock=steady)
        self._service_group = MutuallyExclusiveCallbackGroup()
        self._answer_invalid_transitions()
        self.reset_state()
        self.check_config(self.config)

    # ---- what a subclass defines

    def check_config(self, config: C) -> None:
        """Raise an `SfrError` if values are inconsistent with each other."""

    def setup(self) -> None:
        """Create publishers, load compiled code and files."""

    def subscribe(self) -> None:
        """Create subscriptions, timers and services."""

    def reset_state(self) -> None:
        """Create the attributes of the subclass that depend on input or results, without input and results.

        Called by the constructor of this class, at each configuration before `setup`, and at each clean-up.
        """

    def clock_jumped_back(self) -> None:
        """Called when the clock was set back. A node whose runs depend on stamps alone ignores the event."""

    def apply_config(self, config: C) -> None:
        """Apply another configuration."""

    def expects_input(self) -> bool:
        """Return whether an active node expects input, and becomes stale without it; called in any thread."""
        return True

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages dropped since the configuration, by cause; called in any thread."""
        return {"dropped_overload": self._worker.dropped if self._worker is not None else 0}

    def report_periodically(self) -> None:
        """Log how many messages were dropped since the last call, and report topics that have several publishers.

        Called every `LOG_PERIOD_S` while the node is active.
        """
        counts, before = self.counts(), self._counts_before
        self._counts_before = counts
        for name, count in counts.items():
            if (more := count - before.get(name, 0)) > 0:
                why = DROPS.get(name, "were dropped")
                text = f"{more} messages in the last {LOG_PERIOD_S:g} s {why} ({name}: {count} in total)"
                self.get_logger().warning(text)
        if doubled := self.endpoints.doubled():
            names = "; ".join(f"{issue.where} has {issue.text}" for issue in doubled)
            self.status.warn(f"{names}: {doubled[0].fix}", "publishers")

    def restart_after_fault(self) -> None:
        """Restart after an unexpected exception; called in the worker's thread."""

    def count_failed(self) -> None:
        """Count a message that could not be processed; called in the worker's thread."""

    # ---- what a subclass uses

    def config_json(self) -> str:
        """Return the active configuration as a JSON object with dotted parameter names."""
        return json.dumps({name: as_list(value) for name, value in flatten(self.config).items()})

    @property
    def worker(self) -> Worker:
        """The worker; raises a `NodeError` if the node is not configured."""
        if self._worker is None:
            raise NodeError(f"{self.get_fully_qualified_name()} is {self.state}: configure it first")
        return self._worker

    def load_kernels(self, *parts: str) -> None:
        """Load compiled code before the first call; report the progress of a compilation in log and health."""
        from sfr_loc_map.kernels import load_kernels  # imports numba, which the monitor does not need

        def say(line: str) -> None:
            self.get_logger().info(line)
            self.status.set_activity(COMPILING)
            self.status.note_problem(Level.WARN, line, COMPILING)
            self.status.publish_health()

        try:
            for part in parts:
                load_kernels(part, say, self.context.ok)
        finally:
            self.status.set_activity("")

    def add_service(self, name: str, work: Callable[[], str], first: Callable[[], object] = lambda: None) -> None:
        """Offer a Trigger service of the active node: `first` is called immediately, `work` in the worker's queue.

        The executor continues with other callbacks while the request waits for the worker. A service is never
        destroyed, because an answer may be pending.
        """
        name = self.resolve_service_name(name)
        if any(service.srv_name == name for service in self.services):
            return

        async def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            if self.state != NodeState.ACTIVE:
                response.message = f"the node is {self.state}: activate it first"
                return response
            response.message = f"{self.task} failed: see the log"
            try:
                first()
            except Exception as error:
                self._on_callback_fault(error)
                return response
            executor = self.executor
            future = Future(executor=executor)
            future.add_done_callback(lambda _: executor.wake() if executor is not None else None)

            def job() -> None:
                try:
                    response.message = work()
                    response.success = True
                except SfrError as error:
                    response.message = str(error)
                finally:
                    future.set_result(response)

            self.worker.enqueue(job)
            return await future

        qos = QoSProfile(depth=WAITING_REQUESTS)
        self.create_service(Trigger, name, serve, qos_profile=qos, callback_group=self._service_group)

    # ---- transitions

    def start(self) -> None:
        """Configure and activate the node if `autostart` is true."""
        if not self.config.autostart:
            self.get_logger().info("unconfigured: waiting for a lifecycle manager")
            return
        self._is_starting = True
        try:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != TransitionCallbackReturn.SUCCESS and self._transition_error is not None:
                    raise self._transition_error
        finally:
            self._is_starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and the worker."""
        return self._run("configure", NodeState.INACTIVE, self._configure, undo=self._clean_up)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to receive and publish."""
        enable, disable = super().on_activate, super().on_deactivate

        def undo() -> None:
            self._deactivate()
            disable(state)

        return self._run("activate", NodeState.ACTIVE, lambda: enable(state), self._activate, undo=undo)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop receiving, finish the running job, stop publishing."""
        disable = super().on_deactivate
        say = self.get_logger().info
        return self._run(
            "deactivate", NodeState.INACTIVE, self._deactivate, lambda: disable(state), lambda: say(NodeState.INACTIVE)
        )

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything."""
        return self._run("cleanup", NodeState.UNCONFIGURED, self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything, from any state."""
        return self._run("shutdown", NodeState.FINALIZED, self._deactivate, self._clean_up)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything after a transition that raised an exception, so that the node can be configured again."""
        cause = self._transition_error
        result = self._run("error", NodeState.UNCONFIGURED, self._deactivate, self._clean_up)
        self.status.note_problem(Level.ERROR, f"a transition failed with an exception: {cause}")
        return result

    def destroy_node(self) -> None:
        """End the worker's thread and leave the graph."""
        if self._worker is not None:
            self._worker.stop()
        super().destroy_node()

    def _run(
        self, name: str, goal: str, *steps: Callable[[], object], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        """Run the steps of a transition; `undo` restores the previous state after an SfrError."""
        before, self.state = self.state, IN_PROGRESS[name]
        try:
            for step in steps:
                step()
            self.state = goal
            return TransitionCallbackReturn.SUCCESS
        except SfrError as error:
            if undo is not None:
                undo()
            self.state = before
            self._transition_error = error
            outcome = TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy's state machine would discard the exception
            self._log_error(traceback.format_exc())
            self._transition_error = error
            outcome = TransitionCallbackReturn.ERROR
        if not self._is_starting:
            text = f"{name} failed: {self._transition_error}"
            self._log_error(text)
            self.status.note_problem(Level.ERROR, text)
        return outcome

    def _configure(self) -> None:
        self.check_config(self.config)  # once more, because a file that it names may have been removed
        self.get_logger().info(f"configuration {self.config_json()}")
        self.reset_state()  # uses the parameters that were set since the last reset
        self._worker = Worker(self.task, *self.config.queue(), self._on_fault)
        self._config_publisher = self.endpoints.add_publisher(String, configuration_topic(self.task), 1, latched=True)
        self.setup()

    def _activate(self) -> None:
        self.status.reset()
        self.subscribe()
        jump = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-JUMP_BACK_NS), on_clock_change=False)
        jumped = self.endpoints.guarded(lambda _: self.clock_jumped_back())
        handle = self.get_clock().create_jump_callback(jump, post_callback=jumped)
        self.endpoints.active.callback(handle.unregister)
        self._log_endpoints()
        self._publish_config()
        self._counts_before = self.counts()
        self.endpoints.add_timer(LOG_PERIOD_S, self.report_periodically)

    def _log_endpoints(self) -> None:
        subscribed = ", ".join(subscription.topic_name for subscription in self.subscriptions)
        outputs = [publisher.topic_name for publisher in self.publishers if isinstance(publisher, LifecyclePublisher)]
        offered = ", ".join(service.srv_name for service in self.services if service.srv_type is Trigger)
        published = ", ".join([self.status.publisher.topic_name, *outputs])
        self.get_logger().info(f"subscribes to {subscribed}; publishes {published}; offers {offered}")

    def _deactivate(self) -> None:
        self.endpoints.active.close()
        if self._worker is not None:
            self._worker.clear()
            self._worker.wait_idle()
        self.status.reset()

    def _clean_up(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        self.endpoints.configured.close()
        self.reset_state()
        gc.collect()  # images and clouds held by reference cycles

    def _answer_invalid_transitions(self) -> None:
        """Reject requests for a transition that is invalid in the present state; rclpy would end the node."""
        (service,) = (service for service in self.services if service.srv_type is ChangeState)
        change = service.callback

        def guarded(request: Any, response: Any) -> Any:  # noqa: ANN401 - lifecycle_msgs/ChangeState
            try:
                response = change(request, response)
            except Exception:  # rclpy has no public exception class for this; transitions themselves do not raise
                response.success = False
            self.endpoints.guarded(lambda: self.status.publish_health(only_changes=True))()
            return response

        service.callback = guarded

    # ---- events

    def _snapshot(self) -> NodeSnapshot:
        waiting = self._worker.waiting if self._worker is not None else 0
        found: list[tuple[Level, str]] = []
        if self.get_node_names_and_namespaces().count((self.get_name(), self.get_namespace())) > 1:
            text = (
                f"another node named {self.get_fully_qualified_name()} publishes in this ROS domain: end one of the "
                f"two nodes, or start one in another namespace (a killed node stays visible for up to 20 s)"
            )
            found.append((Level.WARN, text))
        clock = self.get_clock()
        if isinstance(clock, ROSClock) and clock.ros_time_is_active and not clock.now().nanoseconds:
            found.append((Level.WARN, "use_sim_time is on but nothing was received on /clock: the node's time is 0"))
        return NodeSnapshot(self.state, self.counts(), waiting, self.expects_input(), found)

    def _on_fault(self, error: Exception, was_message: bool) -> None:
        """Report an exception of a job: an SfrError in one line, any other exception with its traceback."""
        if not self.context.ok():
            return  # A signal shut ROS down during the job, so the job's next call to ROS failed.
        if was_message:
            self.count_failed()
        if isinstance(error, SfrError):
            self.status.error(str(error))
            return
        self._report_fault(error)
        self.restart_after_fault()

    def _on_callback_fault(self, error: Exception) -> None:
        """Report an exception of the executor's thread like that of a job; immediately if there is no worker."""
        if self._worker is None:
            self._report_fault(error)
        else:
            self._worker.enqueue(lambda: self._on_fault(error, False))

    def _report_fault(self, error: Exception) -> None:
        self.get_logger().error("".join(traceback.format_exception(error)))
        self.status.fault(f"internal fault, {self.task} continues: {type(error).__name__}: {error}")

    # ---- parameters

    def _take_overrides(self) -> dict[str, Any]:
        """Return the values that files and command line give for this node; the parameters are declared later.

        Unknown names are ignored, because a parameter file may serve several nodes. Names that resemble a parameter of
        this node are returned, so that they are refused as misspelt.
        """
        sim_time = self.get_parameter("use_sim_time").value
        if not isinstance(sim_time, bool):  # ROS would ignore the value
            raise ConfigError(f"{self._origin}: 'use_sim_time' is {sim_time!r}: true or false is required")
        given: dict[str, Any] = {}
        for parameter in self.get_parameters(list(self.get_parameters_by_prefix(""))):
            name = parameter.name
            if name.startswith(BUILT_IN):
                continue
            self.undeclare_parameter(name)
            if name in self._infos or (name not in self.foreign_parameters and is_near_miss(name, self._infos)):
                given[name] = as_list(parameter.value)
            else:
                self.get_logger().info(f"this node has no parameter '{name}': ignored")
        return given

    def _with(self, changes: Sequence[Parameter]) -> C:
        values = flatten(self.config) | {p.name: as_list(p.value) for p in changes if p.name in self._infos}
        return build(self.config_type, values, origin=self._origin)

    def _check_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """Accept or refuse changed parameters as one set."""
        now = flatten(self.config)
        differing = [c.name for c in changes if c.name in self._infos and as_list(now[c.name]) != as_list(c.value)]
        held = sorted(name for name in differing if not name.startswith(self.live_parameters))
        if AUTOSTART in held:
            return SetParametersResult(successful=False, reason=f"'{AUTOSTART}' is read-only: it is read at the start")
        if held and self.state != NodeState.UNCONFIGURED:
            reason = f"'{held[0]}' is read-only while the node is {self.state}: deactivate and clean up the node first"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self.check_config(self._with(changes))
        except SfrError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        except Exception as error:
            self._report_fault(error)
            return SetParametersResult(successful=False, reason=f"internal fault: {type(error).__name__}: {error}")
        return SetParametersResult(successful=True)

    def _apply_parameters(self, changes: list[Parameter]) -> None:
        """Apply accepted parameters."""
        config = self._with(changes)
        if config == self.config:
            return
        self.config = config
        self.get_logger().info(f"parameters have changed; configuration {self.config_json()}")
        self.endpoints.reliability = config.output_reliability
        self.status.set_config(config.health)
        self._health_timer.timer_period_ns = round(config.health.period_s * NS_PER_S)
        if self._worker is not None:
            self.apply_config(config)
            self._publish_config()

    def _publish_config(self) -> None:
        self._config_publisher.publish(String(data=self.config_json()))

    def _log_error(self, text: str) -> None:
        if self.context.ok():  # otherwise the transition failed because a signal has shut ROS down
            self.get_logger().error(text)
