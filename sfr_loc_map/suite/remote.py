"""Sources that lie elsewhere (`s3://`, `https://` and what else fsspec reads): what is there, and a copy of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.suite.task import digest

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

SEPARATOR = "://"
NOT_FOUND = 404
VERSIONS = (
    "ETag",
    "etag",
    "Content-MD5",
    "Digest",
    "LastModified",
    "Last-Modified",
    "last_modified",
    "mtime",
    "created",
)
"""What file systems name the version of a file by."""


@dataclass(frozen=True, slots=True)
class RemoteFacts:
    """What the server tells of a source without giving its content.

    Attributes:
        version: Hash of its place, of the sizes of its files, and of their versions.
        size: Bytes of all files.
    """

    version: str
    size: int


def is_remote(place: str) -> bool:
    """Tell whether a source is named by a URL."""
    return SEPARATOR in place


def expand(url: str) -> list[str]:
    """Return the URLs that match one with `*`, `?` or `[`; one without is returned as it is.

    Raises:
        InputError: If the server does not answer.
        MissingExtraError: If what reads such URLs is not installed.
    """
    if not any(sign in url.partition(SEPARATOR)[2] for sign in "*?["):
        return [url]
    system, path = _system(url)
    with _told(url):
        found = system.glob(path)
    return sorted(system.unstrip_protocol(name) for name in found)


def remote_facts(url: str, *, fresh: bool = False) -> RemoteFacts:
    """Return what the server tells of a source.

    Args:
        url: The source.
        fresh: Whether what a listing has told before does not count.

    Raises:
        InputError: If there is nothing, the server does not answer, or it tells no size or no version.
        MissingExtraError: If what reads such URLs is not installed.
    """
    system, path = _system(url)
    if fresh:
        system.invalidate_cache()
    with _told(url):
        files = _files(system, path)
    if not files:
        raise InputError(f"there is nothing at '{url}': give the URL of a bag or data set")
    listed, size = [], 0
    for name, facts in sorted(files.items()):
        told = {key: str(facts[key]) for key in VERSIONS if facts.get(key)}
        if facts.get("size") is None or not told:
            raise InputError(
                f"'{url}': the server tells no size or no version (ETag, Last-Modified); download it and give its path"
            )
        listed.append([name, int(facts["size"]), told])
        size += int(facts["size"])
    return RemoteFacts(digest([url, listed]), size)


def download(url: str, target: Path) -> None:
    """Copy a file or folder.

    Raises:
        InputError: If the server does not give it.
        MissingExtraError: If what reads such URLs is not installed.
    """
    system, path = _system(url)
    with _told(url):
        if _is_http(system) or system.isfile(path):
            system.get_file(path, str(target))
        else:
            system.get(path.rstrip("/") + "/", str(target) + "/", recursive=True)


def _files(system: AbstractFileSystem, path: str) -> Mapping[str, Mapping[str, Any]]:
    """Return the facts of each file by its name below the source."""
    if _is_http(system) or system.isfile(path):
        return {"": system.info(path)}
    root = system._strip_protocol(path)
    return {name.removeprefix(root): facts for name, facts in system.find(path, detail=True).items()}


def _is_http(system: AbstractFileSystem) -> bool:
    """Tell whether a server knows single files only: what it lists are the links of a page."""
    protocol = system.protocol
    return "http" in ((protocol,) if isinstance(protocol, str) else protocol)


def _system(url: str) -> tuple[AbstractFileSystem, str]:
    try:
        from fsspec.core import url_to_fs

        connect: Callable[..., tuple[AbstractFileSystem, str]] = url_to_fs
        return connect(url)
    except ImportError as error:
        raise MissingExtraError(
            f"'{url}' cannot be read here ({error}): pip install 'sfr_loc_map[suite]', for s3:// also s3fs"
        ) from error
    except ValueError as error:
        raise InputError(f"'{url}' cannot be read: {error}; give a path, or a URL as https:// or s3://") from error


@contextlib.contextmanager
def _told(url: str) -> Iterator[None]:
    """Tell what a server answered; each file system has errors of its own."""
    try:
        yield
    except Exception as error:
        cause = error.__cause__ or error  # a file system over HTTP says "not found" whatever was wrong
        if isinstance(cause, FileNotFoundError) or getattr(cause, "status", None) == NOT_FOUND:
            raise InputError(f"there is nothing at '{url}': give the URL of a bag or data set") from error
        reason = " ".join(f"{type(cause).__name__}: {cause}".split())
        raise InputError(f"cannot read '{url}': {reason}; check the URL, the network and the credentials") from error
