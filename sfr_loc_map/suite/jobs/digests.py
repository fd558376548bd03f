"""Digests of values, files and code, which name results. The digest of a file is cached while its state is equal."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar, cast

from sfr_loc_map.errors import InputError
from sfr_loc_map.hashes import hash_path, visible_files
from sfr_loc_map.metrics.stored.score_json import to_plain

T = TypeVar("T")
KEY_LENGTH = 32  #: Hexadecimal digits of a digest. The probability of a collision among 10^9 results is 10^-21.
PACKAGE = Path(__file__).parents[2]
LIBRARIES = ("numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg", "embreex")
"""Libraries that can change a figure."""
EVALUATION_ONLY = ("report/", "suite/pages/", "suite/statistics/", "suite/history/", "live/", "bench/")
"""Folders of the package that cannot change a result, because they only show or evaluate results. All other code
is hashed, because a replay runs the command line and the nodes."""
HASHED = (".py", ".json", ".xml")  #: Suffixes of code and its data files. XML files are DDS profiles.


def digest(value: object) -> str:
    """Return the hash of records and plain values, as JSON with sorted keys."""
    text = json.dumps(to_plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]


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


def hash_of(paths: Sequence[Path]) -> str:
    """Return one hash of files and folders. The hash of a single file or folder is the hash of its content."""
    hashes = [cached(path, hash_path) for path in paths]
    return hashes[0] if len(hashes) == 1 else digest(hashes)
