"""Keys of a terminal as they are pressed."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from typing import Any

ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}
MOST_BYTES = 64


class Keyboard:
    """Reads single keys without waiting, where standard input is a terminal in the foreground; a context manager."""

    def __init__(self) -> None:
        """Find out whether there is a keyboard."""
        self._number = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self.there = self._number >= 0 and os.tcgetpgrp(self._number) == os.getpgrp()
        self._before: list[Any] = []

    def __enter__(self) -> Keyboard:
        """Let keys come one by one; Ctrl-C stays what it is."""
        if self.there:
            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number)
        return self

    def __exit__(self, *_: object) -> None:
        """Put the terminal back."""
        if self.there:
            termios.tcsetattr(self._number, termios.TCSADRAIN, self._before)

    def pressed(self) -> list[str]:
        """Return the keys that were pressed: characters, or `up`, `down`, `left`, `right`."""
        if not self.there or not select.select([self._number], [], [], 0.0)[0]:
            return []
        data, keys = os.read(self._number, MOST_BYTES), []
        while data:
            arrow = ARROWS.get(data[:3])
            keys.append(arrow or chr(data[0]))
            data = data[3 if arrow else 1 :]
        return keys
