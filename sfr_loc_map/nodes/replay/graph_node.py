"""The ROS node of a replay: joins the graph, waits while it watches the nodes, calls their services."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable

from rclpy.client import Client
from std_srvs.srv import Trigger

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.peer import POLL_S, Peer
from sfr_loc_map.nodes.processes import LivePage, Supervisor

NAME = "sfr_player"
ANSWER_TIMEOUT_S = 120.0
CONNECT_TIMEOUT_S = 3.0  #: A subscriber of another quality of service is never reached.
PAGE_TIMEOUT_S = 30.0
PAGE_TOPICS = ("localisation/odometry", "ground_truth/odometry", "metrics/report")
"""Topics that a page receives whatever it shows."""


class ReplayNode(Peer):
    """A ROS node whose waiting fails (`NodeError`) as soon as a supervised node ends; a context manager."""

    def __init__(self, supervisor: Supervisor) -> None:
        super().__init__(NAME, parameters=True)
        self.supervisor = supervisor

    def wait_for(self, condition: Callable[[], bool], timeout_s: float, problem: Callable[[], str]) -> None:
        """Spin until a condition holds, for a limited time; `problem` says what did not happen."""
        deadline = time.monotonic() + timeout_s
        while True:
            self._refuse_others()  # first: what they publish may be what the condition fails of
            if condition():
                return
            self.supervisor.check()
            if time.monotonic() > deadline:
                raise NodeError(f"{problem()} within {timeout_s:g} s: look at the load of this host and start again")
            self.executor.spin_once(timeout_sec=POLL_S)

    def wait_for_page(self, page: LivePage) -> bool:
        """Wait, for a limited time, until a page receives what is played; return whether it does or has ended."""

        def settled() -> bool:
            self.supervisor.check()
            name, receivers = page.node_name, map(self.node.get_subscriptions_info_by_topic, PAGE_TOPICS)
            return not name or all(any(found.node_name == name for found in of_topic) for of_topic in receivers)

        return self.spin(PAGE_TIMEOUT_S, settled)

    def spin_for(self, seconds: float) -> None:
        """Spin for some time."""
        self.spin(seconds)
        self.supervisor.check()

    def call(self, client: Client, problem: str) -> str:
        """Call a Trigger service, wait for its answer and return its text."""
        self.wait_for(client.service_is_ready, ANSWER_TIMEOUT_S, lambda: problem)
        future = client.call_async(Trigger.Request())
        self.wait_for(future.done, ANSWER_TIMEOUT_S, lambda: problem)
        return str(future.result().message)

    def wait_for_connections(self) -> None:
        """Wait, for a limited time, until each node reaches all subscribers of its topics that this node sees."""
        clients = [self.node.create_client(Trigger, f"{name}/connections") for name in self.supervisor.processes]
        deadline = time.monotonic() + CONNECT_TIMEOUT_S

        def reaches_all(client: Client) -> bool:
            reached = json.loads(self.call(client, f"{client.srv_name} did not answer"))
            return all(count >= self.node.count_subscribers(topic) for topic, count in reached.items())

        while not all(map(reaches_all, clients)) and time.monotonic() < deadline:
            self.spin_for(POLL_S)

    def _refuse_others(self) -> None:
        """Make sure that no other program has nodes that would take part."""
        found = self.node.get_node_names_and_namespaces()
        for name in (NAME, *self.supervisor.processes):
            if found.count((name, self.node.get_namespace())) > 1:
                raise NodeError(
                    f"another {name} is in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0} and would take part: "
                    f"unset ROS_DOMAIN_ID, and the replay takes a domain of its own; or end it (a killed one shows for "
                    f"20 s)"
                )
