"""State of a replay that the operator controls, and the keys that control it. Knows nothing of ROS."""

from __future__ import annotations

import math
import os
import select
import sys
import termios
import tty
from dataclasses import dataclass
from typing import Any

RATE_STEP = 1.1
SEEK_STEP_S = 5.0
HELP = "space pause, s or right: next pair, left/f: 5 s back/on, up/down: rate, l: loop, q: end"


@dataclass(slots=True)
class Controls:
    """State of a replay; positions are seconds after the first message."""

    rate: float = 0.0  # 0: lock step, the result of each pair is awaited; otherwise a multiple of the recorded speed
    paused: bool = False
    loop: bool = False
    steps: int = 0  # pairs that are published although it is paused
    seek_s: float | None = None  # where to continue; None: at the current position
    stopped: bool = False
    position_s: float = 0.0
    end_s: float = math.inf  # of the last pair: no run starts after it

    def hold(self, paused: bool) -> None:
        """Pause or resume."""
        self.paused, self.steps = paused, 0

    def toggle(self) -> None:
        """Pause if it plays, else resume."""
        self.hold(not self.paused)

    def stop(self) -> None:
        """Publish nothing more."""
        self.stopped = True

    def step(self) -> None:
        """Publish one more pair and pause."""
        self.paused = True
        self.steps += 1

    def seek(self, position_s: float) -> None:
        """Continue at another position; one after the last pair has no effect."""
        if position_s <= self.end_s:
            self.seek_s = max(position_s, 0.0)

    def moved_to(self, position_s: float) -> None:
        """Update the current position."""
        self.position_s = position_s

    def next_start_s(self) -> float | None:
        """Return where to start after the messages have ended or were interrupted; None to end. Consumes a seek."""
        position_s, self.seek_s = self.seek_s, None
        if self.stopped or (position_s is None and not self.loop):
            return None
        return position_s or 0.0

    def key(self, name: str) -> None:
        """Do the action of a key; see `HELP`."""
        if name == " ":
            self.toggle()
        elif name in ("s", "right"):
            self.step()
        elif name in ("left", "f"):
            self.seek(self.position_s + (SEEK_STEP_S if name == "f" else -SEEK_STEP_S))
        elif name in ("up", "down"):
            self.rate *= RATE_STEP if name == "up" else 1.0 / RATE_STEP
        elif name == "l":
            self.loop = not self.loop
        elif name == "q":
            self.stop()

    @property
    def interrupted(self) -> bool:
        """Whether the messages that follow are not to be published."""
        return self.stopped or self.seek_s is not None

    @property
    def held(self) -> bool:
        """Whether nothing is to be published now."""
        return self.paused and not self.steps


ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}
MAX_BYTES = 64


class Keyboard:
    """Reads single keys without waiting, where standard input is a terminal in the foreground; a context manager."""

    def __init__(self) -> None:
        """Find out whether there is a keyboard; a terminal that is not the controlling one has none."""
        self._descriptor = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        try:
            self.is_there = self._descriptor >= 0 and os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:
            self.is_there = False
        self._before: list[Any] = []

    def __enter__(self) -> Keyboard:
        """Deliver each key at once; Ctrl-C still interrupts."""
        if self.is_there:
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_there:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def pressed(self) -> list[str]:
        """Return the keys that were pressed: characters, or `up`, `down`, `left`, `right`."""
        if not self.is_there or not select.select([self._descriptor], [], [], 0.0)[0]:
            return []
        data, keys = os.read(self._descriptor, MAX_BYTES), []
        while data:
            arrow = ARROWS.get(data[:3])
            keys.append(arrow or chr(data[0]))
            data = data[3 if arrow else 1 :]
        return keys
