"""Latency and losses of messages in transport from a publisher."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from typing import Any

from sfr_loc_map.transport_issues import COMPARABLE_NS

CLOCK_NOISE_NS = 1_000_000  # tolerance for negative latencies, because clocks are read and rounded differently


def latencies(
    infos: Sequence[Mapping[str, Any]], stamp_ns: int, published_ns: int, node_time_ns: int
) -> dict[str, float]:
    """Return the latencies of a result that was computed from messages, s; those between unrelated clocks are omitted.

    `infos` are the message infos of the middleware, in which unknown times are 0.
    `latency_transport_s`: from the publish call of the publisher to the reception by the middleware, of the slowest
    message. `latency_receive_to_publish_s`: from the reception of the last message to the publication of the result
    (system time), including the wait in queues. `latency_stamp_to_publish_s`: from the stamp to the publication, on the
    node's clock, which may be simulated.
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


UNSUPPORTED = 2**64 - 1  #: Sequence number of a middleware without sequence numbers (rmw/types.h); 0 here.


class TransportGaps:
    """Counts messages that were published but not received, for topics with one publisher at a time.

    A publisher numbers its messages from 1. A lower number therefore indicates a new publisher, whose identity is not
    transmitted. `count` is the number of received messages, `lost` the number of missing messages, `before` the
    number of messages that were published before the first received message, and `returns` the number of messages whose
    number does not exceed that of the previous message: 1 for each new publisher, many if publishers alternate.
    """

    def __init__(self) -> None:
        self.count = self.lost = self.before = self.returns = self._last = 0
        self._previous = 0  # number of the previous message, even if no gap to this message is counted
        self._several = False
        self._lost_of_one = 0  # losses until the last time that there was one publisher

    def begin_subscription(self) -> None:
        """Begin another subscription: messages published before its first message are not missing."""
        self._last = 0

    def add(self, info: dict[str, Any]) -> int:
        """Add the message info of a message; return the number of messages missing before that message."""
        number, last = int(info.get("publication_sequence_number") or 0) % UNSUPPORTED, self._last
        self._last = number
        if not self.count:
            self.before = max(number - 1, 0)
        self.count += 1
        self.returns += 0 < number <= self._previous
        self._previous = number
        gap = number - last - 1 if last and number > last and not self._several else 0
        self.lost += gap
        return gap

    def set_several(self, several: bool) -> None:
        """Disable the count of gaps while there are several publishers, because a number may belong to any of them.

        When a second publisher is found, the gaps since the last call are not counted either, because that publisher
        may have appeared before these gaps.
        """
        if several and not self._several:
            self.lost = self._lost_of_one
        if self._several and not several:
            self._last = 0  # the last number may be from a publisher that has left
        if not several:
            self._lost_of_one = self.lost
        self._several = several


def begin_counting(gaps_by_topic: MutableMapping[str, TransportGaps], topic: str) -> TransportGaps:
    """Return the counter of a topic, to which a new subscription adds its message infos; the counts continue."""
    gaps = gaps_by_topic.setdefault(topic, TransportGaps())
    gaps.begin_subscription()
    return gaps
