"""What a process and all that it has started take, as the kernel reports it from outside of them."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

BLOCK_BYTES = 512  #: Unit of `st_blocks`.


@dataclass(frozen=True, slots=True)
class TreeUsage:
    """Use of a tree of processes, summed over its members."""

    cpu_s: float = 0.0  #: Processor time since they began, also of those that have ended.
    rss_bytes: int = 0  #: Resident memory; pages that several share count for each.
    threads: int = 0
    processes: int = 0


class ProcessTree:
    """A process with all its descendants; of a supervisor the descendants alone."""

    def __init__(self, root: int, *, is_supervisor: bool = False) -> None:
        self._root = psutil.Process(root)
        self._is_supervisor = is_supervisor

    def usage(self) -> TreeUsage:
        """Return what the members take now."""
        cpu_s = 0.0
        rss_bytes = 0
        threads = 0
        members = [] if self._is_supervisor else [self._root]
        with suppress(psutil.Error):
            members += self._root.children(recursive=True)
            if self._is_supervisor:
                cpu_s += sum(self._root.cpu_times()[2:4])  # of the descendants that it has waited for
        for member in members:
            with suppress(psutil.Error), member.oneshot():
                cpu_s += sum(member.cpu_times()[:4])
                rss_bytes += member.memory_info().rss
                threads += member.num_threads()
        return TreeUsage(cpu_s, rss_bytes, threads, len(members))


def bytes_of_files(folder: Path, but: Path) -> int:
    """Return the storage of the files below a folder, except one; files that vanish meanwhile are ignored."""
    blocks = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(parent, name)
            with suppress(OSError):
                blocks += 0 if path == str(but) else os.lstat(path).st_blocks
    return blocks * BLOCK_BYTES
