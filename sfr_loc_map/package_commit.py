"""The commit of the installed package."""

from __future__ import annotations

from pathlib import Path

_COMMIT_FILE = Path(__file__).with_name("commit.txt")  # setup.py writes it
GIT = _COMMIT_FILE.read_text(encoding="utf-8").split() if _COMMIT_FILE.is_file() else []
"""Commit of the package, with `-dirty` if files were changed, branch and date of the build; empty if unknown."""
COMMIT = GIT[0] if GIT else None
