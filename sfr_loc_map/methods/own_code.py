"""The own code of a method: the files and folders that identify the item under test, and their hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path

from sfr_loc_map.hashes import FileState, file_states, hash_path, is_ignored
from sfr_loc_map.metrics.figures.records import MethodKind

CODE = ("*.py", "*.so", "*.so.*")  #: File patterns of modules and libraries.


def code_of(kind: MethodKind, adapter: str, target: str) -> list[Path]:
    """Return the files and folders of a method's own code. The arguments are the fields of a `registry.Method`.

    An adapter with an absolute path, a library, and a class in a file contribute the file and the code beside it. A
    class in an importable module contributes the complete top-level package, or the single module.
    """
    code = _code_beside(Path(adapter)) if Path(adapter).is_absolute() else []
    if kind is MethodKind.LIBRARY:
        return [*code, *_code_beside(Path(target))]
    if kind is not MethodKind.PYTHON:
        return code
    place = target.rpartition(":")[0]
    if place.endswith(".py"):
        return [*code, *_code_beside(Path(place))]
    found = _package(place.partition(".")[0])
    if found is None:
        return code
    folders = found.submodule_search_locations
    return [*code, *map(Path, folders if folders is not None else [found.origin or ""])]


def has_module(place: str) -> bool:
    """Return whether a module, such as `package.module`, exists in the working directory or is installed.

    Packages are not imported, because this could run the code of a method in the process of the suite.
    """
    package, *parts = place.split(".")
    found = _package(package)
    for depth in range(len(parts)):
        if found is None or found.submodule_search_locations is None:
            return False
        name = ".".join([package, *parts[: depth + 1]])
        found = PathFinder.find_spec(name, found.submodule_search_locations)
    return found is not None


def _package(name: str) -> ModuleSpec | None:
    """Return the specification of a top-level module or package; None if it does not exist."""
    if name == "__main__":  # a different module in each process
        return None
    found = PathFinder.find_spec(name, [str(Path.cwd())])
    if found is not None:
        return found
    try:
        return find_spec(name)
    except ValueError:  # an imported module without a specification
        return None


def _code_beside(file: Path) -> list[Path]:
    """Return a file, and all modules, libraries and packages in its folder."""
    folder = file.parent
    modules = [path for pattern in CODE for path in folder.glob(pattern)]
    packages = [path.parent for path in folder.glob("*/__init__.py")]
    return [file, *sorted({*modules, *packages} - {file})]


def unhashed_of(code: Sequence[Path]) -> Iterator[Path]:
    """Yield the files and folders in and beside a method's own code that the hash of this code ignores.

    Python would load compiled code from these folders in place of the sources. Links are omitted, because isolation
    applies to their targets.
    """
    for path in code:
        entries = path.iterdir() if path.is_dir() else [path.parent / "__pycache__"]
        for entry in entries:
            if entry.is_symlink() or not entry.exists():
                continue
            if is_ignored(entry):
                yield entry
            elif entry.is_dir():
                yield from unhashed_of([entry])


def code_state(kind: MethodKind, adapter: str, target: str) -> tuple[FileState, ...]:
    """Return the state of the files of a method's own code, which differs after a file was written or replaced."""
    return tuple(state for path in code_of(kind, adapter, target) if path.exists() for state in file_states(path))


def code_sha256(kind: MethodKind, adapter: str, target: str) -> str | None:
    """Return the hash of a method's own code; None if no file of the code is known.

    The hash of a single file is that of its content. Installed packages that the method imports are not part of the
    hash. Files in SFR_METHOD_FILES are part of the hash of the configuration (`Method.record`).
    """
    hashes = [hash_path(path) for path in code_of(kind, adapter, target) if path.exists()]
    if len(hashes) < 2:
        return next(iter(hashes), None)
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()
