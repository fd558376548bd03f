"""The own code of a method: the files and folders that identify the item under test, and their hash."""

from __future__ import annotations

import hashlib
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from sfr_loc_map.hashes import hash_path, visible_files
from sfr_loc_map.metrics.table.records import MethodKind

CODE = ("*.py", "*.so", "*.so.*")  #: File patterns of modules and libraries.


class Loaded(Protocol):
    """What states where the code of a method is (`registry.Method`)."""

    @property
    def kind(self) -> MethodKind: ...  # noqa: D102 - see `Method`

    @property
    def adapter(self) -> str: ...  # noqa: D102

    @property
    def target(self) -> str: ...  # noqa: D102


def code_of(method: Loaded) -> list[Path]:
    """Return the files and folders of a method's own code; for a class in a package, only the package or module."""
    code = _code_beside(Path(method.adapter)) if Path(method.adapter).is_absolute() else []
    if method.kind is MethodKind.LIBRARY:
        return [*code, *_code_beside(Path(method.target))]
    if method.kind is not MethodKind.PYTHON:
        return code
    place = method.target.rpartition(":")[0]
    if place.endswith(".py"):
        return [*code, *_code_beside(Path(place))]
    package = place.partition(".")[0]
    found = PathFinder.find_spec(package, [str(Path.cwd())]) or find_spec(package)
    if found is None:
        return code
    folders = found.submodule_search_locations
    return [*code, *map(Path, folders if folders is not None else [found.origin or ""])]


def _code_beside(file: Path) -> list[Path]:
    """Return a file, and all modules, libraries and packages in its folder."""
    folder = file.parent
    modules = [path for pattern in CODE for path in folder.glob(pattern)]
    packages = [path.parent for path in folder.glob("*/__init__.py")]
    return [file, *sorted({*modules, *packages} - {file})]


def code_sha256(method: Loaded) -> str | None:
    """Return the hash of a method's own code; None if the code is not known as files.

    The hash of a single file is that of its content. Files in SFR_METHOD_FILES, and installed packages that the method
    imports, are not part of the hash.
    """
    hashes = [hash_code(path) for path in code_of(method) if path.exists()]
    if len(hashes) < 2:
        return next(iter(hashes), None)
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def hash_code(path: Path) -> str:
    """Return the hash of a file, or of the files of a folder without compiled Python code."""
    if path.is_file():
        return hash_path(path)
    return hashlib.sha256("\n".join(map(hash_path, visible_files(path))).encode()).hexdigest()
