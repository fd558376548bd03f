"""SHA-256 of files, folders and arrays, by which results name their inputs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.errors import InputError

if TYPE_CHECKING:  # not needed for files
    import numpy as np
    from numpy.typing import NDArray


def hash_path(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and hashes of all files in a folder that are not hidden."""
    path = Path(path)
    try:
        if path.is_file():
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        if not path.is_dir():
            raise InputError(f"cannot hash '{path}': it does not exist; give a file or folder")
        digest = hashlib.sha256()
        for name, file in sorted((file.relative_to(path).as_posix(), file) for file in path.rglob("*")):
            if file.is_file() and not any(part.startswith(".") for part in name.split("/")):
                digest.update(f"{name}\0{hash_path(file)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise InputError(f"cannot hash '{error.filename}': {error.strerror}; check the permissions") from error


def hash_arrays(arrays: Iterable[NDArray[np.generic]]) -> str:
    """Return the SHA-256 of the shapes, types and bytes of arrays, in their order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
