"""Execute the operator's commands from the live page: lifecycle transitions, services, bookmarks."""

from __future__ import annotations

import time
from collections.abc import Callable
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
from sfr_loc_map.live.commands import SERVICES, Action, Command
from sfr_loc_map.ros.services import call_service
from sfr_loc_map.suite_names import SUITE_NODES
from sfr_loc_map.topics import BOOKMARK

TRANSITION_IDS = {Action.ACTIVATE: Transition.TRANSITION_ACTIVATE, Action.DEACTIVATE: Transition.TRANSITION_DEACTIVATE}
FOUND_S, ANSWER_S, POLL_S = 2.0, 10.0, 0.02
"""Time to find a service, time to wait for its answer, and period at which both are checked, s."""


class NodeOperator:
    """Calls services of the suite's nodes through a ROS node in their namespace, which another thread spins."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._closed = Event()
        # Created here, so that a running recording has discovered the publisher before the first bookmark.
        events = PublisherEventCallbacks(use_default_callbacks=False)
        self._bookmarks = node.create_publisher(String, BOOKMARK, QoSProfile(depth=100), event_callbacks=events)

    def run(self, command: Command) -> str:
        """Execute a command, which may take seconds, and return a text about the result.

        An SfrError is raised if the command fails. This method must not be called in the executor's thread.
        """
        node, action = command.node, command.action
        if action is Action.BOOKMARK:
            self._bookmarks.publish(String(data=command.text or "bookmark"))
            return "bookmark published"
        if action in TRANSITION_IDS and node in SUITE_NODES:
            request = ChangeState.Request(transition=Transition(id=TRANSITION_IDS[action]))
            if not self._call(ChangeState, f"{node}/change_state", request).success:
                raise NodeError(f"{node} refuses to {action}: see its log")
            return f"{node}: {action} done"
        if node in SERVICES.get(action, ()):
            answer = self._call(Trigger, f"{node}/{action}", Trigger.Request())
            if not answer.success:
                raise NodeError(f"{node}: {answer.message}")
            return f"{node}: {answer.message}"
        raise InputError(f"node '{node}' does not offer the action '{action}'")

    def close(self) -> None:
        """Cancel pending calls, so that their threads end before the node is destroyed."""
        self._closed.set()

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        return call_service(self._node, kind, name, request, wait=self._wait, found_s=FOUND_S, answer_s=ANSWER_S)

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not (is_met := condition()) and time.monotonic() < deadline:
            if self._closed.wait(POLL_S):
                raise NodeError("the live page was closed before the call was completed")
        return is_met
