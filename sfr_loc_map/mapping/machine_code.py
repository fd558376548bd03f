"""How loops over pictures are compiled.

Every pass writes each element once and keeps sums per row, added in order, so that results are the same to the bit on
every run and for every number of threads. The only arithmetic freedom given to the compiler is to contract a product
and a sum: tests for NaN stay.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

# Threads sleep, not spin, while they wait for each other: on a machine shared with other programs spinning takes the
# very core that the awaited thread needs. Read once, when the OpenMP runtime is loaded at the first parallel loop.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from numba import njit

C = TypeVar("C", bound=Callable[..., Any])


def by_rows(function: C) -> C:
    """Compile a function whose rows (`prange`) run on all threads."""
    compiled = njit(cache=True, parallel=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(C, compiled)


def inlined(function: C) -> C:
    """Compile a function that others of the same module call within their loops."""
    # not left to the compiler: which of two copies of a called function runs depends on whether the caller was compiled
    # or loaded, and copies compiled in different surroundings may round differently
    compiled = njit(cache=True, nogil=True, forceinline=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(C, compiled)
