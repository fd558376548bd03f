"""High-water mark of a process's resident memory (VmHWM), which is reset before a measurement."""

from __future__ import annotations

from contextlib import suppress


def reset_peak(process: int | str) -> int | None:
    """Reset the high-water mark of a process's resident memory; return the current resident memory, bytes.

    The process is a process id or `self`. The result is None if the mark cannot be reset.
    """
    try:
        with open(f"/proc/{process}/clear_refs", "wb", buffering=0) as marks:
            marks.write(b"5")
    except OSError:
        return None
    return _status_bytes(process, b"VmRSS:")


def peak_of(process: int | str) -> int | None:
    """Return the high-water mark of a process's resident memory, bytes; None if it is unknown."""
    return _status_bytes(process, b"VmHWM:")


def _status_bytes(process: int | str, key: bytes) -> int | None:
    with suppress(OSError), open(f"/proc/{process}/status", "rb", buffering=0) as status:
        found = status.read(8192).partition(b"\n" + key)[2].split(None, 1)
        return int(found[0]) * 1024 if found else None
    return None
