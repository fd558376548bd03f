"""The file to which the monitor saves its score."""

from __future__ import annotations

import os
from pathlib import Path

from sfr_loc_map.atomic import check_output, output_target, write_text
from sfr_loc_map.errors import OutputError
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.metrics.score.score import SCHEMA


class ScoreFile:
    """The file to which the score is saved, and the file of the previous run's score.

    Existing files that are not scores are never replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def check(self) -> None:
        """Raise an OutputError if the folder is not writable, or if an existing file is not a score."""
        check_output(self._path)
        path = output_target(self._path)
        for file in (path, _before(path)):
            try:
                content = parse_json(read_text(file, MAX_JSON_BYTES))
            except FileNotFoundError:
                continue
            except (OSError, ValueError):
                content = None
            if not isinstance(content, dict) or content.get("schema") != SCHEMA:
                raise OutputError(f"save_file '{self._path}': '{file}' is not a score: choose another name")

    def keep_previous(self) -> None:
        """Rename the score of the previous run to `*.before.json`, because it may be the only record of that run."""
        self.check()
        path = output_target(self._path)
        try:
            if path.is_file():
                os.replace(path, _before(path))
        except OSError as error:
            raise OutputError(
                f"cannot rename the score '{path}' of the previous run: {error.strerror}; move it or choose "
                "another name"
            ) from error

    def save(self, text: str) -> Path:
        """Replace the score atomically; return its path."""
        write_text(text, self._path)
        return self._path


def _before(path: Path) -> Path:
    return path.with_name(f"{path.stem}.before{path.suffix}")
