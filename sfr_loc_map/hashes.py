"""SHA-256 of files, folders and arrays, by which results identify their inputs, and the state of hashed files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import missing

if TYPE_CHECKING:  # files are hashed without importing numpy
    import numpy as np
    from numpy.typing import NDArray


def hash_path(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and hashes of all visible files in a folder (`visible_files`)."""
    path = Path(path)
    try:
        if path.is_file():
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        if not path.is_dir():
            raise InputError(f"{missing(path)}; give a file or folder")
        digest = hashlib.sha256()
        for file in hashed_files(path):
            digest.update(f"{file.relative_to(path).as_posix()}\0{hash_path(file)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise InputError(f"cannot hash '{error.filename}': {error.strerror}; check the permissions") from error


def hashed_files(path: Path) -> list[Path]:
    """Return the files that `hash_path` reads: the given file, or those in the given folder; empty without the path."""
    files = visible_files(path) if path.is_dir() else [path]
    return [file for file in files if file.is_file()]


class FileState(NamedTuple):
    """Attributes of a file that change if the file is replaced or written.

    The time of the last change of an inode cannot be set, so that the state also differs after the former content was
    restored.
    """

    path: str
    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int


def file_states(path: Path) -> tuple[FileState, ...]:
    """Return the state of a file, or of each file that `hash_path` reads in a folder.

    Raises OSError if a folder cannot be listed or a file does not exist.
    """
    states = ((str(file), file.stat()) for file in hashed_files(path))
    return tuple(
        FileState(name, found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
        for name, found in states
    )


def is_ignored(path: Path) -> bool:
    """Return whether the hash of a folder ignores an entry: hidden files and folders, and compiled Python code."""
    return path.name.startswith(".") or path.name == "__pycache__"


def visible_files(folder: Path) -> list[Path]:
    """Return the files below a folder, sorted by path; raise OSError if a folder is not readable.

    Links to folders are followed, because the readers of data sets follow them. Entries for which `is_ignored` is true
    are excluded.
    """
    return sorted(_visible_files(folder, ()), key=str)


def _visible_files(folder: Path, above: tuple[tuple[int, int], ...]) -> Iterator[Path]:
    """Yield the files of a folder; `above` identifies the enclosing folders, to which a link could lead back."""
    state = folder.stat()
    identity = (state.st_dev, state.st_ino)
    if identity in above:
        return
    for path in folder.iterdir():
        if is_ignored(path):
            continue
        if path.is_dir():
            yield from _visible_files(path, (*above, identity))
        else:
            yield path


def hash_arrays(arrays: Iterable[NDArray[np.generic]]) -> str:
    """Return the SHA-256 of the shapes, types and bytes of arrays, in their order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
