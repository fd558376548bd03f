"""Carries out what an operator asks of the nodes: services of the nodes, bookmarks as messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Condition, Event
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.live.hub import Action, Command

FOUND_S, ANSWER_S = 2.0, 10.0
POLL_S = 0.02
BOOKMARK_TOPIC = "bookmark"
TRANSITIONS = {
    Action.ACTIVATE: Transition.TRANSITION_ACTIVATE,
    Action.DEACTIVATE: Transition.TRANSITION_DEACTIVATE,
}
SERVICES = {
    Action.RESET: ("localisation_node", "mapping_node", "monitor_node"),
    Action.FINISH: ("mapping_node",),
    Action.SAVE: ("monitor_node",),
}
"""Nodes that offer each service."""


class RosOperator:
    """Calls services of the nodes. `run` may be called in any thread but that of the executor."""

    actions = frozenset({*TRANSITIONS, *SERVICES, Action.BOOKMARK})

    def __init__(self, node: Node) -> None:
        """Advertise the bookmarks, so that a recording under way finds them.

        Args:
            node: Calls the services; another thread spins it.
        """
        self._node = node
        self._closed, self._changed, self._under_way = Event(), Condition(), 0
        events = PublisherEventCallbacks(use_default_callbacks=False)
        self._bookmarks = node.create_publisher(String, BOOKMARK_TOPIC, QoSProfile(depth=100), event_callbacks=events)

    def run(self, command: Command) -> str:
        """Carry a command out.

        Raises:
            InputError: If the node does not have what is asked of it.
            NodeError: If the node does not answer, or refuses.
        """
        if command.action is Action.BOOKMARK:
            self._bookmarks.publish(String(data=command.text or "bookmark"))
            return "bookmark published"
        if command.action in TRANSITIONS and command.node in SERVICES[Action.RESET]:
            request = ChangeState.Request(transition=Transition(id=TRANSITIONS[command.action]))
            answer = self._call(ChangeState, f"{command.node}/change_state", request)
            if not answer.success:
                raise NodeError(f"{command.node} refuses to {command.action}: see its log")
            return f"{command.node}: {command.action} done"
        if command.node in SERVICES.get(command.action, ()):
            answer = self._call(Trigger, f"{command.node}/{command.action}", Trigger.Request())
            if not answer.success:
                raise NodeError(f"{command.node}: {answer.message}")
            return f"{command.node}: {answer.message}"
        raise InputError(f"'{command.node}' has no '{command.action}'")

    def close(self) -> None:
        """Give up what is under way, before the node is destroyed."""
        self._closed.set()
        with self._changed:
            self._changed.wait_for(lambda: not self._under_way, FOUND_S)

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        with self._changed:
            self._under_way += 1
        try:
            return self._answer(kind, name, request)
        finally:
            with self._changed:
                self._under_way -= 1
                self._changed.notify_all()

    def _answer(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        self._check_open()
        client = self._node.create_client(kind, name)
        try:
            if not self._wait(client.service_is_ready, FOUND_S):
                raise NodeError(f"no node offers {name}: is it running?")
            future = client.call_async(request)
            if not self._wait(future.done, ANSWER_S):
                raise NodeError(f"{name} gave no answer within {ANSWER_S:g} s")
            return future.result()
        finally:
            self._node.destroy_client(client)

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() >= deadline:
                return False
            self._closed.wait(POLL_S)
            self._check_open()
        return True

    def _check_open(self) -> None:
        if self._closed.is_set():
            raise NodeError("the page has ended")
