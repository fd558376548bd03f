"""Runs a command and measures its time and memory: `python measured.py RESULT COMMAND...`.

The peak of resident memory that the kernel reports at a process' end includes the process that started it, so this one
is small and imports next to nothing.
"""

import os
import sys
import time


def main() -> None:
    """Write wall-clock seconds, processor seconds, peak KiB and exit status of the command to RESULT."""
    begin = time.perf_counter()
    child = os.posix_spawnp(sys.argv[2], sys.argv[2:], os.environ)
    _, status, usage = os.wait4(child, 0)
    seconds = time.perf_counter() - begin
    with open(sys.argv[1], "w", encoding="ascii") as stream:
        code = os.waitstatus_to_exitcode(status)
        stream.write(f"{seconds!r} {usage.ru_utime + usage.ru_stime!r} {usage.ru_maxrss} {code}\n")


if __name__ == "__main__":
    main()
