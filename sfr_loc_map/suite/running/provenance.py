"""Provenance of the run of a suite: code, host and time."""

from __future__ import annotations

import socket
from datetime import UTC, datetime

from sfr_loc_map.package_commit import package_commit


def about_run() -> dict[str, object]:
    """Return the commit, host and time of the run of a suite. Commit, branch and date are None if unknown."""
    time = datetime.now(UTC).isoformat(timespec="seconds")
    return {"git": package_commit()._asdict(), "host": socket.gethostname(), "time": time}
