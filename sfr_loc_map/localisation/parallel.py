"""Work shared by two threads: left and right image, or two halves of many points. Results do not depend on timing."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from queue import SimpleQueue
from typing import Any, TypeVar, cast

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

FEWEST = 64  #: Points from which on a second thread is worth its start.
_core = getattr(ctypes.CDLL(None), "sched_getcpu", None)
R = TypeVar("R")
Rows = TypeVar("Rows", bound=FloatArray | tuple[FloatArray, ...])
"""An array with a row for each point, or a `NamedTuple` of such arrays."""
BACKGROUND = ThreadPoolExecutor(max_workers=1, thread_name_prefix="keyframe")
"""Does keyframe work, which may itself share its parts between threads; the thread starts with the first work."""
_Task = tuple[Callable[..., Any], tuple[Any, ...], SimpleQueue[Any]]


@cache
def _second_thread() -> tuple[SimpleQueue[_Task], int]:
    """Return the tasks of a thread that works beside its caller, and its number.

    A pool with its futures takes five times as long to hand work over and back.
    """
    tasks: SimpleQueue[_Task] = SimpleQueue()

    def work() -> None:
        while True:
            function, arguments, done = tasks.get()
            try:
                done.put(function(*arguments))
            except BaseException as error:
                done.put(error)
            del function, arguments, done  # images are not kept until the next task

    thread = threading.Thread(target=work, name="right", daemon=True)
    thread.start()
    return tasks, thread.native_id or 0


def both(function: Callable[..., R], left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[R, R]:
    """Return the results of a function that lets go of the interpreter's lock, for left and right arguments.

    A scheduler may leave a thread that it wakes on the core of the one that woke it, and behind it, for milliseconds:
    longer than the work takes. So the second thread is kept off this one's core.
    """
    tasks, thread = _second_thread()
    others = os.sched_getaffinity(0) - {_core()} if _core else set()
    if others and os.sched_getaffinity(thread) != others:
        with suppress(OSError):  # a container may forbid it
            os.sched_setaffinity(thread, others)
    done: SimpleQueue[R | BaseException] = SimpleQueue()
    tasks.put((function, right, done))
    result, other = function(*left), done.get()
    if isinstance(other, BaseException):
        raise other
    return result, other


def in_halves(function: Callable[..., Rows], *points: Any) -> Rows:  # noqa: ANN401 - any arrays
    """Return `function(*points)`, rows for each point, from two calls with half of the points each.

    The function lets go of the interpreter's lock, and a point's row depends on that point alone; points are arrays
    with a row for each, or named tuples of such arrays.
    """
    count = len(points[0][0]) if isinstance(points[0], tuple) else len(points[0])
    if count < FEWEST:
        return function(*points)
    first, second = (
        tuple(type(a)(*(x[half] for x in a)) if isinstance(a, tuple) else a[half] for a in points)
        for half in (slice(count // 2), slice(count // 2, None))
    )
    halves = both(function, first, second)
    if isinstance(halves[0], tuple):
        return type(halves[0])(*map(np.concatenate, zip(*halves, strict=True)))
    return cast(Rows, np.concatenate(halves))
