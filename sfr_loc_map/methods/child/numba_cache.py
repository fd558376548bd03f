"""Where numba finds compiled kernels in a process that may not write beside the sources: of this package there.

Named in NUMBA_CACHE_LOCATOR_CLASSES; kernels of a method under test are kept in NUMBA_CACHE_DIR.
"""

from __future__ import annotations

import glob
import os
from pathlib import Path
from typing import Any

from numba.core import caching

PACKAGE = str(Path(__file__).parents[2])


class _Kept:
    """What makes a locator take kernels that are there already."""

    def ensure_cache_path(self) -> None:
        """Raise OSError where there are none of this package's for a source."""
        source: Any = self._py_file  # type: ignore[attr-defined]
        name = os.path.splitext(os.path.basename(source))[0]
        place = self.get_cache_path()  # type: ignore[attr-defined]
        if not source.startswith(PACKAGE) or not glob.glob(f"{glob.escape(place)}/{name}.*nbi"):
            raise OSError("no kernels of this package")


class BesideSources(_Kept, caching.InTreeCacheLocator):
    """Beside the sources."""


class OfUser(_Kept, caching.UserWideCacheLocator):
    """In the user's own folder."""
