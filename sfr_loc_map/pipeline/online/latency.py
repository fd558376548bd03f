"""How old a result is when it leaves the node, and what of that the way to the node took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

COMPARABLE_NS = 60 * 1_000_000_000
"""Moments further apart than this, or in the wrong order, are of clocks that cannot be compared (a recording that is
played back, a host whose clock is not set)."""
CLOCK_NOISE_NS = 1_000_000
"""So far in the wrong order two moments may be because clocks are read and rounded differently."""


@dataclass(frozen=True, slots=True)
class MessageTimes:
    """When a message was sent and received, nanoseconds of the hosts' system clocks; None where not known."""

    sent_ns: int | None
    received_ns: int | None

    @classmethod
    def of(cls, info: Mapping[str, Any]) -> MessageTimes:
        """Return what the message info of a subscription says; the middleware gives 0 for what it does not know."""
        return cls(info.get("source_timestamp") or None, info.get("received_timestamp") or None)


def latencies(
    receipts: Sequence[MessageTimes], stamp_ns: int, published_ns: int, node_time_ns: int
) -> dict[str, float]:
    """Return the latencies of one result, seconds, as far as their clocks can be compared.

    Args:
        receipts: Of the messages that the result is made of.
        stamp_ns: Stamp of the result: when the pictures were taken.
        published_ns: System time at which the result was published.
        node_time_ns: The same moment on the node's clock (simulated time where the node uses it).

    Returns:
        `latency_transport_s`: from the publisher's publish call to the receipt by the middleware, the slowest message;
        `latency_receive_to_publish_s`: from the receipt of the last message to the publication of the result, with the
        wait in queues; `latency_stamp_to_publish_s`: from the stamp to the publication.
    """
    sent = [receipt.sent_ns for receipt in receipts]
    received = [receipt.received_ns for receipt in receipts]
    found: dict[str, float | None] = {}
    if None not in received:
        ways = [_seconds(a, b) for a, b in zip(sent, received, strict=True) if a is not None and b is not None]
        if ways and None not in ways:
            found["latency_transport_s"] = max(way for way in ways if way is not None)
        found["latency_receive_to_publish_s"] = _seconds(max(r for r in received if r is not None), published_ns)
    found["latency_stamp_to_publish_s"] = _seconds(stamp_ns, node_time_ns)
    return {name: value for name, value in found.items() if value is not None}


def _seconds(begin_ns: int, end_ns: int) -> float | None:
    passed = end_ns - begin_ns
    return max(passed, 0) * 1e-9 if -CLOCK_NOISE_NS <= passed <= COMPARABLE_NS else None
