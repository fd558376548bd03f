"""Sources that have to be made or fetched first: simulated ones, and those that lie elsewhere (what fsspec reads)."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.config import build
from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.inputs import hash_path
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.job import JobSource, SourceKind, digest

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

FETCHED = "fetched"  #: Folder of the copies of remote sources in the cache, a folder each.
VERSION_FACTS = {"etag", "content-md5", "digest", "lastmodified", "last-modified", "last_modified", "mtime", "created"}
"""What file systems name the version of a file by, in small letters."""


def local_path(source: JobSource, cache: Path) -> Path:
    """Return the place of a source here; a simulation is rendered once, a remote source is fetched once for all jobs.

    Raises InputError if a remote source cannot be read, has changed, or has another hash.
    """
    if source.kind is SourceKind.SIMULATED:
        from sfr_loc_map.pipeline.simulate import simulate

        config = build(SimulationConfig, source.settings)
        return _made_once(cache / f"simulated-{source.sha256}", lambda out: simulate(config, out, workers=1))
    if source.kind is SourceKind.REMOTE:
        # formats are known by their endings, so the name stays
        name = source.path.partition("?")[0].rstrip("/").rpartition("/")[2] or "source"
        return _made_once(cache / FETCHED / source.version, lambda out: _fetch(source, out / name)) / name
    return Path(source.path)


def trim_copies(cache: Path, limit_bytes: int) -> None:
    """Remove the copies of remote sources that were made longest ago, beyond a size of all together."""
    copies = [path for path in (cache / FETCHED).glob("*") if path.is_dir()]
    total = 0
    for copy in sorted(copies, key=lambda path: path.stat().st_mtime, reverse=True):
        total += sum(item.stat().st_size for item in copy.rglob("*") if item.is_file())
        if total > limit_bytes:
            shutil.rmtree(copy)


def _made_once(target: Path, make: Callable[[Path], object]) -> Path:
    """Return a folder, made by whoever asks first; a process that ends half way leaves nothing under its name."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.with_name(f"{target.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not target.is_dir():
            part = target.with_name(f"{target.name}.part")
            shutil.rmtree(part, ignore_errors=True)
            try:
                make(part)
                os.rename(part, target)
            finally:
                shutil.rmtree(part, ignore_errors=True)
    return target


def expand(url: str) -> list[str]:
    """Return the URLs that match one with `*`, `?` or `[`; one without is returned as it is.

    Raises InputError if the server does not answer.
    """
    if not any(sign in url.partition("://")[2] for sign in "*?["):
        return [url]
    with _opened(url) as (system, path):
        return sorted(system.unstrip_protocol(name) for name in system.glob(path))


def remote_version(url: str) -> str:
    """Return a hash of the place of a source and of what its server tells of each file: size, ETag, Last-Modified.

    Raises InputError if there is nothing, the server does not answer, or it tells no size or no version.
    """
    with _opened(url) as (system, path):
        system.invalidate_cache()
        if _is_file(system, path):
            files = {"": system.info(path)}
        else:
            root = system._strip_protocol(path)
            files = {name.removeprefix(root): facts for name, facts in system.find(path, detail=True).items()}
        if not files:
            raise FileNotFoundError(url)
    listed = []
    for name, facts in sorted(files.items()):
        told = {key: str(value) for key, value in facts.items() if value and key.lower() in VERSION_FACTS}
        if facts.get("size") is None or not told:
            raise InputError(
                f"'{url}': the server tells no size or no version (ETag, Last-Modified); download it and give its path"
            )
        listed.append([name, int(facts["size"]), told])
    return digest([url, listed])


def _fetch(source: JobSource, target: Path) -> None:
    url = source.path
    target.parent.mkdir()
    if remote_version(url) != source.version:
        raise InputError(f"'{url}' has changed since the suite was planned: run the suite again")
    with _opened(url) as (system, path):
        if _is_file(system, path):
            system.get_file(path, str(target))
        else:
            system.get(path.rstrip("/") + "/", str(target) + "/", recursive=True)
    if source.content_sha256 and (found := hash_path(target)) != source.content_sha256:
        raise InputError(
            f"'{url}' has the SHA-256 {found}, the suite's file says {source.content_sha256}: correct one of them"
        )


def _is_file(system: AbstractFileSystem, path: str) -> bool:
    """Tell whether a source is one file; over HTTP there are no others, what is listed are the links of a page."""
    protocols = (system.protocol,) if isinstance(system.protocol, str) else system.protocol
    return "http" in protocols or bool(system.isfile(path))


@contextlib.contextmanager
def _opened(url: str) -> Iterator[tuple[AbstractFileSystem, str]]:
    """Yield the file system and the path of a URL; tell what a server answered, each has errors of its own."""
    try:
        from fsspec.core import url_to_fs

        opened: tuple[AbstractFileSystem, str] = url_to_fs(url)
    except ImportError as error:
        raise MissingExtraError(
            f"'{url}' cannot be read here ({error}): pip install 'sfr_loc_map[suite]', for s3:// also s3fs"
        ) from error
    except ValueError as error:
        raise InputError(f"'{url}' cannot be read: {error}; give a path, or a URL as https:// or s3://") from error
    try:
        yield opened
    except Exception as error:
        cause = error.__cause__ or error  # a file system over HTTP says "not found" whatever was wrong
        if isinstance(cause, FileNotFoundError) or getattr(cause, "status", None) == 404:
            raise InputError(f"there is nothing at '{url}': give the URL of a bag or data set") from error
        reason = " ".join(f"{type(cause).__name__}: {cause}".split())
        raise InputError(f"cannot read '{url}': {reason}; check the URL, the network and the credentials") from error
