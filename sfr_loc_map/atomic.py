"""Atomic outputs: a file or folder that is written through this module is either complete or absent.

Recordings (`io.bag.recorder.BagRecorder`) are written in place instead, so that they survive a crash.

An output is written in a hidden folder `.NAME.xxxxxxxx.part` beside its final path, and is renamed when it is complete.
Only regular files and empty folders are replaced; other folders are replaced on request. If the path is a link, the
target of the link is replaced. A process holds a lock on its hidden folder while it writes. The next process that
writes an output of the same name removes hidden folders without a lock, because their processes were killed.
"""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfr_loc_map.errors import OutputError
from sfr_loc_map.inputs import special_kind
from sfr_loc_map.signals import deferred_signals

SUFFIX = ".part"
BEFORE = "before"  #: Name of the previous output, which is kept in the hidden folder until the new output is in place.
_RANDOM = "[a-z0-9_]" * 8  #: Pattern of the random characters that `tempfile` puts into names.


@contextmanager
def atomic_path(path: Path, *, any_folder: bool = False) -> Iterator[Path]:
    """Yield a temporary path with the same file name.

    If the block succeeds, the output at the temporary path is moved to `path`. Otherwise the output is removed. With
    `any_folder`, a folder that is not empty is replaced, too.
    """
    target = output_target(Path(path), any_folder=any_folder)
    try:
        with _scratch(target) as scratch:
            yield scratch / target.name
            with deferred_signals():  # until the previous output is removed
                if any_folder:
                    exchange(scratch / target.name, target, scratch / BEFORE)
                else:
                    replace(scratch / target.name, target)
                shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise _cannot_write(path, error) from error


def replace_by(new: Path, path: Path) -> None:
    """Replace an output, even a folder with content, by a complete output beside it; both are kept if this fails."""
    target = output_target(path, any_folder=True)
    try:
        with deferred_signals(), _scratch(target) as scratch:  # until the previous output is removed
            exchange(new, target, scratch / BEFORE)
    except OSError as error:
        raise _cannot_write(path, error) from error


def write_text(text: str, path: Path) -> None:
    """Write a text file atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def replace(new: Path, target: Path) -> None:
    """Move a new file or folder to a target that is absent, a regular file or an empty folder."""
    _check_free(target)
    os.replace(new, target)


def exchange(new: Path, target: Path, before: Path) -> None:
    """Move a new file or folder to a target. An existing target is first moved to `before`, in a folder of `_scratch`.

    If the process ends between these two steps, the next call of `_scratch` restores the target.
    """
    if not target.exists():
        os.replace(new, target)
        return
    os.rename(target, before)
    try:
        os.rename(new, target)
    except OSError:
        os.rename(before, target)
        raise


def check_output(path: Path) -> None:
    """Raise OutputError if an output cannot be written, so that the fault is reported before the output is computed."""
    target = output_target(Path(path))
    try:
        with _scratch(target):
            pass
    except OSError as error:
        raise _cannot_write(path, error) from error


def make_folder(path: Path, advice: str) -> None:
    """Create a folder of outputs with its parents, if it does not exist; raise OutputError if this fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot create the folder '{path}': {error.strerror}; {advice}") from error


def output_target(path: Path, *, any_folder: bool = False) -> Path:
    """Return the path that is written for an output: the path itself, or the target of a link."""
    if path.is_symlink():
        try:
            path = path.resolve(strict=True)
        except (OSError, RuntimeError) as error:  # a cycle of links
            raise OutputError(
                f"cannot write '{path}': it is a broken link; remove it or choose another name"
            ) from error
    if not (any_folder and path.is_dir()):
        _check_free(path)
    return path


@contextmanager
def _scratch(target: Path) -> Iterator[Path]:
    """Yield a new, locked, hidden folder beside an output, after the removal of unlocked hidden folders.

    If the output is missing and an unlocked folder contains the previous output, the previous output is restored first.
    """
    for name in glob.glob(f".{glob.escape(target.name)}.{_RANDOM}{SUFFIX}", root_dir=target.parent):
        left = target.parent / name
        with suppress(OSError), _locked(left, fcntl.LOCK_EX | fcntl.LOCK_NB):  # a locked folder is in use
            if (left / BEFORE).exists() and not target.exists():
                os.rename(left / BEFORE, target)
            shutil.rmtree(left, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=SUFFIX, dir=target.parent))
    try:
        with _locked(folder, fcntl.LOCK_SH):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _locked(folder: Path, kind: int) -> Iterator[None]:
    """Hold a lock on a folder of this user. The lock ends with the process at the latest."""
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        try:
            fcntl.flock(lock, kind)
        except OSError:
            if kind != fcntl.LOCK_SH:  # a shared lock is optional, because some file systems have no locks
                raise
        if os.fstat(lock).st_uid != os.geteuid():
            raise PermissionError(f"'{folder}' belongs to another user")
        yield
    finally:
        os.close(lock)


def _check_free(path: Path) -> None:
    if not path.name:
        raise OutputError(f"'{path}' cannot be an output: give a path that ends in a name")
    try:
        if not path.parent.is_dir():
            raise OutputError(f"cannot write '{path}': the folder '{path.parent}' does not exist; create it first")
        kind = special_kind(path.stat().st_mode) if path.exists() else ""
        if path.is_dir() and any(path.iterdir()):
            kind = "a folder that is not empty"
    except OSError as error:
        raise _cannot_write(path, error) from error
    if kind:
        raise OutputError(f"cannot write '{path}': {kind} exists; remove it or choose another name")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write '{path}': {error.strerror or error}; check the free space and the permissions")
