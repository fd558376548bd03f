"""Shared-memory segments of Fast DDS that a node which crashed or had to be killed leaves behind.

A process holds the lock file of each of its own segments open and locked while it lives, and only maps those of others.
Which segments are its own is therefore known while it lives, and a lock that is free afterwards says that nobody
writes to the segment any more; who still maps it keeps it. Port files are shared by processes, and left alone.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

LOCK = re.compile(r"/dev/shm/fastrtps_[0-9a-f]+_el")


def segment_locks(pid: int) -> list[Path]:
    """Return the lock files of the segments of a process; empty where the system does not tell (`/proc`)."""
    found = []
    with suppress(OSError):
        for entry in os.scandir(f"/proc/{pid}/fd"):
            with suppress(OSError):  # closed meanwhile
                found.append(os.readlink(entry.path))
    return [Path(name) for name in found if LOCK.fullmatch(name)]


def remove_ownerless(locks: Iterable[Path]) -> None:
    """Remove the segments of lock files that no process holds, and the lock files."""
    for lock in locks:
        with suppress(OSError), lock.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            lock.with_name(lock.name.removesuffix("_el")).unlink(missing_ok=True)
            lock.unlink(missing_ok=True)
