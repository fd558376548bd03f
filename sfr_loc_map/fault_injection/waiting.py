"""Waiting for conditions that other processes bring about."""

from __future__ import annotations

import time
from collections.abc import Callable

from sfr_loc_map.errors import NodeError

POLL_S = 0.005


def wait_until(condition: Callable[[], object], what: str, timeout_s: float) -> float:
    """Wait until a condition holds; return how long that took, seconds.

    Raises:
        NodeError: If it takes too long.
    """
    begin = time.monotonic()
    while not condition():
        if time.monotonic() - begin > timeout_s:
            raise NodeError(f"no {what} within {timeout_s:g} s")
        time.sleep(POLL_S)
    return time.monotonic() - begin
