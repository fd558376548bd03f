"""What a result depends on besides its task: the code and the content of the source."""

from __future__ import annotations

import hashlib
import importlib.metadata
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import hash_path

LIBRARIES = ("numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg")
"""Libraries that can change a figure."""
WITHOUT_EFFECT = frozenset({"cli", "report", "tables", "bench", "fault_injection", "suite"})
"""Parts of the package that no figure of a task depends on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceFacts:
    """What a plan needs to know of a source.

    Attributes:
        sha256: Hash of the content.
        pairs: Localisation pairs.
        nav_pairs: Mapping pairs.
    """

    sha256: str
    pairs: int
    nav_pairs: int


@dataclass(frozen=True, slots=True)
class FileStamp:
    """What changes with a file's content without reading it.

    Attributes:
        size: Bytes of all files.
        mtime_ns: Time of the last change of any.
    """

    size: int
    mtime_ns: int

    @classmethod
    def of(cls, path: Path) -> FileStamp:
        """Return the stamp of a file or folder.

        Raises:
            InputError: If it cannot be read.
        """
        try:
            files = [path] if path.is_file() else [item for item in path.rglob("*") if item.is_file()]
            stats = [item.stat() for item in files]
        except OSError as error:
            raise InputError(f"cannot read '{error.filename}': {error.strerror}; check the rights") from error
        return cls(sum(item.st_size for item in stats), max((item.st_mtime_ns for item in stats), default=0))


def inspect_source(path: Path) -> SourceFacts:
    """Return what a plan needs to know of a source.

    Raises:
        InputError: If it cannot be read.
    """
    from sfr_loc_map.io.registry import open_source  # takes half a second, and a resumed suite knows its sources

    source = open_source(path)
    counts = (0 if part is None else len(part) for part in (source.loc, source.nav))
    return SourceFacts(sha256=hash_path(path), pairs=next(counts), nav_pairs=next(counts))


@cache
def code_fingerprint() -> str:
    """Return a hash of the code and of the versions of the libraries that can change a figure."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] not in WITHOUT_EFFECT:
            digest.update(f"{place.as_posix()}\0".encode() + path.read_bytes() + b"\0")
    for name in LIBRARIES:
        digest.update(f"{name} {_version(name)}\n".encode())
    return digest.hexdigest()[:16]


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"
