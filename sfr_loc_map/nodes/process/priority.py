"""What only looks on gives way to what it looks at."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

STEPS = 5
"""A third of the weight of other processes, so that it still gets its share of a full machine."""
_GROUP = Path("/proc/self/autogroup")


def give_way() -> None:
    """Lower the priority of this process; of its whole session, where it leads one and the kernel weighs sessions.

    With `sched_autogroup_enabled` (Linux) the niceness of a process counts within its session only.
    """
    os.nice(STEPS)
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            _GROUP.write_text(str(STEPS), encoding="ascii")
