"""The file of a report that is saved again and again."""

from __future__ import annotations

import os
from pathlib import Path

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.io.atomic import atomic_path


class ReportFile:
    """Keeps the last report, and that of a run before."""

    def __init__(self, path: str) -> None:
        """Touch nothing yet.

        Args:
            path: The file; empty: reports cannot be saved.
        """
        self._path = Path(path) if path else None

    def keep_previous(self) -> None:
        """Rename the report of a run before to `*.before.json`: it may be all that is left of it.

        Raises:
            OutputError: If that fails.
        """
        path = self._path
        try:
            if path is not None and path.exists():
                os.replace(path, path.with_name(f"{path.stem}.before{path.suffix}"))
        except OSError as error:
            raise OutputError(f"cannot keep '{path}' of the run before: {error.strerror}") from error

    def save(self, text: str) -> Path:
        """Replace the report as a whole; return its path.

        Raises:
            SfrError: If there is no path or the file cannot be written.
        """
        if self._path is None:
            raise InputError("the parameter save_file is empty: start the node with a path")
        with atomic_path(self._path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return self._path
