"""The peer of a replay, which waits for the supervised nodes and calls their services."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

from sfr_loc_map.errors import NodeError
from sfr_loc_map.live.page_process import PageProcess, connected_nodes_topic
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.peer import Peer
from sfr_loc_map.ros.processes import Supervisor
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.ros.services import call_service
from sfr_loc_map.suite_names import MONITOR_NODE, PLAYER_NODE, Task
from sfr_loc_map.topics import RESULTS, TRUE_POSES, call_topic

ANSWER_TIMEOUT_S = 120.0  #: Timeout of an answer of a node, s. A fusion takes seconds, on a slow host up to a minute.
SETTLE_S = 0.3  #: Time for the nodes to discover each other after this node has discovered all nodes.
START_TIMEOUT_S = 300.0  #: Long, because the first start after an installation compiles the kernels.


class ReplayPeer(Peer):
    """A peer whose waits raise a NodeError as soon as a supervised node ends; a context manager."""

    def __init__(self, supervisor: Supervisor) -> None:
        super().__init__(PLAYER_NODE, parameters=True)
        self.supervisor = supervisor

    def wait_for(
        self,
        condition: Callable[[], bool],
        timeout_s: float,
        problem: Callable[[], str],
        advice: str = "check the load of this host and start again",
    ) -> None:
        """Spin until a condition holds; after the timeout, raise a NodeError with `problem` and the advice."""

        def is_met() -> bool:
            # First, because messages of another process's nodes with these names may be the reason why the condition is
            # not met
            self._refuse_others()
            if condition():
                return True
            self.supervisor.check()
            return False

        if not self.spin(timeout_s, is_met):
            place = f"in ROS domain {environment.domain()}"
            raise NodeError(f"{problem()} within {timeout_s:g} s {place}: {advice}")

    def wait_for_page(self, page: PageProcess) -> bool:
        """Wait until the live page receives all messages of the nodes, or has ended; return False after the timeout."""
        connected = set[str]()

        def add_connected(message: String) -> None:
            connected.update(message.data.split())

        topic = connected_nodes_topic(page.node_name)
        subscription = self.ros_node.create_subscription(String, topic, add_connected, LATCHED)

        def is_over() -> bool:
            self.supervisor.check()
            return not page.is_running or (connected >= self.supervisor.processes.keys() and self._sees_page(page))

        try:
            return self.spin(START_TIMEOUT_S, is_over)
        finally:
            self.ros_node.destroy_subscription(subscription)

    def _sees_page(self, page: PageProcess) -> bool:
        """Return whether this node has discovered the page's subscription to the true poses, which the player sends."""
        found = self.ros_node.get_subscriptions_info_by_topic(TRUE_POSES)
        return any(item.node_name == page.node_name for item in found)

    def spin_for(self, seconds: float) -> None:
        """Spin for a given time, then check the nodes."""
        self.spin(seconds)
        self.supervisor.check()

    def request(self, kind: type[Any], service: str, request: Any, problem: str) -> Any:  # noqa: ANN401 - any service
        """Call a service and return its answer."""

        def wait(condition: Callable[[], bool], seconds: float) -> bool:
            self.wait_for(condition, seconds, lambda: problem)
            return True

        bounds = {"found_s": ANSWER_TIMEOUT_S, "answer_s": ANSWER_TIMEOUT_S}
        return call_service(self.ros_node, kind, service, request, wait=wait, **bounds)

    def wait_for_discovery(self) -> None:
        """Wait until the nodes have discovered the endpoints of this node, and until the monitor subscribes to results.

        A node that answers a service call has discovered this node: endpoints are announced in the order of their
        creation, and the client of the call is created last.
        """
        for name in self.supervisor.processes:
            problem = f"{name} did not answer"
            self.request(ListParameters, f"{name}/list_parameters", ListParameters.Request(), problem)

        def monitor_listens() -> bool:
            tasks = [task for task in Task if task.node in self.supervisor.processes]
            topics = [topic for task in tasks for topic in (RESULTS[task], call_topic(task))]
            receivers = map(self.ros_node.get_subscriptions_info_by_topic, topics)
            return all(any(found.node_name == MONITOR_NODE for found in of_topic) for of_topic in receivers)

        self.wait_for(monitor_listens, ANSWER_TIMEOUT_S, lambda: "monitor_node did not subscribe to the results")
        self.spin_for(SETTLE_S)

    def _refuse_others(self) -> None:
        """Raise a NodeError if a node of another process has the name of a node of this replay."""
        found = self.ros_node.get_node_names_and_namespaces()
        for name in (PLAYER_NODE, *self.supervisor.processes):
            if found.count((name, self.ros_node.get_namespace())) > 1:
                raise NodeError(
                    f"another {name} is in ROS domain {environment.domain()} and would interfere: "
                    f"unset ROS_DOMAIN_ID, so that the replay uses its own domain, or end that node (a killed node "
                    f"stays visible for 20 s)"
                )
