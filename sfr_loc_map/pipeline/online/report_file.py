"""The file of a report that is saved again and again."""

from __future__ import annotations

import os
from pathlib import Path

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.inputs import MAX_JSON_BYTES, parse_json, read_text
from sfr_loc_map.io.atomic import atomic_path, check_output, output_target
from sfr_loc_map.metrics.score_json import SCHEMA


class ReportFile:
    """Keeps the last report, and that of a run before.

    Nothing but reports is ever renamed or replaced, and the report of a run before is there until one of this run takes
    its place.
    """

    def __init__(self, path: str) -> None:
        """Touch nothing yet.

        Args:
            path: The file; empty: reports cannot be saved.
        """
        self._path = Path(path) if path else None

    def check(self) -> None:
        """Check that reports can be saved: there is a report or nothing, and its folder can be written to.

        Raises:
            OutputError: If something else is there, under the name or that of the report of a run before.
        """
        if self._path is None:
            return
        check_output(self._path)
        path = output_target(self._path)
        for file in (path, _before(path)):
            problem = _is_no_report(file)
            if problem:
                raise OutputError(
                    f"save_file '{self._path}': '{file}' {problem}; only reports are replaced: choose another name"
                )

    def keep_previous(self) -> None:
        """Rename the report of a run before to `*.before.json`: it may be all that is left of it.

        Raises:
            OutputError: If that fails, or something else is there.
        """
        if self._path is None:
            return
        self.check()
        path = output_target(self._path)
        try:
            if path.is_file():
                os.replace(path, _before(path))
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


def _before(path: Path) -> Path:
    return path.with_name(f"{path.stem}.before{path.suffix}")


def _is_no_report(file: Path) -> str:
    """Return why a file is not a report, in words; empty if it is one or is not there."""
    try:
        content = parse_json(read_text(file, MAX_JSON_BYTES))
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except ValueError:
        return "is not a report"
    return "" if isinstance(content, dict) and content.get("schema") == SCHEMA else "is not a report"
