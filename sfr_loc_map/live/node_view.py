"""What a node says of itself, and whether it still says anything."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sfr_loc_map.live.updates import Status, StatusKind

STALE_AFTER_S = 1.6
"""A node reports its health each second; one that has not for so long is stale,"""
STALE_PERIODS = 1.6
"""or for so many of its own periods, where they are longer."""
LEVELS = ("ok", "warning", "error", "stale")
MAX_VALUES = 100
MAX_LETTERS = 300
MAX_CALLS = 600
CALL_TIMES = (
    "processing_time_s",
    "conversion_s",
    "latency_transport_s",
    "latency_receive_to_publish_s",
    "latency_stamp_to_publish_s",
)
"""Times of a call that are drawn, each apart."""


@dataclass(frozen=True, slots=True)
class CallSample:
    """One call of a task.

    Attributes:
        n: Its number, from 0.
        node: The node.
        stamp_ns: Stamp of the pair.
        received_s: When it was received.
        state: Its result in words.
        times: Seconds by name, of `CALL_TIMES`.
        memory_bytes: Peak resident memory, None where it is not known.
    """

    n: int
    node: str
    stamp_ns: int
    received_s: float
    state: str
    times: Mapping[str, float]
    memory_bytes: int | None

    @classmethod
    def of(cls, n: int, status: Status) -> CallSample | None:
        """Return the call that a status describes, None where a number of it cannot be read."""
        values = status.values
        try:
            times = {name: float(values[name]) for name in CALL_TIMES if name in values}
            memory = int(values["peak_rss_bytes"]) if "peak_rss_bytes" in values else None
            stamp_ns = int(values["stamp_ns"])
        except (KeyError, ValueError):
            return None
        if not all(map(math.isfinite, times.values())):
            return None
        state = f"{values.get('state', '')} {values.get('reason', '')}".strip()[:MAX_LETTERS]
        return cls(n, status.node, stamp_ns, status.received_s, state, times, memory)

    def to_plain(self) -> dict[str, Any]:
        """Return it as JSON values; the stamp is a text, as it has more digits than a script's numbers hold."""
        return {
            "n": self.n,
            "node": self.node,
            "stamp_ns": str(self.stamp_ns),
            "received_s": self.received_s,
            "state": self.state,
            "memory_bytes": self.memory_bytes,
            **self.times,
        }


@dataclass(slots=True)
class NodeView:
    """One node.

    Attributes:
        name: Its name.
        health: Its last health, None before the first.
        state: Result of its last call in one word, with the reason; empty before the first.
        problem: Its last input that could not be used, None without.
        heard_s: When anything was last received from it.
        in_graph: Whether it is in the ROS graph, None where that is not known.
    """

    name: str
    health: Status | None = None
    state: str = ""
    problem: Status | None = None
    heard_s: float = 0.0
    in_graph: bool | None = None
    _periods: deque[float] = field(default_factory=lambda: deque(maxlen=5))

    def add(self, status: Status) -> None:
        """Take a status in."""
        if status.kind is StatusKind.HEALTH:
            if self.health is not None:
                self._periods.append(status.received_s - self.health.received_s)
            self.health = status
        elif status.kind is StatusKind.INPUT:
            self.problem = status
        else:
            self.state = status.message[:MAX_LETTERS]
        self.heard_s = max(self.heard_s, status.received_s)

    def is_stale(self, now_s: float) -> bool:
        """Tell whether it has been silent for too long."""
        period = statistics.median(self._periods) if len(self._periods) > 2 else 0.0
        return now_s - self.heard_s > max(STALE_AFTER_S, STALE_PERIODS * period)

    def to_plain(self, now_s: float) -> dict[str, Any]:
        """Return it as JSON values."""
        stale, health = self.is_stale(now_s), self.health
        level = "stale" if stale or health is None else LEVELS[min(max(health.level, 0), 3)]
        values = {} if health is None else dict(list(health.values.items())[:MAX_VALUES])
        problem = self.problem
        return {
            "name": self.name,
            "stale": stale,
            "age_s": round(max(now_s - self.heard_s, 0.0), 3) if self.heard_s else None,
            "level": level,
            "message": "" if health is None else health.message[:MAX_LETTERS],
            "lifecycle": values.get("lifecycle", "unknown"),
            "state": self.state,
            "in_graph": self.in_graph,
            "problem": None if problem is None else problem.message[:MAX_LETTERS],
            "values": {name[:MAX_LETTERS]: text[:MAX_LETTERS] for name, text in values.items()},
        }
