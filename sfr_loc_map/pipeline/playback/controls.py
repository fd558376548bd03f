"""What an operator may do to a replay, and when the next message is due under it. Knows nothing of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from sfr_loc_map.pipeline.playback.messages import POSE_TOPIC, Message

FASTER = 1.1
JUMP_S = 5.0
HELP = "space pause, s or right: next pair, left/f: 5 s back/on, up/down: rate, l: loop, q: end"


@dataclass(slots=True)
class Controls:
    """State of a replay.

    Attributes:
        rate: 0: each pair's result is awaited; otherwise multiple of the speed of the stamps.
        paused: Whether nothing is published.
        loop: Whether it begins again at its end.
        steps: Pairs that are published although it is paused.
        jump_s: Where to go on, seconds after the first message; None to go on as it is.
        stopped: Whether to publish nothing more.
        position_s: Where it is.
    """

    rate: float = 0.0
    paused: bool = False
    loop: bool = False
    steps: int = 0
    jump_s: float | None = None
    stopped: bool = False
    position_s: float = 0.0

    def pause(self) -> None:
        """Publish nothing for now."""
        self.paused, self.steps = True, 0

    def resume(self) -> None:
        """Go on."""
        self.paused, self.steps = False, 0

    def toggle(self) -> None:
        """Pause, or go on."""
        self.paused, self.steps = not self.paused, 0

    def stop(self) -> None:
        """Publish nothing more."""
        self.stopped = True

    def step(self) -> None:
        """Publish one more pair and pause."""
        self.paused = True
        self.steps += 1

    def seek(self, position_s: float) -> None:
        """Go on from another place."""
        self.jump_s = max(position_s, 0.0)

    def key(self, name: str) -> None:
        """Do what a key stands for; see `HELP`."""
        actions: dict[str, Callable[[], None]] = {
            " ": self.toggle,
            "s": self.step,
            "right": self.step,
            "left": lambda: self.seek(self.position_s - JUMP_S),
            "f": lambda: self.seek(self.position_s + JUMP_S),
            "up": lambda: self._scale(FASTER),
            "down": lambda: self._scale(1.0 / FASTER),
            "l": self._toggle_loop,
            "q": self.stop,
        }
        actions.get(name, lambda: None)()

    @property
    def interrupted(self) -> bool:
        """Whether the messages that follow are not to be published."""
        return self.stopped or self.jump_s is not None

    @property
    def held(self) -> bool:
        """Whether nothing is to be published now."""
        return self.paused and not self.steps

    def _scale(self, factor: float) -> None:
        self.rate *= factor

    def _toggle_loop(self) -> None:
        self.loop = not self.loop


class Pace:
    """Says when a message is due; each bench begins with its first message, and anew after a pause."""

    def __init__(self, controls: Controls, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin.

        Args:
            controls: Their rate counts.
            clock: Seconds, going forward.
        """
        self._controls, self._clock = controls, clock
        self._rate = controls.rate
        self._begins: dict[str, tuple[float, int]] = {}

    def wait_s(self, message: Message) -> float:
        """Return for how long a message has to wait, 0 if it is due."""
        controls = self._controls
        if controls.held or controls.steps or controls.rate != self._rate:
            self._begins.clear()
            self._rate = controls.rate
        if controls.rate <= 0 or controls.steps:
            return 0.0
        begin, first_ns = self._begins.setdefault(message.bench, (self._clock(), message.stamp_ns))
        return max(begin + (message.stamp_ns - first_ns) * 1e-9 / controls.rate - self._clock(), 0.0)


class Pairs:
    """Tells when a stereo pair, with its pose where it needs one, has been published."""

    def __init__(self) -> None:
        """Start with none."""
        self._parts: dict[tuple[str, int], set[str]] = {}

    def add(self, message: Message) -> tuple[str, int] | None:
        """Take a message; return bench and stamp of the pair that it completes."""
        part = message.topic.removesuffix("/compressed")
        if not part.endswith("image_rect") and part != POSE_TOPIC:
            return None
        key = (message.bench, message.stamp_ns)
        parts = self._parts.setdefault(key, set())
        parts.add(part)
        if len(parts) < (2 if message.bench == "loc" else 3):
            return None
        del self._parts[key]
        return key
