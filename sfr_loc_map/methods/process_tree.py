"""Resource use of a process and its descendants, as reported by the kernel."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

BLOCK_BYTES = 512  #: Unit of `st_blocks`, bytes.


@dataclass(frozen=True, slots=True)
class TreeUsage:
    """Resource use of a process tree, summed over all processes."""

    cpu_s: float = 0.0  #: Processor time, including that of ended processes.
    rss_bytes: int = 0  #: Resident memory; a shared page counts once for each process.
    threads: int = 0
    processes: int = 0


class ProcessTree:
    """A process and its descendants; a supervisor itself is not counted."""

    def __init__(self, root: int, *, is_supervisor: bool = False) -> None:
        self._root = psutil.Process(root)
        self._is_supervisor = is_supervisor

    def usage(self) -> TreeUsage:
        """Return the present resource use."""
        cpu_s = 0.0
        rss_bytes = 0
        threads = 0
        members = [] if self._is_supervisor else [self._root]
        with suppress(psutil.Error):
            members += self._root.children(recursive=True)
            if self._is_supervisor:
                cpu_s += sum(self._root.cpu_times()[2:4])  # of ended descendants
        for member in members:
            with suppress(psutil.Error), member.oneshot():
                cpu_s += sum(member.cpu_times()[:4])
                rss_bytes += member.memory_info().rss
                threads += member.num_threads()
        return TreeUsage(cpu_s, rss_bytes, threads, len(members))


def bytes_of_files(folder: Path, but: Path) -> int:
    """Return the storage of all files below a folder except `but`; files that vanish meanwhile are ignored."""
    blocks = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(parent, name)
            with suppress(OSError):
                blocks += 0 if path == str(but) else os.lstat(path).st_blocks
    return blocks * BLOCK_BYTES
