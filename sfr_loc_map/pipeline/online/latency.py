"""The latency of a result, and the part of it that is transport to the node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

COMPARABLE_NS = 60 * 1_000_000_000
"""Clocks that are further apart, or in the wrong order, cannot be compared (a recording that is played back, a host
whose clock is not set)."""
CLOCK_NOISE_NS = 1_000_000
"""Tolerance for the wrong order: clocks are read and rounded differently."""


@dataclass(frozen=True, slots=True)
class MessageTimes:
    """When a message was sent and received, nanoseconds of the hosts' system clocks; None where not known."""

    sent_ns: int | None
    received_ns: int | None

    @classmethod
    def of(cls, info: Mapping[str, Any]) -> MessageTimes:
        """Return what the message info of a subscription says; the middleware gives 0 for what it does not know."""
        return cls(info.get("source_timestamp") or None, info.get("received_timestamp") or None)


def latencies(times: Sequence[MessageTimes], stamp_ns: int, published_ns: int, node_time_ns: int) -> dict[str, float]:
    """Return the latencies of one result, seconds, as far as their clocks can be compared.

    Args:
        times: Of the messages that the result is made of.
        stamp_ns: Stamp of the result: when the images were taken.
        published_ns: System time at which the result was published.
        node_time_ns: The same moment on the node's clock (simulated time where the node uses it).

    Returns:
        `latency_transport_s`: from the publisher's publish call to the receipt by the middleware, the slowest message;
        `latency_receive_to_publish_s`: from the receipt of the last message to the publication of the result, with the
        wait in queues; `latency_stamp_to_publish_s`: from the stamp to the publication.
    """
    found = {
        "latency_transport_s": _transport(times),
        "latency_receive_to_publish_s": _since_last_receipt(times, published_ns),
        "latency_stamp_to_publish_s": _seconds(stamp_ns, node_time_ns),
    }
    return {name: seconds for name, seconds in found.items() if seconds is not None}


def _transport(times: Sequence[MessageTimes]) -> float | None:
    """Return the longest transport of the messages whose times are known; None if one cannot be compared."""
    if any(message.received_ns is None for message in times):
        return None
    known = [
        _seconds(message.sent_ns, message.received_ns)
        for message in times
        if message.sent_ns is not None and message.received_ns is not None
    ]
    comparable = [seconds for seconds in known if seconds is not None]
    return max(comparable) if known and len(comparable) == len(known) else None


def _since_last_receipt(times: Sequence[MessageTimes], published_ns: int) -> float | None:
    received = [message.received_ns for message in times if message.received_ns is not None]
    return _seconds(max(received), published_ns) if received and len(received) == len(times) else None


def _seconds(begin_ns: int, end_ns: int) -> float | None:
    passed = end_ns - begin_ns
    return max(passed, 0) * 1e-9 if -CLOCK_NOISE_NS <= passed <= COMPARABLE_NS else None
