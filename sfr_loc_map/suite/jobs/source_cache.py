"""The files of the sources: rendered simulations and fetched recordings are created once in the cache of a suite."""

from __future__ import annotations

import contextlib
import fcntl
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.digests import code_fingerprint, digest
from sfr_loc_map.suite.jobs.sources import PlannedSource, Simulation

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem


def local_path(source: PlannedSource, cache: Path) -> Path:
    """Return the path at which a job reads a source; a simulation is rendered to `cache`."""
    return rendered(source, cache) if isinstance(source, Simulation) else Path(source.path)


def rendered(source: Simulation, cache: Path) -> Path:
    """Return the path of a simulated source, which is rendered once for all jobs of the same code.

    The renderings of the source by other code are removed.
    """
    from sfr_loc_map.simulation.simulate import simulate  # slow import

    config = build(SimulationConfig, source.settings)
    target = cache / f"simulated-{source.sha256}-{code_fingerprint()}"

    def render(out: Path) -> None:
        for other in cache.glob(f"simulated-{source.sha256}*"):
            if other.is_dir():
                shutil.rmtree(other, ignore_errors=True)
        simulate(config, out, workers=1)

    return _created_once(target, render)


def fetch(url: str, cache: Path) -> Path:
    """Return the path of the local copy of a remote source; a new version on the server is fetched again."""
    with _opened(url) as (system, path):
        system.invalidate_cache()
        protocols = (system.protocol,) if isinstance(system.protocol, str) else system.protocol
        # HTTP has no folders; a listing would return the links of a page
        one = "http" in protocols or system.isfile(path)
        files = {path: system.info(path)} if one else system.find(path, detail=True)
        if not files:
            raise FileNotFoundError(url)
        # the name is kept, because formats are detected by suffix
        name = last_part(url) or "source"

        def get(folder: Path) -> None:
            folder.mkdir()
            if one:
                system.get_file(path, str(folder / name))
            else:
                system.get(path.rstrip("/") + "/", f"{folder / name}/", recursive=True)

        version = digest([url, [[file, str(facts)] for file, facts in sorted(files.items())]])
        return _created_once(cache / "fetched" / version, get) / name


def _created_once(target: Path, create: Callable[[Path], object]) -> Path:
    """Return a folder that the first caller creates while other callers wait."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.with_name(f"{target.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not target.is_dir():
            with atomic_path(target) as part:
                create(part)
    return target


def last_part(path: str) -> str:
    """Return the name of a file or folder in a path or a URL, without the query of the URL."""
    location = path.partition("?")[0] if "://" in path else path
    return location.rstrip("/").rpartition("/")[2]


def expand(url: str) -> list[str]:
    """Return the URLs that match a pattern with `*`, `?` or `[`; return other URLs unchanged."""
    if not any(sign in url.partition("://")[2] for sign in "*?["):
        return [url]
    with _opened(url) as (system, path):
        return sorted(system.unstrip_protocol(name) for name in system.glob(path))


@contextlib.contextmanager
def _opened(url: str) -> Iterator[tuple[AbstractFileSystem, str]]:
    """Yield the file system and the path of a URL; errors of the file system become InputError."""
    try:
        from fsspec.core import url_to_fs

        opened: tuple[AbstractFileSystem, str] = url_to_fs(url)
    except ImportError as error:
        raise MissingExtraError(
            f"'{url}' cannot be read here ({error}): pip install 'sfr_loc_map[suite]', for s3:// also s3fs"
        ) from error
    except ValueError as error:
        raise InputError(f"'{url}' cannot be read: {error}; give a path, or a URL such as https:// or s3://") from error
    try:
        yield opened
    except Exception as error:
        cause = error.__cause__ or error
        reason = one_line(f"{type(cause).__name__}: {cause}")
        raise InputError(f"cannot read '{url}': {reason}; check the URL, the network and the credentials") from error
