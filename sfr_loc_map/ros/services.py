"""Call a service, and wait for its answer with a function of the caller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from sfr_loc_map.errors import NodeError


def call_service(
    node: Node,
    kind: type[Any],
    name: str,
    request: Any,  # noqa: ANN401 - any service
    *,
    wait: Callable[[Callable[[], bool], float], bool],
    found_s: float,
    answer_s: float,
) -> Any:  # noqa: ANN401 - any service
    """Return the answer of a service; raise a NodeError if the service is not offered or does not answer in time.

    `wait` waits until a condition holds, at most for a number of seconds, and returns whether the condition holds.
    """
    client = node.create_client(kind, name)
    try:
        if not wait(client.service_is_ready, found_s):
            raise NodeError(f"service {name} is not available: start the node that offers it")
        future = client.call_async(request)
        if not wait(future.done, answer_s):
            raise NodeError(f"{name} did not answer within {answer_s:g} s")
        return future.result()
    finally:
        node.destroy_client(client)
