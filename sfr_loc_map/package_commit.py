"""The commit of the package: read from a file in a built package, and from git in a clone."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path
from typing import NamedTuple

_PACKAGE = Path(__file__).parent
_COMMIT_FILE = _PACKAGE / "commit.txt"  # written by setup.py
_QUESTIONS = (
    ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"),
    ("rev-parse", "--abbrev-ref", "HEAD"),
    ("show", "--no-patch", "--format=%cI"),
)


class PackageCommit(NamedTuple):
    """Commit, branch and date; each is None if unknown."""

    commit: str | None = None  #: Hash, with `-dirty` if files were changed.
    branch: str | None = None
    date: str | None = None  #: Time of the commit, ISO 8601.


@cache
def package_commit() -> PackageCommit:
    """Return the commit of a built package, or of the clone that contains the package."""
    if _COMMIT_FILE.is_file():
        return PackageCommit(*_COMMIT_FILE.read_text(encoding="utf-8").split())
    if not (_PACKAGE.parent / ".git").exists():
        return PackageCommit()
    return PackageCommit(*(_answer_of_git(question) for question in _QUESTIONS))


def _answer_of_git(arguments: tuple[str, ...]) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=_PACKAGE, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() or None
