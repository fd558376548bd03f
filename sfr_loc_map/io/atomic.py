"""Outputs that are either whole or not there: one rule for every file and folder that the suite writes.

What is written lies in a hidden folder `.NAME.xxxxxxxx.part` beside the output until it is whole, and takes its name in
one step. Only a regular file or an empty folder is replaced; a link stays, and what it points to is replaced. A process
that is killed leaves its hidden folder, which the next one that writes to the same name removes: each process holds a
lock on its own, so that those of others at work are left alone.
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

SUFFIX = ".part"
_RANDOM = "[a-z0-9_]" * 8
"""What `tempfile` puts into names."""
_ATTEMPTS = 10


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a file or folder that takes the name `path` when the block ends well.

    It has the same file name (writers choose the format by its ending) and lies in a hidden folder beside
    `path`, so that the final renaming is one step of the file system. When the block raises, nothing is left.

    Args:
        path: Where the output shall be. An existing file is replaced at the end; an existing folder must be empty.

    Yields:
        The path to write to; neither a file nor a folder is there yet.

    Raises:
        OutputError: If the folder of `path` is missing or not writable, `path` is a folder that is not empty, a device,
            a pipe or a link to nothing, or the file system refuses.
    """
    target = output_target(Path(path))
    try:
        with _scratch(target) as scratch:
            yield scratch / target.name
            _check_free(target)
            os.replace(scratch / target.name, target)
    except OSError as error:
        raise _cannot_write(path, error) from error


def check_output(path: Path) -> None:
    """Check that an output can be written, before the work for it is done.

    Raises:
        OutputError: As `atomic_path`.
    """
    target = output_target(Path(path))
    try:
        with _scratch(target):
            pass
    except OSError as error:
        raise _cannot_write(path, error) from error


def output_target(path: Path) -> Path:
    """Return what is written or replaced for an output: the path, or what the link there points to.

    Raises:
        OutputError: If that cannot be an output.
    """
    if path.is_symlink():
        try:
            path = path.resolve(strict=True)
        except (OSError, RuntimeError) as error:  # a circle of links
            raise OutputError(
                f"cannot write '{path}': it is a link to nothing; remove it or choose another name"
            ) from error
    _check_free(path)
    return path


@contextmanager
def _scratch(target: Path) -> Iterator[Path]:
    """Yield a new, locked, hidden folder beside an output, after those that nobody holds were removed."""
    _remove_abandoned(target)
    folder, lock = _locked_folder(target)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _locked_folder(target: Path) -> tuple[Path, int]:
    """Return a new folder and its lock, which ends with the process; until it is locked another may remove it."""
    for _ in range(_ATTEMPTS):
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=SUFFIX, dir=target.parent))
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_SH)
        if folder.exists():
            return folder, lock
        os.close(lock)
    raise OSError(f"its temporary folder was removed {_ATTEMPTS} times")


def _remove_abandoned(target: Path) -> None:
    """Remove the hidden folders of processes that were killed while they wrote to the same name."""
    for name in glob.glob(f".{glob.escape(target.name)}.{_RANDOM}{SUFFIX}", root_dir=target.parent):
        folder = target.parent / name
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(lock).st_uid == os.geteuid():
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            pass  # it is at work, or there are no locks here
        finally:
            os.close(lock)


def _check_free(path: Path) -> None:
    if not path.name:
        raise OutputError(f"'{path}' cannot be an output: give a path that ends in a name")
    try:
        if not path.parent.is_dir():
            raise OutputError(f"cannot write '{path}': there is no folder '{path.parent}'; make it first")
        kind = special_kind(path.stat().st_mode) if path.exists() else ""
        if path.is_dir() and any(path.iterdir()):
            kind = "a folder that is not empty"
    except OSError as error:
        raise _cannot_write(path, error) from error
    if kind:
        raise OutputError(f"cannot write '{path}': {kind} is there; remove it or choose another name")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"cannot write '{path}': {reason}; check the space, the rights and what is there")
