"""Letters of a text by their address, for compiled loops.

A function that takes an array counts references to it, and still does when it is compiled into its caller: two atomic
operations for a letter, which cost more than reading it. An address is a number. Nothing is checked: the caller knows
where the text ends.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic


def _load(builder: Any, arguments: Any, bits: int) -> Any:  # noqa: ANN401 - llvmlite's
    """Return the unsigned number at a base and an offset in bytes."""
    pointer = builder.inttoptr(builder.add(*arguments), ir.IntType(bits).as_pointer())
    return builder.load(pointer, align=1)


def _letter(typing_context: Any, base: Any, offset: Any) -> Any:  # noqa: ANN401 - numba's
    signature = types.uint8(types.intp, types.intp)
    return signature, lambda context, builder, signature, arguments: _load(builder, arguments, 8)


def _eight(typing_context: Any, base: Any, offset: Any) -> Any:  # noqa: ANN401 - numba's
    signature = types.uint64(types.intp, types.intp)
    return signature, lambda context, builder, signature, arguments: _load(builder, arguments, 64)


letter_at = cast(Callable[[int, int], np.uint8], intrinsic(_letter))
"""The letter at a base and an offset in bytes."""
eight_at = cast(Callable[[int, int], np.uint64], intrinsic(_eight))
"""Eight letters from there on as one word, the first in the lowest byte (little-endian machines)."""
