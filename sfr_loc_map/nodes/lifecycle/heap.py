"""The heap of a process, where the C library is glibc."""

from __future__ import annotations

import ctypes
import gc
import sys

_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8
_LARGE_BYTES = 131_072


def configure_malloc() -> None:
    """Make glibc return large blocks at once and use one arena for all small ones; does nothing elsewhere.

    For processes that run for a long time without deadlines: blocks of all sizes that one thread allocates and another
    frees otherwise fragment the heap. Call it before other threads are started.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
        mallopt(_M_ARENA_MAX, 1)


def release_memory() -> None:
    """Free what reference cycles hold, and return free heap to the system where the C library can (glibc)."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
