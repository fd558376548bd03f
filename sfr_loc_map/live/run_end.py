"""How a run ended, which the process of the run reports to the process of its page through a file."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from sfr_loc_map.atomic import write_text


class RunEnd(msgspec.Struct, frozen=True):
    """The end of a run."""

    score: str = ""  #: JSON score of the complete run, which replaces the score of the monitor.
    aborted: str = ""  #: Cause of an abort.
    report: str = ""  #: Path of the HTML report.

    def write(self, path: Path) -> None:
        """Replace the file; a failure is ignored, because the run must not depend on its page."""
        with suppress(OSError):
            write_text(msgspec.json.encode(self).decode(), path)

    @staticmethod
    def version(path: Path) -> tuple[int, int] | None:
        """Return inode and time of change of a file, which differ after each `write`; None without a file."""
        with suppress(OSError):
            status = path.stat()
            return status.st_ino, status.st_mtime_ns
        return None

    @staticmethod
    def read(path: Path) -> RunEnd | None:
        """Return the content of a file; None before the file is written."""
        try:
            content = path.read_bytes()
        except OSError:
            return None
        return msgspec.json.decode(content, type=RunEnd)

    def report_page(self) -> bytes:
        """Return the HTML report; empty without a readable report."""
        with suppress(OSError):
            return Path(self.report).read_bytes() if self.report else b""
        return b""


@dataclass(slots=True)
class ShownEnd:
    """The end of a run as the views show it; without values during the run."""

    at_s: float | None = None  #: Time of the end, s.
    aborted_by: str = ""  #: Cause of an abort; empty if there is none.
    aborted_s: float = 0.0  #: Time of the abort, s.
    report_page: bytes = b""  #: HTML report; empty if there is none.
    has_score: bool = False  #: Whether the shown score is that of the complete run, which no other score replaces.

    @property
    def is_over(self) -> bool:
        """Whether the run is over."""
        return self.at_s is not None
