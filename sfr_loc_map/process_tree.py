"""Resource use of a process and its descendants, as reported by the kernel."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")  #: Unit of `/proc/PID/statm`, bytes.
BLOCK_BYTES = 512  #: Unit of `st_blocks`, bytes.
SOCKET_BYTES = 320_000
"""Largest memory of the data that a socket has sent and no process has read, bytes: 1.5 times the default of Linux for
`net.core.wmem_default`, because the last message may exceed the limit. The supervisor prevents a method from enlarging
the buffers of its sockets."""
DELETED, SHARED = "(deleted)", "s"  #: Marks of a file without a name, and of a shared mapping, in `/proc/PID/maps`.
CLOCK_SHIFT, CLOCK_OF_PROCESS = 3, 2
"""Numbers by which Linux encodes a process in the id of its processor clock (`clock_getcpuclockid`)."""


@dataclass(frozen=True, slots=True)
class TreeUsage:
    """Resource use of a process tree, summed over all processes."""

    cpu_s: float = 0.0  #: Processor time, including that of ended processes.
    #: Resident memory, in which a shared page counts once for each process, and the storage of open or mapped files
    #: without a name (`memfd_create`, anonymous shared memory, deleted files), in which each file counts once. If the
    #: root is a supervisor, the buffers of sockets are included at their largest size.
    rss_bytes: int = 0
    threads: int = 0
    processes: int = 0


class ProcessTree:
    """A process and its descendants. If the process is the supervisor of a method, only its descendants are counted."""

    def __init__(self, root: int, *, is_supervisor: bool = False) -> None:
        self._root = psutil.Process(root)
        self._is_supervisor = is_supervisor
        self._members: list[psutil.Process] = []  # at the last reading

    def members(self) -> list[psutil.Process]:
        """Return the counted processes that exist now."""
        members = [] if self._is_supervisor else [self._root]
        with suppress(psutil.Error):
            members += self._root.children(recursive=True)
        return members

    def cpu_s(self) -> float:
        """Return the processor time of the processes found by the last call of `usage`, s; faster than `usage`."""
        cpu_s = 0.0
        with suppress(psutil.Error):
            if self._is_supervisor:
                cpu_s += sum(self._root.cpu_times()[2:4])  # processor time of ended descendants
        for member in self._members:
            with suppress(psutil.Error):
                cpu_s += _cpu_s(member)
        return cpu_s

    def usage(self) -> TreeUsage:
        """Return the present resource use."""
        rss_bytes = 0
        threads = 0
        self._members = members = self.members()
        cpu_s = self.cpu_s()
        for member in members:
            rss_bytes += resident_bytes(member.pid)
            with suppress(psutil.Error):
                threads += member.num_threads()
        socket_bytes = SOCKET_BYTES if self._is_supervisor else 0
        rss_bytes += bytes_of_nameless_files([member.pid for member in members], socket_bytes)
        return TreeUsage(cpu_s, rss_bytes, threads, len(members))


def _cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process and of its ended children.

    The clock of a process has a resolution of nanoseconds. The kernel lists the times of ended children in steps of
    10 ms.
    """
    own_s, system_s, *of_children_s = process.cpu_times()[:4]
    own_s += system_s
    with suppress(OSError):
        own_s = time.clock_gettime(~process.pid << CLOCK_SHIFT | CLOCK_OF_PROCESS)
    return float(own_s + sum(of_children_s))


def threads_of(process: int) -> list[int]:
    """Return the ids of the threads of a process, the first thread first; empty if the process has ended."""
    with suppress(OSError):
        return sorted(map(int, os.listdir(f"/proc/{process}/task")), key=lambda thread: (thread != process, thread))
    return []


def running_thread(process: int) -> int:
    """Return a thread of a process for which the kernel reports memory; the process if there is none.

    A first thread that has ended has no memory in `/proc/PID`, although the other threads of the process continue.
    """
    return next((thread for thread in threads_of(process) if _resident_pages(thread)), process)


def _resident_pages(thread: int) -> int:
    with suppress(OSError):
        return int(Path(f"/proc/{thread}/statm").read_text(encoding="ascii").split()[1])
    return 0


def resident_bytes(process: int) -> int:
    """Return the resident memory of a process; 0 if it has ended."""
    return next(filter(None, map(_resident_pages, threads_of(process))), 0) * PAGE_BYTES


def bytes_of_nameless_files(processes: Sequence[int], socket_bytes: int = 0) -> int:
    """Return the storage of the files without a name that processes have open or have mapped; each file counts once.

    Such a file is in no folder, and the resident memory of a process includes only its pages that are mapped and in
    use. Each socket counts as `socket_bytes`.
    """
    stored: dict[tuple[int, int], int] = {}
    mapped: dict[tuple[int, int], int] = {}
    for process in processes:
        for thread in threads_of(process):
            stored |= _nameless_open_files(thread, socket_bytes)
        for file, size in _nameless_mapped_files(process).items():
            mapped[file] = max(mapped.get(file, 0), size)
    return sum((mapped | stored).values())  # for open files, the exact storage replaces the estimate from mappings


def _nameless_open_files(thread: int, socket_bytes: int) -> dict[tuple[int, int], int]:
    """Return the storage of the files without a name that a thread has open, by device and number.

    Threads usually share their table of open files, but `unshare(CLONE_FILES)` gives a thread a table of its own.
    """
    stored: dict[tuple[int, int], int] = {}
    with suppress(OSError), os.scandir(f"/proc/{thread}/fd") as entries:
        for entry in entries:
            with suppress(OSError):
                about = os.stat(entry.path)
                if stat.S_ISREG(about.st_mode) and not about.st_nlink:
                    stored[about.st_dev, about.st_ino] = about.st_blocks * BLOCK_BYTES
                elif stat.S_ISSOCK(about.st_mode):
                    stored[about.st_dev, about.st_ino] = socket_bytes
    return stored


def _nameless_mapped_files(process: int) -> dict[tuple[int, int], int]:
    """Return the storage of the files without a name that a process has mapped as shared, by device and number.

    Without the right to examine the files of mappings (CAP_SYS_ADMIN or CAP_CHECKPOINT_RESTORE), a file counts up to
    the end of its last mapping. A file has several mappings if a process has changed the access to a part of it.
    """
    stored: dict[tuple[int, int], int] = {}
    thread = running_thread(process)
    with suppress(OSError):
        for line in Path(f"/proc/{thread}/maps").read_text(encoding="utf-8", errors="replace").splitlines():
            if not line.endswith(DELETED):
                continue
            addresses, access, offset, device, number = line.split()[:5]
            if not access.endswith(SHARED):
                continue
            major, minor = (int(part, 16) for part in device.split(":"))
            first, end = (int(part, 16) for part in addresses.split("-"))
            size = int(offset, 16) + end - first
            with suppress(OSError):
                size = os.stat(f"/proc/{thread}/map_files/{first:x}-{end:x}").st_blocks * BLOCK_BYTES
            file = os.makedev(major, minor), int(number)
            stored[file] = max(stored.get(file, 0), size)
    return stored


def bytes_of_files(folder: Path, provided: Path, provided_bytes: int) -> int:
    """Return the storage of all files below a folder; files that vanish meanwhile are ignored.

    Of the file `provided`, only the storage beyond `provided_bytes` counts. Raises OSError if a folder or a file cannot
    be examined, for example because its path is too long.
    """
    stored = 0
    for parent, _, names in os.walk(folder, onerror=_raise_unless_vanished):
        for name in names:
            path = os.path.join(parent, name)
            with suppress(FileNotFoundError):
                used = os.lstat(path).st_blocks * BLOCK_BYTES
                stored += max(used - provided_bytes, 0) if path == str(provided) else used
    return stored


def _raise_unless_vanished(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):
        raise error
