"""When the next message of a replay is due, and when a stereo pair is complete. Knows nothing of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

from sfr_loc_map.pipeline.playback.controls import Controls
from sfr_loc_map.pipeline.playback.message_stream import POSE_TOPIC, Message


class Pacer:
    """Says when a message is due; each task starts with its first message, and again after a pause."""

    def __init__(self, controls: Controls, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin.

        Args:
            controls: Their rate is used.
            clock: Monotonic seconds.
        """
        self._controls, self._clock = controls, clock
        self._rate = controls.rate
        self._origins: dict[str, tuple[float, int]] = {}

    def wait_s(self, message: Message) -> float:
        """Return for how long a message has to wait, 0 if it is due."""
        controls = self._controls
        if controls.held or controls.steps or controls.rate != self._rate:
            self._origins.clear()
            self._rate = controls.rate
        if controls.rate <= 0 or controls.steps:
            return 0.0
        begin, first_ns = self._origins.setdefault(message.task, (self._clock(), message.stamp_ns))
        return max(begin + (message.stamp_ns - first_ns) * 1e-9 / controls.rate - self._clock(), 0.0)


class PairTracker:
    """Tells when a stereo pair, with its pose where it needs one, has been published."""

    def __init__(self) -> None:
        """Start with none."""
        self._parts: dict[tuple[str, int], set[str]] = {}

    def add(self, message: Message) -> tuple[str, int] | None:
        """Add a published message; return task and stamp of the pair that it completes."""
        part = message.topic.removesuffix("/compressed")
        if not part.endswith("image_rect") and part != POSE_TOPIC:
            return None
        key = (message.task, message.stamp_ns)
        parts = self._parts.setdefault(key, set())
        parts.add(part)
        if len(parts) < (2 if message.task == "loc" else 3):
            return None
        del self._parts[key]
        return key
