"""What a process has started, and the memory of it all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import psutil


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process and its descendants, bytes; 0 once it has ended."""
    total = 0
    for member in (pid, *descendants(pid)):
        with contextlib.suppress(psutil.Error):
            total += psutil.Process(member).memory_info().rss
    return total


def descendants(pid: int) -> Iterator[int]:
    """Yield the processes below a process.

    Linux lists the children of a process; psutil reads every process of the host instead, which costs milliseconds.
    """
    threads = Path(f"/proc/{pid}/task")
    if not (threads / str(pid) / "children").exists():
        with contextlib.suppress(psutil.Error):
            yield from (process.pid for process in psutil.Process(pid).children(recursive=True))
        return
    with contextlib.suppress(OSError):  # it has ended meanwhile
        for thread in threads.iterdir():
            for child in map(int, (thread / "children").read_text().split()):
                yield child
                yield from descendants(child)
