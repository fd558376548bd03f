"""Messages as they are received: their order, latency and losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from sfr_loc_map.inputs import jumped_back

T = TypeVar("T")
COMPARABLE_NS = 60 * 1_000_000_000
"""Clocks that are further apart, or in the wrong order, cannot be compared (a recording that is played back, a host
whose clock is not set)."""
CLOCK_NOISE_NS = 1_000_000  # tolerance for the wrong order: clocks are read and rounded differently
LEAP_NS = 3600 * 1_000_000_000  #: A stamp that far ahead of the last one is of another clock.
AGREEING = 3  #: Stamps of another time in a row that are a new run.


class RunOrder(Generic[T]):
    """Assigns stamped items to runs; `late` and `strays` count those that are dropped.

    An item that is not newer than the last one is late. An item of another time, a second or more before the last one
    or an hour after it, is held. If as many such items as `agreeing` follow each other in the order of their stamps,
    they are accepted: before the last one a new run begins with them, after it the run goes on. If an item of the
    present time is added first, the held items are strays. A stamp of zero is no stamp.
    """

    def __init__(self, agreeing: int = AGREEING, *, keeps_late: bool = False) -> None:
        """Start before the first item; `keeps_late`: late items are accepted, as their order does not matter."""
        self.last_ns: int | None = None
        self.late = self.strays = 0
        self._agreeing, self._keeps_late = agreeing, keeps_late
        self._held: list[tuple[int, T]] = []

    def restart(self) -> None:
        """Forget the last stamp and what is held: the next item begins a run."""
        self.last_ns = None
        self._held.clear()

    def release(self) -> list[T]:
        """Restart, and return the held items: they are of the run that another source has begun."""
        held = [item for _, item in self._held]
        self.restart()
        return held

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Take an item; return the items that may be processed, in order, and whether a new run begins with them."""
        last_ns = self.last_ns
        if stamp_ns <= 0:
            self.strays += 1
            return [], False
        if last_ns is None or (last_ns < stamp_ns < last_ns + LEAP_NS):
            self.strays += len(self._held)
            self._held.clear()
            self.last_ns = stamp_ns
            return [item], False
        if (stamp_ns < last_ns and not jumped_back(last_ns, stamp_ns)) or stamp_ns == last_ns:
            self.late += 1
            return [item] if self._keeps_late else [], False
        if self._held and stamp_ns <= self._held[-1][0]:
            self.strays += len(self._held)
            self._held.clear()
        self._held.append((stamp_ns, item))
        if len(self._held) < self._agreeing:
            return [], False
        self.last_ns = stamp_ns
        items = [held for _, held in self._held]
        self._held.clear()
        return items, stamp_ns < last_ns


# ---- latency


def latencies(
    infos: Sequence[Mapping[str, Any]], stamp_ns: int, published_ns: int, node_time_ns: int
) -> dict[str, float]:
    """Return the latencies of one result of some messages, seconds, as far as their clocks can be compared.

    `infos` is what the middleware tells of each message: it gives 0 for times that it does not know.
    `latency_transport_s`: from the publisher's publish call to the receipt by the middleware, the slowest message;
    `latency_receive_to_publish_s`: from the receipt of the last message to the publication (system time), with the wait
    in queues; `latency_stamp_to_publish_s`: from the stamp to the same moment on the node's clock, which may be
    simulated.
    """

    def seconds(begin_ns: int, end_ns: int) -> float | None:
        passed = end_ns - begin_ns
        return max(passed, 0) * 1e-9 if -CLOCK_NOISE_NS <= passed <= COMPARABLE_NS else None

    found: dict[str, float | None] = {}
    sent, received = ([info.get(f"{name}_timestamp") or 0 for info in infos] for name in ("source", "received"))
    if all(received):
        known = [seconds(begin, end) for begin, end in zip(sent, received, strict=True) if begin]
        transports = [transport for transport in known if transport is not None]
        found["latency_transport_s"] = max(transports, default=None) if None not in known else None
        found["latency_receive_to_publish_s"] = seconds(max(received), published_ns)
    found["latency_stamp_to_publish_s"] = seconds(stamp_ns, node_time_ns)
    return {name: value for name, value in found.items() if value is not None}


# ---- losses


class TransportGaps:
    """Counts messages that were published but not received, for topics with one publisher at a time.

    A publisher numbers its messages from 1, so a lower number is a new publisher; its identity is not transmitted.
    `count` is that of the messages received, `lost` that of the missing ones so far.
    """

    def __init__(self) -> None:
        self.count = self.lost = self._last = 0
        self._several = False

    def add(self, info: dict[str, Any]) -> int:
        """Count the gap before a message, and return it."""
        number, last = int(info.get("publication_sequence_number") or 0), self._last
        self._last = number
        self.count += 1
        gap = number - last - 1 if last and number > last and not self._several else 0
        self.lost += gap
        return gap

    def set_several(self, several: bool) -> None:
        """Count no gaps while several publishers number their messages: nothing tells whose a number is."""
        if several and not self._several:
            self.lost = 0
        self._several = several
