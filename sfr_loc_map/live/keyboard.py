"""Read single keys from a terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from typing import Any

MAX_BYTES = 64


class Keyboard:
    """Reads single keys without blocking, if standard input is a terminal in the foreground; a context manager."""

    def __init__(self) -> None:
        """Check whether keys can be read: standard input must be the controlling terminal."""
        self._descriptor = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        try:
            self.is_there = self._descriptor >= 0 and os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:
            self.is_there = False
        self._before: list[Any] = []

    def __enter__(self) -> Keyboard:
        """Deliver each key without waiting for a line; Ctrl-C still interrupts."""
        if self.is_there:
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_there:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def pressed(self) -> str:
        """Return the characters of the keys pressed since the last call."""
        if not self.is_there or not select.select([self._descriptor], [], [], 0.0)[0]:
            return ""
        return os.read(self._descriptor, MAX_BYTES).decode("utf-8", errors="replace")
