"""Calls a service, and waits for its answer in the way of the caller."""

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
    """Return the answer of a service; NodeError if no node offers it in time, or it gives no answer in time.

    `wait` waits until a condition holds, for some seconds, and returns whether it holds.
    """
    client = node.create_client(kind, name)
    try:
        if not wait(client.service_is_ready, found_s):
            raise NodeError(f"no node offers {name}: is it running?")
        future = client.call_async(request)
        if not wait(future.done, answer_s):
            raise NodeError(f"{name} did not answer within {answer_s:g} s")
        return future.result()
    finally:
        node.destroy_client(client)
