"""Digests of code, methods and data, which name results."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar, cast

from sfr_loc_map import __version__
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import Task, hash_path
from sfr_loc_map.io.source_config import config_beside
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.suite.running.job import JobSource, SourceKind, digest

T = TypeVar("T")
PACKAGE = Path(__file__).parents[2]
LIBRARIES = ("numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg", "embreex")
"""Libraries that can change a figure."""
WITHOUT_EFFECT = ("report/", "suite/pages/", "suite/statistics/", "live/", "bench/")
"""Folders of the package that a result does not depend on: they show results, or compute from them. All other code
counts, because a replay runs the command line and the nodes."""
HASHED = (".py", ".json", ".xml")  #: Endings of code and of the files that it reads; the last are profiles of DDS.


def file_state(path: Path) -> str:
    """Return a hash of names, sizes, times of change and inodes of a file or of a folder's files that are not hidden.

    InputError if there is nothing, or it may not be read.
    """
    try:
        files = [path] if path.is_file() else _files(path)
        found = [[str(file), (stat := os.stat(file)).st_size, stat.st_mtime_ns, stat.st_ino] for file in files]
    except OSError as error:
        raise InputError(f"cannot read '{error.filename}': {error.strerror}; check path and permissions") from error
    if not found and not path.is_dir():
        raise InputError(f"there is no '{path}': check that it is mounted")
    return digest(found)


def _files(folder: Path) -> list[str]:
    found: list[str] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".") and name != "__pycache__"]
        found += [os.path.join(place, name) for name in names if not name.startswith(".")]
    return sorted(found)


_known: dict[tuple[Path, Callable[[Path], object]], tuple[str, object]] = {}


def known(path: Path, read: Callable[[Path], T]) -> T:
    """Return what is read of a file or folder; it is read once as long as its `file_state` stays."""
    state = file_state(path)
    if (before := _known.get((path, read))) is None or before[0] != state:
        before = _known[path, read] = state, read(path)
    return cast(T, before[1])


def code_facts() -> dict[str, str]:
    """Return the hash of the code and the versions of the libraries that can change a figure."""
    return {"sfr_loc_map": known(PACKAGE, hash_package), **_versions()}


@functools.cache
def _versions() -> dict[str, str]:
    found = ((name, importlib.metadata.distributions(name=name)) for name in LIBRARIES)
    return {name: next((there.version for there in installed), "absent") for name, installed in found}


def hash_package(root: Path) -> str:
    """Return the hash of the files of a package that a result depends on."""
    found = hashlib.sha256()
    for name in _files(root):
        path = Path(name)
        place = path.relative_to(root).as_posix()
        if path.suffix in HASHED and not place.startswith(WITHOUT_EFFECT):
            found.update(f"{place}\0".encode() + path.read_bytes() + b"\0")
    return found.hexdigest()[:16]


def code_fingerprint() -> str:
    """Return a hash of the code and of the versions of the libraries that can change a figure."""
    return digest(code_facts())[:16]


def method_hash(spec: str, task: Task, config: str) -> str:
    """Return the hash of the file or the package that a method is loaded from, empty for built-in ones."""
    method = find_method(spec, task, config)
    package = spec.partition(":")[0].partition(".")[0]
    if method.sha256 is not None or ":" not in spec or (found := importlib.util.find_spec(package)) is None:
        return method.sha256 or ""
    where = next(iter(found.submodule_search_locations or ()), found.origin)
    return known(Path(str(where)), _hash_files) if where and os.path.exists(where) else ""


def _hash_files(path: Path) -> str:
    """Return the hash of a file, or of a folder's without what Python compiled."""
    return digest([hash_path(Path(name)) for name in ([path] if path.is_file() else _files(path))])


def data_hash(source: JobSource) -> str:
    """Return the hash of a source's data as they are here; of a simulation that of its settings.

    The data of an estimate include its truth and its calls, which hold its findings and lost poses.
    """
    if source.kind is SourceKind.SIMULATED:
        return source.sha256
    if source.kind is SourceKind.ESTIMATE:
        calls = ScoreInputs.of(Path(source.path), Path(source.truth)).stats
        return files_hash(source.path, source.truth, *map(str, calls))
    return files_hash(source.path)


def files_hash(*paths: str) -> str:
    """Return a hash of files or folders, and of the configurations by which they are read."""
    places = [Path(path) for path in paths if path]
    configurations = [path for path in map(config_beside, places) if path is not None]
    hashes = [known(path, hash_path) for path in (*places, *configurations)]
    return hashes[0] if len(hashes) == 1 else digest(hashes)


def about_here(expected: Mapping[str, str]) -> dict[str, str]:
    """Return what a worker has: host, version, code, and what it lacks of what is expected."""
    found = code_facts()
    said = {"sfr_loc_map": f"other code: sfr_loc_map {__version__},"}
    lacks = [
        f"{said.get(name, name)} {found.get(name)} in place of {value}"
        for name, value in expected.items()
        if found.get(name) != value
    ]
    return {
        "host": socket.gethostname(),
        "version": __version__,
        "python": platform.python_version(),
        "code": code_fingerprint(),
        "lacks": "; ".join(lacks),
    }
