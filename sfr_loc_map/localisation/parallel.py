"""Left and right picture worked on at the same time, each in its own thread; the results do not depend on timing."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

R = TypeVar("R")


@cache
def _second_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="right")


def both(function: Callable[..., R], left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[R, R]:
    """Return the results of a function that lets go of the interpreter's lock, for left and right arguments."""
    future = _second_thread().submit(function, *right)
    result = function(*left)
    return result, future.result()
