"""Provenance of a benchmark: version, host, clock and time."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from typing import Any

from sfr_loc_map import __version__
from sfr_loc_map.metrics.calls.call_meter import METHOD

SCHEMA = "sfr-bench/1"
CLOCK = "host monotonic"
MEMORY = f"{METHOD}; largest of all calls"


def provenance() -> dict[str, Any]:
    """Return version, clock, memory method, host and time of a benchmark that begins, as JSON values."""
    host = {
        "machine": platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "load_at_start": os.getloadavg()[0],
    }
    time = datetime.now(UTC).isoformat(timespec="seconds")
    return {"version": __version__, "clock": CLOCK, "memory_method": MEMORY, "host": host, "time": time}
