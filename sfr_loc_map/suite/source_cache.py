"""Copies of remote sources in a folder of bounded size, shared by the tasks of a host.

fetched/NAME/...      a copy, whole
fetched/NAME.part     a copy in the making; its size is in NAME.json from the beginning
fetched/NAME.json     size and hash
fetched/NAME.lock     held shared by the tasks that read the copy, exclusively by the one that makes or removes it

What was used longest ago is removed first, never what a task reads. Locks end with their process, so a task that is
killed leaves nothing that stays.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.inputs import hash_path
from sfr_loc_map.suite.fingerprint import FileStamp
from sfr_loc_map.suite.remote import download, remote_facts

FOLDER = "fetched"
TRIES = 3
PAUSE_S = 2.0
WAIT_S = 0.2
LOCK_POLL_S = 0.02
_held: list[int] = []
"""Locks of the copies that this process reads, until it ends."""


class SourceCache:
    """Copies of remote sources."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        """Open or make it.

        Args:
            folder: Folder of all caches.
            limit_bytes: Size of all copies together.
        """
        self._folder, self._limit = folder / FOLDER, limit_bytes
        self._folder.mkdir(parents=True, exist_ok=True)

    def fetch(self, url: str, version: str, sha256: str = "") -> Path:
        """Return a copy of a source, which stays until this process ends.

        Args:
            url: The source.
            version: Of the content that is wanted, as `remote_facts` tells it.
            sha256: Hash of the content, empty where it is not known.

        Raises:
            InputError: If it cannot be read, has changed, has another hash, or is larger than the cache.
        """
        copy = self._folder / version
        lock = os.open(self._folder / f"{version}.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            while True:
                fcntl.flock(lock, fcntl.LOCK_SH)
                if self._is_whole(copy):
                    os.utime(self._folder / f"{version}.lock")
                    _held.append(lock)
                    return copy / _name(url)
                fcntl.flock(lock, fcntl.LOCK_UN)
                try:  # who waits here would wait for all that use a copy made meanwhile
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(LOCK_POLL_S)
                    continue
                if not self._is_whole(copy):  # nobody else has made it meanwhile
                    self._make(url, copy, sha256)
        except BaseException:
            os.close(lock)
            raise

    def _is_whole(self, copy: Path) -> bool:
        """Tell whether a copy is there and as it was made."""
        with suppress(OSError, ValueError, KeyError):
            facts = json.loads(_facts_path(copy).read_text(encoding="utf-8"))
            stamp = FileStamp.of(copy)
            return copy.is_dir() and [stamp.size, stamp.mtime_ns] == facts["stamp"]
        return False

    def _make(self, url: str, copy: Path, sha256: str) -> None:
        """Download a source; its lock is held."""
        _remove(copy)
        size = self._checked_size(url, copy.name)
        self._reserve(url, copy, size)
        part = copy.with_name(f"{copy.name}.part")
        try:
            part.mkdir()
            _patiently(url, part / _name(url))
            self._checked_size(url, copy.name)
            found = hash_path(part / _name(url))
            if sha256 and found != sha256:
                raise InputError(
                    f"'{url}' has the SHA-256 {found}, the suite's file says {sha256}: correct one of them"
                )
            stamp = FileStamp.of(part)
            if stamp.size != size:
                raise InputError(f"'{url}': {stamp.size} bytes came of {size}; try again")
            _write_facts(copy, {"url": url, "size": size, "sha256": found, "stamp": [size, stamp.mtime_ns]})
            os.rename(part, copy)
        except BaseException:
            _remove(copy)
            raise

    def _checked_size(self, url: str, version: str) -> int:
        facts = remote_facts(url, fresh=True)
        if facts.version != version:
            raise InputError(f"'{url}' has changed since the suite was planned: run the suite again")
        if facts.size > self._limit:
            raise InputError(
                f"'{url}' has {facts.size / 1e6:.0f} MB, the cache {self._limit / 1e6:.0f} MB: raise 'cache_mb'"
            )
        return facts.size

    def _reserve(self, url: str, copy: Path, size: int) -> None:
        """Make room and take it; wait for the end of other tasks where all copies are in use."""
        while True:
            with self._accounts():
                if self._make_room(copy, size):
                    _write_facts(copy, {"url": url, "size": size})
                    return
            time.sleep(WAIT_S)

    def _make_room(self, copy: Path, size: int) -> bool:
        sizes = {path: _size(path) for path in self._folder.glob("*.json") if path != _facts_path(copy)}
        used = sum(sizes.values())
        for path in sorted(sizes, key=_last_use):
            if used + size <= self._limit:
                break
            if _removed(path.with_suffix("")):
                used -= sizes[path]
        return used + size <= self._limit

    @contextmanager
    def _accounts(self) -> Iterator[None]:
        """Let one process at a time count what there is."""
        with (self._folder / ".lock").open("w") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)
            yield


def _name(url: str) -> str:
    """Return the file name of a source: formats are known by their endings."""
    return url.partition("?")[0].rstrip("/").rpartition("/")[2] or "source"


def _patiently(url: str, target: Path) -> None:
    """Download, in a few tries."""
    for number in range(1, TRIES + 1):
        try:
            return download(url, target)
        except SfrError:
            if number == TRIES:
                raise
        shutil.rmtree(target, ignore_errors=True)
        target.unlink(missing_ok=True)
        time.sleep(PAUSE_S * number)
    return None


def _facts_path(copy: Path) -> Path:
    return copy.with_name(f"{copy.name}.json")


def _write_facts(copy: Path, facts: dict[str, object]) -> None:
    """Write the facts in one step: others read them at any time."""
    temporary = copy.with_name(f"{copy.name}.json.new")
    temporary.write_text(json.dumps(facts), encoding="utf-8")
    os.replace(temporary, _facts_path(copy))


def _size(facts: Path) -> int:
    with suppress(OSError, ValueError, KeyError):
        return int(json.loads(facts.read_text(encoding="utf-8"))["size"])
    return 0


def _last_use(facts: Path) -> float:
    with suppress(OSError):
        return facts.with_suffix(".lock").stat().st_mtime
    return 0.0


def _removed(copy: Path) -> bool:
    """Remove a copy that nobody reads or makes; return whether it is gone."""
    lock = os.open(copy.with_name(f"{copy.name}.lock"), os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove(copy)
        return True
    except BlockingIOError:
        return False
    finally:
        os.close(lock)


def _remove(copy: Path) -> None:
    """Remove a copy, whole or in the making; its lock is held. It loses its name first: half a copy has none."""
    part = copy.with_name(f"{copy.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    with suppress(FileNotFoundError):
        os.rename(copy, part)
    shutil.rmtree(part, ignore_errors=True)
    _facts_path(copy).unlink(missing_ok=True)
