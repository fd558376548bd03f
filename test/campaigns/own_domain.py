"""The environment of a campaign with nodes: its own ROS domain and folder, and one line at the end."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from sfr_loc_map.ros import environment


def in_own_domain(run: Callable[[Path], list[str]]) -> int:
    """Run a campaign in a ROS domain and a folder of its own, print what failed; return the exit code."""
    environment.prepare()
    environment.isolate()
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as folder:
        failures = run(Path(folder))
    print(f"not as expected: {'; '.join(failures)}" if failures else "all as expected")
    return int(bool(failures))
