"""Outcomes of lifecycle transitions: what rclpy would swallow is logged, and what it would die of is answered."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from sfr_loc_map.errors import SfrError

SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


@dataclass(slots=True)
class Transitions:
    """Runs the steps of transitions.

    Attributes:
        report: Called with what failed.
        log_error: Called with the traceback of an error that was not foreseen.
        last_error: Of the last transition that failed.
        quiet: Whether a failure is left to the caller to report.
    """

    report: Callable[[str], None]
    log_error: Callable[[str], None]
    last_error: Exception | None = None
    quiet: bool = False

    def run(
        self, name: str, *steps: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        """Run steps and return the outcome.

        Args:
            name: Name of the transition.
            steps: Called in order.
            undo: Called when a step fails for a known reason: the node is then in the state before.
        """
        try:
            for step in steps:
                step()
        except SfrError as error:
            if undo is not None:
                undo()
            return self._failed(name, error, FAILURE)
        except Exception as error:  # rclpy's state machine would swallow it
            self.log_error(traceback.format_exc())
            return self._failed(name, error, ERROR)
        return SUCCESS

    def _failed(self, name: str, error: Exception, outcome: TransitionCallbackReturn) -> TransitionCallbackReturn:
        self.last_error = error
        if not self.quiet:
            self.report(f"{name} failed: {error}")
        return outcome


def answer_invalid_transitions(node: LifecycleNode, after: Callable[[], None]) -> None:
    """Answer requests for a transition that the present state does not have by failure: rclpy would end the node.

    Args:
        node: The node.
        after: Called after each request.
    """
    service = node._service_change_state
    change = service.callback

    def guarded(request: Any, response: Any) -> Any:  # noqa: ANN401 - lifecycle_msgs/ChangeState
        try:
            response = change(request, response)
        except rclpy_implementation.RCLError:
            response.success = False
        after()
        return response

    service.callback = guarded
