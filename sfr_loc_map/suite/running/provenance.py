"""Provenance of the run of a suite: code, host and time."""

from __future__ import annotations

import functools
import socket
import subprocess
from datetime import UTC, datetime

from sfr_loc_map.package_commit import GIT
from sfr_loc_map.suite.running.digests import PACKAGE


def about_run() -> dict[str, object]:
    """Return code, host and time of the run of a suite; commit, branch and date are None if unknown."""
    git = GIT
    if not git and (PACKAGE.parent / ".git").exists():  # run from its sources
        describe = "describe --always --dirty --abbrev=40 --exclude=*"
        asked = (describe, "rev-parse --abbrev-ref HEAD", "show --no-patch --format=%cI")
        run_git = functools.partial(subprocess.run, cwd=PACKAGE, capture_output=True, text=True, check=False)
        git = [run_git(["git", *arguments.split()]).stdout.strip() for arguments in asked]
    commit, branch, date = (*(item or None for item in git), None, None, None)[:3]
    time = datetime.now(UTC).isoformat(timespec="seconds")
    return {"git": {"commit": commit, "branch": branch, "date": date}, "host": socket.gethostname(), "time": time}
