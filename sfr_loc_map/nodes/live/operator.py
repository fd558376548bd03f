"""Carries out what an operator asks of the nodes: services of the nodes, bookmarks as messages."""

from __future__ import annotations

from threading import Event
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.live.commands import Action, Command

ANSWER_S = 10.0
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

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        client = self._node.create_client(kind, name)
        try:
            if not client.wait_for_service(timeout_sec=2.0):
                raise NodeError(f"no node offers {name}: is it running?")
            done = Event()
            future = client.call_async(request)
            future.add_done_callback(lambda _: done.set())
            if not done.wait(ANSWER_S):
                raise NodeError(f"{name} gave no answer within {ANSWER_S:g} s")
            return future.result()
        finally:
            self._node.destroy_client(client)
