"""Tasks that are timed run alone on their host, whichever suite, worker or client has begun the others."""

from __future__ import annotations

import fcntl
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ASK_AGAIN_S = 0.1


@contextmanager
def host_share(*, alone: bool, stop: threading.Event) -> Iterator[bool]:
    """Yield once this task may run on the host; whether it may is False where it was stopped before.

    A task alone waits for the end of all others and holds back those that come later, so that it gets its turn.

    Args:
        alone: Whether no other task of any suite may run meanwhile.
        stop: Ends the wait.
    """
    kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
    with ExitStack() as room, ExitStack() as gate:
        free = _locked(gate, "gate", kind, stop) and _locked(room, "room", kind, stop)
        gate.close()
        yield free


def _locked(stack: ExitStack, name: str, kind: int, stop: threading.Event) -> bool:
    path = Path(tempfile.gettempdir()) / f"sfr-suite-{os.getuid()}.{name}"
    lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    stack.callback(os.close, lock)
    while True:
        try:
            fcntl.flock(lock, kind | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if stop.wait(ASK_AGAIN_S):
                return False
