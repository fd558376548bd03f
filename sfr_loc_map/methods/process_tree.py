"""Resource use of a process and its descendants, as reported by the kernel."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

BLOCK_BYTES = 512  #: Unit of `st_blocks`, bytes.


@dataclass(frozen=True, slots=True)
class TreeUsage:
    """Resource use of a process tree, summed over all processes."""

    cpu_s: float = 0.0  #: Processor time, including that of ended processes.
    #: Resident memory, in which a shared page counts once for each process, and the storage of open files without a
    #: name (`memfd_create`, deleted files), in which each file counts once.
    rss_bytes: int = 0
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
                cpu_s += sum(self._root.cpu_times()[2:4])  # processor time of ended descendants
        for member in members:
            with suppress(psutil.Error), member.oneshot():
                cpu_s += sum(member.cpu_times()[:4])
                rss_bytes += member.memory_info().rss
                threads += member.num_threads()
        rss_bytes += bytes_of_unnamed_files([member.pid for member in members])
        return TreeUsage(cpu_s, rss_bytes, threads, len(members))


def bytes_of_unnamed_files(processes: Sequence[int]) -> int:
    """Return the storage of the open files of processes that have no name, each file once.

    Such a file is in no folder, and the resident memory of a process includes it only if the process maps it.
    """
    blocks: dict[tuple[int, int], int] = {}
    for process in processes:
        with suppress(OSError), os.scandir(f"/proc/{process}/fd") as entries:
            for entry in entries:
                with suppress(OSError):
                    about = os.stat(entry.path)
                    if stat.S_ISREG(about.st_mode) and not about.st_nlink:
                        blocks[about.st_dev, about.st_ino] = about.st_blocks
    return sum(blocks.values()) * BLOCK_BYTES


def bytes_of_files(folder: Path, provided: Path, provided_bytes: int) -> int:
    """Return the storage of all files below a folder; files that vanish meanwhile are ignored.

    Of the file `provided`, only the storage beyond `provided_bytes` counts.
    """
    stored = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(parent, name)
            with suppress(OSError):
                used = os.lstat(path).st_blocks * BLOCK_BYTES
                stored += max(used - provided_bytes, 0) if path == str(provided) else used
    return stored
