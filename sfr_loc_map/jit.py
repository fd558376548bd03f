"""Compilation policies for numerical kernels, one decorator each. All kernels are cached on disk.

Results must be bit-identical on every run, for every number of threads, and whether a kernel was just compiled or
loaded from the cache. A function that may be inlined is therefore always inlined (`forceinline`). If the compiler could
choose, it would compile a separate copy and an inlined copy of the function in different contexts. Which copy runs
would depend on whether the caller was compiled or loaded.

The policies give the compiler different freedom with floating-point arithmetic:

| decorator | sums | use |
|---|---|---|
| `jit`, `jit_inline` | in the order written | bookkeeping, statistics, simulation |
| `jit_fast`, `jit_fast_inline`, `jit_fast_ir_inline` | in any order, for the vector units | patches, adjustment |
| `jit_rows`, `jit_rows_inline` | a product and a sum may be contracted | loops over image rows |

All policies preserve NaN, which marks missing observations.

Kernels take structs as `NamedTuple`s. Within a `prange` loop, do not write to an array through a field of a struct
(`out.x[i] = ...`), because numba removes such a write as dead code. Bind the field to a name before the loop.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, TypeVar, cast

# Waiting threads sleep instead of spinning. On a machine shared with other programs, a spinning thread may occupy the
# core that the awaited thread needs. OpenMP reads this variable once, when its runtime is loaded at the first parallel
# loop.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from numba import get_num_threads, njit, set_num_threads
from numba.core.caching import FunctionCache
from numba.core.runtime import nrt

F = TypeVar("F", bound=Callable[..., Any])

KERNELS: set[Any] = set()  #: Kernels of all loaded modules.
FAST = {"reassoc", "contract", "nsz", "arcp"}
"""Freedom to sum in any order. The result depends on the machine but not on the run."""


class _KernelCache(FunctionCache):
    """Numba's cache, which loads compiled code without the parts of numba that only its compiler needs.

    Otherwise these parts would be half of the imports of a command: implementations of all functions that a kernel may
    call, and `scipy.linalg` with a second BLAS library, in which numba looks for BLAS. If a kernel is not in the cache,
    the compiler loads these parts.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba has no types
        """Return the kernel for a signature; None if the kernel is not in the cache."""
        _name_runtime()
        with self._guard_against_spurious_io_errors():
            try:
                return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except (ImportError, AttributeError):  # numba unpickles an outdated entry before it checks the entry's age
                self._cache_file.flush()  # type: ignore[no-untyped-call]
                return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba has no types
        """Save a kernel unless the process may not write to the cache, like the process of a method under test."""
        with suppress(PermissionError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def _policy(**options: Any) -> Callable[[F], F]:  # noqa: ANN401 - numba's
    """Return a decorator that compiles with numba options and caches the compiled code.

    No entry point for C is compiled. There is no caller in C, and the entry point of an inlined function would contain
    a further copy of the function.
    """
    options |= {"nogil": True, "no_cfunc_wrapper": True}

    def compiled(function: F) -> F:
        kernel: Any = njit(**options)(function)
        if kernel is not function:  # with NUMBA_DISABLE_JIT, njit returns the function itself
            KERNELS.add(kernel)
            kernel._cache = _KernelCache(function)  # type: ignore[no-untyped-call]
            kernel._compilation_chain_init_hook = _nothing
        return cast(F, kernel)

    return compiled


@cache
def _name_runtime() -> None:
    """Register the functions of numba's runtime with LLVM. Kernels call them to allocate arrays.

    These are the first lines of numba's `rtsys.initialize`. The rest of that function compiles code that only the
    compiler needs, which would take 27 MiB.
    """
    for name, address in nrt._nrt.c_helpers.items():  # type: ignore[attr-defined]
        nrt.ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)  # type: ignore[attr-defined]


def _nothing() -> None:
    """Do nothing, in place of numba's search for extensions in all installed packages before a kernel is loaded."""


_ROWS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
jit = _policy(error_model="numpy")  #: Sums in the order written. Division by zero gives infinity or NaN as in numpy.
jit_inline = _policy(error_model="numpy", forceinline=True)  #: `jit`, inlined so that loops in callers are vectorised.
jit_fast = _policy(fastmath=FAST)  #: Sums in any order.
jit_fast_inline = _policy(fastmath=FAST, forceinline=True)  #: `jit_fast`, inlined into each caller.
jit_fast_ir_inline = _policy(fastmath=FAST, inline="always")
"""`jit_fast`, copied into each caller before types are inferred.

The result is bit-identical to that of a single function with the same code. The parts of a `jit_fast` kernel use this
policy, so that splitting the kernel changes no figure. It also suits functions that take many array layouts.
"""
jit_rows = _policy(**_ROWS, parallel=True)
"""Loops over rows (`prange`) run on all threads. Each row is written by a single thread."""
jit_rows_inline = _policy(**_ROWS, forceinline=True)  #: Functions that the loops of `jit_rows` kernels call.


@jit_rows_inline
def interleaved_row(k: int, rows: int) -> int:
    """Return the row of iteration k of a loop over rows: first the even rows in order, then the odd rows.

    The first thread processes the first half of the iterations. If the work is concentrated in a part of the image, for
    example beside holes, each of two threads then has half of the work.
    """
    return 2 * k if 2 * k < rows else 2 * k - rows + 1 - rows % 2


@contextmanager
def on_one_thread(small: bool) -> Iterator[None]:
    """Run loops over rows on one thread if the data are small, because waking another thread takes 0.1 ms."""
    threads = get_num_threads()
    set_num_threads(1 if small else threads)
    try:
        yield
    finally:
        set_num_threads(threads)
