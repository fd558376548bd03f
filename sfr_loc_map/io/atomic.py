"""Outputs that are either whole or not there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sfr_loc_map.errors import OutputError


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
        OutputError: If the folder of `path` is missing or not writable, `path` is a folder that is not empty, or the
            file system refuses.
    """
    path = Path(path)
    _check_free(path)
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        yield scratch / path.name
        os.replace(scratch / path.name, path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def check_output(path: Path) -> None:
    """Check that an output can be written, before the work for it is done.

    Raises:
        OutputError: As `atomic_path`.
    """
    path = Path(path)
    _check_free(path)
    try:
        tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".part", dir=path.parent).cleanup()
    except OSError as error:
        raise _cannot_write(path, error) from error


def _check_free(path: Path) -> None:
    if not path.name:
        raise OutputError(f"'{path}' cannot be an output: give a path that ends in a name")
    if not path.parent.is_dir():
        raise OutputError(f"cannot write '{path}': there is no folder '{path.parent}'; make it first")
    if path.is_dir() and any(path.iterdir()):
        raise OutputError(
            f"cannot write '{path}': a folder that is not empty is there; remove it or choose another name"
        )


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"cannot write '{path}': {reason}; check the space, the rights and what is there")
