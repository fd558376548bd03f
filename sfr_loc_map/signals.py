"""Signals that end a command: SIGINT, SIGTERM and SIGHUP.

`cli.main` handles these signals from its start. A signal raises KeyboardInterrupt or calls the function given to
`stopping`. After `hold`, while finished results are written and children are ended, signals are ignored. A single
request often causes two signals, because a terminal and `timeout` signal both a process and its group. A signal within
a second of the previous one is therefore ignored.
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
SAME_REQUEST_S = 1.0  #: A signal within this time after the previous signal, s, is part of the same request.
AGAIN_S = 0.1  #: Delay, s, after which a signal is repeated if its exception was lost.


class _Handling:
    """Current handling of signals."""

    held = ignored = False
    last_s = -SAME_REQUEST_S
    stop: Callable[[], None] | None = None


_now = _Handling()


def handle_signals() -> None:
    """Let signals terminate the program gracefully, except those that it inherited as ignored (`nohup`)."""
    _now.held, _now.ignored, _now.stop, _now.last_s = False, False, None, -SAME_REQUEST_S
    for number in END_SIGNALS:
        if number is signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _received)
    sys.unraisablehook = _unraisable


def ignore_signals() -> None:
    """Ignore signals permanently while Python itself exits, so that Python exits with the given code.

    `python -m` ends by SIGINT, whatever the exit code is, if the source text that was executed last has raised
    KeyboardInterrupt, even if the exception was caught. `exec` and dataclasses execute such texts. Executing another
    text clears this state.
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    exec("")


def hold() -> None:
    """Ignore signals until the program ends. Meanwhile, finished results are written and children are ended."""
    _now.held = True


@contextmanager
def stopping(stop: Callable[[], object] = lambda: None) -> Iterator[Callable[[], bool]]:
    """Let the first signal within the block call `stop`, and the next signal raise KeyboardInterrupt.

    Yield a function that returns whether a signal was received. Signals that were ignored after `hold` count, too.
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
    """Block signals in a `with` statement. Processes that are started inside the statement inherit the signal mask."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _received(number: int, frame: FrameType | None) -> None:
    now_s = time.monotonic()
    is_new, _now.last_s = now_s - _now.last_s >= SAME_REQUEST_S, now_s
    if _now.held or not is_new:
        _now.ignored |= _now.held and is_new
        return
    if _now.stop is not None:
        _now.stop()
        return
    raise KeyboardInterrupt


def _unraisable(problem: Any) -> None:  # noqa: ANN401 - sys.UnraisableHookArgs is a name for type checkers alone
    """Repeat a signal whose exception was lost where no exception can propagate, as in `__del__`."""
    if not issubclass(problem.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(problem)
        return
    _now.last_s = -SAME_REQUEST_S
    threading.Timer(AGAIN_S, signal.raise_signal, (signal.SIGINT,)).start()
