"""How loops over pictures are compiled.

Every pass writes each element once and keeps sums per row, added in order, so that results are the same to the bit on
every run and for every number of threads. The only arithmetic freedom given to the compiler is to contract a product
and a sum: tests for NaN stay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

C = TypeVar("C", bound=Callable[..., Any])


def by_rows(function: C) -> C:
    """Compile a function whose rows (`prange`) run on all threads."""
    compiled = njit(cache=True, parallel=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(C, compiled)


def inlined(function: C) -> C:
    """Compile a function that others of the same module call within their loops."""
    return cast(C, njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function))
