"""Signals that end a command: SIGINT, SIGTERM and SIGHUP.

`cli.main` handles them from its start. What runs gets a KeyboardInterrupt, or what `stopping` was given is called; from
`hold` on, when what was finished is written and children are ended, a signal is ignored. One wish often comes twice (a
terminal and `timeout` signal a process and its group): a signal within a second of another one is part of it.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SAME_WISH_S = 1.0
AGAIN_S = 0.1


class _Wish:
    """What a signal does at the moment."""

    held = ignored = False
    last_s = -SAME_WISH_S
    stop: Callable[[], None] | None = None


_now = _Wish()


def handle_signals() -> None:
    """Let signals terminate the program gracefully, except those that it inherited as ignored (`nohup`)."""
    _now.held, _now.ignored, _now.stop, _now.last_s = False, False, None, -SAME_WISH_S
    for number in END_SIGNALS:
        if number is signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _received)
    sys.unraisablehook = _unraisable


def ignore_signals() -> None:
    """Ignore signals for good: all is done, and the end of Python itself takes a moment."""
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def hold() -> None:
    """Ignore signals until the program ends, which is soon: what was finished is written, children are ended."""
    _now.held = True


@contextmanager
def stopping(stop: Callable[[], object] = lambda: None) -> Iterator[Callable[[], bool]]:
    """Let the first signal within the block call `stop`, the next one interrupt; give whether there was one.

    One that `hold` has ignored before counts.
    """
    received, held = [True] * _now.ignored, _now.held

    def first() -> None:
        received.append(True)
        _now.stop = None
        stop()

    _now.held, _now.stop = False, first
    try:
        yield lambda: bool(received)
    finally:
        _now.stop = None
        _now.held |= held


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Let signals come after the block, and never to processes started within it that do not ask for them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _received(number: int, frame: FrameType | None) -> None:
    now_s = time.monotonic()
    is_new, _now.last_s = now_s - _now.last_s >= SAME_WISH_S, now_s
    if _now.held or not is_new:
        _now.ignored |= _now.held and is_new
        return
    if _now.stop is not None:
        _now.stop()
        return
    raise KeyboardInterrupt


def _unraisable(problem: Any) -> None:  # noqa: ANN401 - sys.UnraisableHookArgs is a name for type checkers alone
    """Send a signal again whose exception was lost in a place that no exception can leave, as `__del__`."""
    if not issubclass(problem.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(problem)
        return
    _now.last_s = -SAME_WISH_S
    threading.Timer(AGAIN_S, signal.raise_signal, (signal.SIGINT,)).start()
