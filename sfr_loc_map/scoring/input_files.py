"""The input files of a score, each with its state before reading. The hash of a file that changed since is refused."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.hashes import FileState, file_states, hash_path
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import is_bag

CONFIGURATION_ROLES = ("configuration", "truth_file", "calibration")
"""Roles of the files that determine how a source is read: `sfr.yaml`, and the truth and calibration named there."""


@dataclass(frozen=True, slots=True)
class ReadFile:
    """An input file or folder, whose state was noted before it was read."""

    path: Path  #: Path of the file or folder that is hashed.
    named: Path  #: Path that the user named, which may be the folder of the file.
    states: tuple[FileState, ...]  #: State of the file, or of each file in the folder.

    @classmethod
    def of(cls, path: Path, named: Path | None = None) -> ReadFile:
        """Note the state of a file or folder that will be read. A missing file is reported by its reader."""
        return cls(path, named or path, _states_of(path))

    def sha256(self) -> str:
        """Return the hash of the content; raise an InputError if the content has changed since the state was noted."""
        sha256 = hash_path(self.path)
        if _states_of(self.path) != self.states:
            raise InputError(f"'{self.path}' was changed or replaced while it was scored: score it again")
        return sha256


def read_files(paths: Mapping[str, Path | None]) -> dict[str, ReadFile]:
    """Note the states of the given files by role. For a truth in a data set folder, the file of true poses counts."""
    return {
        role: ReadFile.of(_trajectory_in(path) if role == "truth" else path, path)
        for role, path in paths.items()
        if path is not None
    }


def configuration_files(how: SourceConfig) -> dict[str, Path | None]:
    """Return the files that determine how a source is read, by role; None if there is no such file."""
    calibration = Path(how.calibration.file) if how.calibration.file else None
    if calibration is not None and not calibration.exists():
        calibration = None
    return {"configuration": how.configuration.path, "truth_file": how.truth.file, "calibration": calibration}


def _states_of(path: Path) -> tuple[FileState, ...]:
    """Return the states of the files at a path; empty if they cannot be read, which their reader reports."""
    with suppress(OSError):
        return file_states(path)
    return ()


def _trajectory_in(path: Path) -> Path:
    """Return the file of true poses of a data set folder, or the path of another source."""
    if not path.is_dir() or is_bag(path):
        return path
    places = [path / "groundtruth.csv", path / "loc" / "groundtruth.csv"]
    return next((place for place in places if place.is_file()), path)
