"""The policies by which numerical kernels are compiled, one decorator each; all are cached on disk.

Results must be bit-identical on every run, for every number of threads, and whether a kernel was just compiled or
loaded from the cache. What may be inlined therefore always is (`forceinline`): if it were left to the compiler, two
copies of a function would exist, its own and the one in its caller, compiled in different surroundings, and which of
them runs would depend on whether the caller was compiled or loaded.

Which freedom the compiler has with floating-point arithmetic:

| decorator | sums | use |
|---|---|---|
| `jit`, `jit_inline` | in the order written | bookkeeping, statistics, simulation |
| `jit_fast`, `jit_fast_inline`, `jit_fast_ir_inline` | in any order, for the vector units | patches, adjustment |
| `jit_rows`, `jit_rows_inline` | a product and a sum may be contracted | loops over image rows |

NaN keeps its meaning under all of them: it marks what was not observed.

Kernels take structs as `NamedTuple`s. Within a `prange` loop write to arrays only, never to a field of a struct
(`out.x[i] = ...`): numba takes such a write for dead code and drops it. Bind the field to a name before the loop.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, TypeVar, cast

# Threads sleep, not spin, while they wait for each other: on a machine shared with other programs spinning takes the
# very core that the awaited thread needs. Read once, when the OpenMP runtime is loaded at the first parallel loop.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from numba import get_num_threads, njit, set_num_threads
from numba.core.caching import FunctionCache
from numba.core.runtime import nrt

F = TypeVar("F", bound=Callable[..., Any])

KERNELS: set[Any] = set()  #: Those of the modules that are loaded.
FAST = {"reassoc", "contract", "nsz", "arcp"}
"""Sums in any order; the result depends on the machine, not on the run."""


class _KernelCache(FunctionCache):
    """Numba's cache, which loads compiled code without the parts of numba that only its compiler needs.

    Those are half of what a start of ours would import: implementations of all that a kernel may call, and
    `scipy.linalg`, with a second BLAS library, where numba looks for BLAS. Where a kernel is not in the cache, the
    compiler loads them.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba has no types
        """Return the kernel for a signature, None where it is not in the cache."""
        _name_runtime()
        with self._guard_against_spurious_io_errors():
            try:
                return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except (ImportError, AttributeError):  # written before a struct moved: numba reads all, then looks how old
                self._cache_file.flush()  # type: ignore[no-untyped-call]
                return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba has no types
        """Keep a kernel, where it may be written: the process of a method under test may not."""
        with suppress(PermissionError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def _policy(**options: Any) -> Callable[[F], F]:  # noqa: ANN401 - numba's
    """Return a decorator that compiles with options of numba, and keeps the compiled code.

    No entry is made for callers in C: there are none, and that of what is inlined is compiled with a copy of it.
    """
    options |= {"nogil": True, "no_cfunc_wrapper": True}

    def compiled(function: F) -> F:
        kernel: Any = njit(**options)(function)
        if kernel is not function:  # NUMBA_DISABLE_JIT leaves the function
            KERNELS.add(kernel)
            kernel._cache = _KernelCache(function)  # type: ignore[no-untyped-call]
            kernel._compilation_chain_init_hook = _nothing
        return cast(F, kernel)

    return compiled


@cache
def _name_runtime() -> None:
    """Tell LLVM where the functions of numba's runtime are, which kernels call to allocate arrays.

    The first lines of numba's `rtsys.initialize`. What it compiles then is for the compiler, which copies it into each
    kernel; the compiler takes 27 MiB to do so.
    """
    for name, address in nrt._nrt.c_helpers.items():  # type: ignore[attr-defined]
        nrt.ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)  # type: ignore[attr-defined]


def _nothing() -> None:
    """Look for no extensions of numba before a kernel is loaded: a search through all that is installed."""


_ROWS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
jit = _policy(error_model="numpy")  #: Arithmetic in the order written; division by zero is infinity or NaN as in numpy.
jit_inline = _policy(error_model="numpy", forceinline=True)  #: Into each caller: a loop around becomes vector code.
jit_fast = _policy(fastmath=FAST)  #: Sums in any order.
jit_fast_inline = _policy(fastmath=FAST, forceinline=True)  #: Sums in any order, into each caller.
jit_fast_ir_inline = _policy(fastmath=FAST, inline="always")
"""Sums in any order, copied into each caller before types are known.

The result is that of one function with all the text, to the last digit: the parts of a kernel that sums in any order
take it, so that a division into parts changes no figure. It also serves functions of many array layouts.
"""
jit_rows = _policy(**_ROWS, parallel=True)
"""Rows (`prange`) run on all threads; each row is written by one of them."""
jit_rows_inline = _policy(**_ROWS, forceinline=True)  #: What those of `jit_rows` call within their loops.


@contextmanager
def on_one_thread(small: bool) -> Iterator[None]:
    """Run loops over rows without other threads if the data are small: to wake one and wait for it takes 0.1 ms."""
    threads = get_num_threads()
    set_num_threads(1 if small else threads)
    try:
        yield
    finally:
        set_num_threads(threads)
