"""Determine when a message of a replay is due, and which pairs have been published."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping

from sfr_loc_map.io.message_stream import Message
from sfr_loc_map.topics import COMPRESSED_END


class Pacer:
    """Computes when a message is due, from its stamp and the rate; each rig has its own clock."""

    def __init__(self, rate: float) -> None:
        """Set the rate, a multiple of the recorded speed; at a rate of 0, each message is due immediately."""
        self._rate = rate
        self._origins: dict[str, tuple[float, int]] = {}

    def restart(self) -> None:
        """Restart the clocks at the next message, as after a pause."""
        self._origins.clear()

    def wait_s(self, message: Message) -> float:
        """Return the time until a message is due, s; 0 if it is due."""
        if self._rate <= 0.0:
            return 0.0
        begin_s, first_ns = self._origins.setdefault(message.rig, (time.monotonic(), message.stamp_ns))
        return max(begin_s + (message.stamp_ns - first_ns) * 1e-9 / self._rate - time.monotonic(), 0.0)


class PairTracker:
    """Reports when all messages of a stereo pair, including a required pose, have been published."""

    def __init__(self, parts: Mapping[tuple[str, int], tuple[str, int]]) -> None:
        """Start before the first message; `parts` is the result of `parts_of_pairs`."""
        self._pair_of = parts
        self._missing = Counter(parts.values())  # unpublished messages of each pair

    def add(self, message: Message) -> tuple[str, int] | None:
        """Add a published message; return rig and stamp of the completed pair, or None."""
        pair = self._pair_of.get((message.topic.removesuffix(COMPRESSED_END), message.stamp_ns))
        if pair is None:
            return None
        self._missing[pair] -= 1
        return None if self._missing[pair] else pair
