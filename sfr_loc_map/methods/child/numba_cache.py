"""Locators with which numba loads this package's compiled kernels in a process that must not write to their cache.

NUMBA_CACHE_LOCATOR_CLASSES lists these classes. Kernels of a method under test are cached in NUMBA_CACHE_DIR.
"""

from __future__ import annotations

import glob
import os
from pathlib import Path
from typing import Any

from numba.core import caching

PACKAGE = str(Path(__file__).parents[2])


class _Kept:
    """Base class that restricts a locator to folders that already have kernels of this package."""

    def ensure_cache_path(self) -> None:
        """Raise OSError if the folder has no kernels of this package for the source file."""
        source: Any = self._py_file  # type: ignore[attr-defined]
        name = os.path.splitext(os.path.basename(source))[0]
        place = self.get_cache_path()  # type: ignore[attr-defined]
        if not source.startswith(PACKAGE) or not glob.glob(f"{glob.escape(place)}/{name}.*nbi"):
            raise OSError("no kernels of this package")


class BesideSources(_Kept, caching.InTreeCacheLocator):
    """Locator of the kernels beside the sources."""


class OfUser(_Kept, caching.UserWideCacheLocator):
    """Locator of the kernels in the user's cache folder.

    SFR_KERNELS names this folder, because the method has another home folder.
    """

    def get_cache_path(self) -> str:
        """Return the folder of the kernels of the source file."""
        name: str = self.get_suitable_cache_subpath(self._py_file)  # type: ignore[no-untyped-call]
        return os.path.join(os.environ["SFR_KERNELS"], name)
