"""Hashes of inputs, so that a result says what it was made of."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError


def hash_path(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files: their relative names and hashes, in the order of names.

    Hidden files are left out of a folder's hash.

    Raises:
        InputError: If the path is missing or cannot be read.
    """
    path = Path(path)
    try:
        if path.is_file():
            return _hash_file(path)
        files = sorted((file.relative_to(path).as_posix(), file) for file in path.rglob("*") if file.is_file())
        if not path.is_dir():
            raise InputError(f"there is no '{path}' to hash: give a file or folder")
        digest = hashlib.sha256()
        for name, file in files:
            if not any(part.startswith(".") for part in name.split("/")):
                digest.update(f"{name}\0{_hash_file(file)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise InputError(f"cannot read '{error.filename}' to hash it: {error.strerror}; check the rights") from error


def hash_arrays(arrays: Iterable[NDArray[np.generic]]) -> str:
    """Return the SHA-256 of the shapes, types and bytes of arrays, in their order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _hash_file(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
