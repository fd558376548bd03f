"""The last calls of the nodes, numbered so that a page is sent each call once."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from sfr_loc_map.live.node_reports import state_after
from sfr_loc_map.live.updates import NodeCall

MAX_CALLS = 600  #: Maximum number of kept calls; the oldest are dropped.
TIMES = ("processing_time_s", "latency_transport_s", "latency_receive_to_publish_s")  #: Displayed times.


@dataclass(frozen=True, slots=True)
class NumberedCall:
    """A call with its number."""

    n: int
    call: NodeCall

    def to_plain(self) -> dict[str, Any]:
        """Return the call as JSON values."""
        call = self.call
        record = call.record
        times = {"processing_time_s": record.processing_time_s, **record.times}
        known = {name: value for name in TIMES if (value := times.get(name)) is not None and math.isfinite(value)}
        about = {"n": self.n, "node": call.node, "stamp_ns": str(record.stamp_ns), "received_s": call.received_s}
        return about | asdict(state_after(record)) | {"memory_bytes": record.peak_rss_bytes, **known}


class CallLog:
    """Keeps the last calls of the present run."""

    def __init__(self) -> None:
        self.end = 0  #: Number of the next call.
        self._calls: deque[NumberedCall] = deque(maxlen=MAX_CALLS)

    def __len__(self) -> int:
        return len(self._calls)

    def __iter__(self) -> Iterator[NumberedCall]:
        return iter(self._calls)

    @property
    def first(self) -> int:
        """Number of the first kept call."""
        return self.end - len(self._calls)

    @property
    def last_by_node(self) -> dict[str, NumberedCall]:
        """The last call of each node."""
        return {item.call.node: item for item in self._calls}

    @property
    def last_received_s(self) -> float | None:
        """When the last call was received, s; None without a call."""
        return self._calls[-1].call.received_s if self._calls else None

    def add(self, call: NodeCall) -> None:
        """Add a call."""
        self._calls.append(NumberedCall(self.end, call))
        self.end += 1

    def forget_before(self, received_s: float) -> None:
        """Forget the calls that were received before a time, s, which are those of the previous run."""
        while self._calls and self._calls[0].call.received_s < received_s:
            self._calls.popleft()
