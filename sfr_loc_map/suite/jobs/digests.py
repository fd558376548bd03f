"""Digests of code and data, which name results."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
import socket
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar, cast

from sfr_loc_map import __version__
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import InputError
from sfr_loc_map.hashes import hash_path, visible_files
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_settings import config_beside
from sfr_loc_map.scoring.input_files import read_files
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.suite.jobs.job import digest

T = TypeVar("T")
PACKAGE = Path(__file__).parents[2]
LIBRARIES = ("numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg", "embreex")
"""Libraries that can change a figure."""
EVALUATION_ONLY = ("report/", "suite/pages/", "suite/statistics/", "suite/history/", "live/", "bench/")
"""Folders of the package that cannot change a result, because they only show or evaluate results. All other code
is hashed, because a replay runs the command line and the nodes."""
HASHED = (".py", ".json", ".xml")  #: Suffixes of code and its data files. XML files are DDS profiles.


def file_state(path: Path) -> str:
    """Return a hash of names, sizes, modification times and inodes of a file, or of the visible files of a folder.

    Raise InputError if the path does not exist or a file is not readable.
    """
    try:
        files = visible_files(path) if path.is_dir() else [path]
        found = [[str(file), (stat := os.stat(file)).st_size, stat.st_mtime_ns, stat.st_ino] for file in files]
    except OSError as error:
        raise InputError(f"cannot read '{error.filename}': {error.strerror}; check path and permissions") from error
    return digest(found)


_cached: dict[tuple[Path, Callable[[Path], object]], tuple[str, object]] = {}


def cached(path: Path, read: Callable[[Path], T]) -> T:
    """Return the result of `read` for a path. The result is cached until the `file_state` of the path changes."""
    state = file_state(path)
    if (before := _cached.get((path, read))) is None or before[0] != state:
        before = _cached[path, read] = state, read(path)
    return cast(T, before[1])


def code_facts() -> dict[str, str]:
    """Return the hash of the code and the versions of the libraries that can change a figure."""
    return {"sfr_loc_map": cached(PACKAGE, hash_package), **_versions()}


@functools.cache
def _versions() -> dict[str, str]:
    found = ((name, importlib.metadata.distributions(name=name)) for name in LIBRARIES)
    return {name: next((there.version for there in installed), "absent") for name, installed in found}


def hash_package(root: Path) -> str:
    """Return the hash of the files of a package that can change a result."""
    found = hashlib.sha256()
    for path in visible_files(root):
        name = path.relative_to(root).as_posix()
        if path.suffix in HASHED and not name.startswith(EVALUATION_ONLY):
            found.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return found.hexdigest()[:16]


def code_fingerprint() -> str:
    """Return a hash of the code and of the versions of the libraries that can change a figure."""
    return digest(code_facts())[:16]


def input_hashes(estimate: Path, truth: Path) -> dict[str, str]:
    """Return the hashes of an estimate, its truth and its calls, by their role in the provenance of a score."""
    inputs = ScoreInputs.of(estimate, truth)
    stats = {f"stats_{number}": path for number, path in enumerate(inputs.stats)}
    named = {"estimate": inputs.estimate, "truth": inputs.truth, "cloud": inputs.cloud, "map_truth": inputs.map_truth}
    return {role: cached(file.path, hash_path) for role, file in read_files({**named, **stats}).items()}


def hash_of(paths: Sequence[Path]) -> str:
    """Return one hash of files and folders. The hash of a single file or folder is the hash of its content."""
    hashes = [cached(path, hash_path) for path in paths]
    return hashes[0] if len(hashes) == 1 else digest(hashes)


def files_of_estimate(estimate: Path, truth: Path) -> tuple[Path, ...]:
    """Return an estimate, its truth and its calls, each with the files of `files_of_source`.

    The calls are inputs of the score, because they contain findings and lost poses.
    """
    paths = (estimate, truth, *ScoreInputs.of(estimate, truth).stats)
    return tuple(file for path in paths for file in files_of_source(path))


def files_of_source(path: Path) -> tuple[Path, ...]:
    """Return a file or folder, its configuration, and the truth and the calibration that the configuration names."""
    beside = config_beside(path)
    if beside is None:
        return (path,)
    config = SourceConfig.of(Configuration.read(beside))
    calibration = Path(config.calibration.file) if config.calibration.file else None
    named = [file for file in (config.truth.file, calibration) if file is not None]
    return (path, beside, *(file for file in named if file.exists()))


def about_here(expected: Mapping[str, str]) -> dict[str, str]:
    """Return host, version and code of this worker, and the differences from the expected code (`lacks`).

    The keys are fixed, because clients of other versions read them.
    """
    found = code_facts()
    named = {"sfr_loc_map": f"other code: sfr_loc_map {__version__},"}
    differences = [
        f"{named.get(name, name)} {found.get(name)} in place of {value}"
        for name, value in expected.items()
        if found.get(name) != value
    ]
    return {
        "host": socket.gethostname(),
        "version": __version__,
        "python": platform.python_version(),
        "code": code_fingerprint(),
        "lacks": "; ".join(differences),
    }
