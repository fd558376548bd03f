"""What a process has started, and the memory of it all.

Linux is read directly: psutil reads every process of the host to find children, which costs milliseconds each time.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import psutil

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process and its descendants, bytes; 0 once it has ended."""
    return sum(map(_resident, (pid, *descendants(pid))))


def descendants(pid: int) -> Iterator[int]:
    """Yield the processes below a process."""
    if not os.path.exists(f"/proc/{pid}/task/{pid}/children"):
        with contextlib.suppress(psutil.Error):
            yield from (process.pid for process in psutil.Process(pid).children(recursive=True))
        return
    with contextlib.suppress(OSError):  # it has ended meanwhile
        for thread in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{thread}/children", "rb", buffering=0) as stream:
                children = [int(word) for word in stream.read().split()]
            for child in children:
                yield child
                yield from descendants(child)


def _resident(pid: int) -> int:
    with contextlib.suppress(OSError), open(f"/proc/{pid}/statm", "rb", buffering=0) as stream:
        return int(stream.read().split()[1]) * _PAGE_BYTES
    with contextlib.suppress(psutil.Error):
        return int(psutil.Process(pid).memory_info().rss)
    return 0
