"""Stamps of messages, integer nanoseconds, and when they indicate a new run."""

from __future__ import annotations

import struct
from typing import Any

NS_PER_S = 1_000_000_000  #: Nanoseconds in a second.
NS_PER_MS = 1_000_000  #: Nanoseconds in a millisecond.
JUMP_BACK_NS = NS_PER_S  #: Minimum backward jump of stamps that indicates a reset clock or a restarted bag, ns.


def stamp_of(message: Any) -> int:  # noqa: ANN401 - any message with a header
    """Return the stamp in the header of a message, nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def serialised_stamp(raw: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header, nanoseconds (CDR, XTypes 1.3, 7.4)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def jumped_back(latest_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp is at least `JUMP_BACK_NS` before the latest, so that a new run or clock has begun."""
    return latest_ns - stamp_ns >= JUMP_BACK_NS
