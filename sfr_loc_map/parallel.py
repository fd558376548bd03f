"""Work shared by two threads: the left and right image, the halves of many points, or a call beside other calls.

Results do not depend on timing. The functions release the interpreter lock (`nogil` kernels, OpenCV), so that both
threads run in parallel.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from queue import SimpleQueue
from typing import Any, Generic, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

MIN_POINTS = 64
"""Minimum number of points that are divided between threads. Fewer points take less time than the hand-over of a
call."""
R = TypeVar("R")
Rows = TypeVar("Rows", bound=NDArray[np.float64] | tuple[NDArray[Any], ...])
"""An array with a row for each point, or a `NamedTuple` of such arrays."""
_current_core = getattr(ctypes.CDLL(None), "sched_getcpu", None)  #: Core of the calling thread; None on macOS.


class Pending(Generic[R]):
    """The result of a call that runs in the second thread."""

    def __init__(self, done: SimpleQueue[R | BaseException]) -> None:
        self._done = done

    def result(self) -> R:
        """Wait for the call, and return its result or raise its exception. This method may be called only once."""
        result = self._done.get()
        if isinstance(result, BaseException):
            raise result
        return result


class _Task(NamedTuple):
    """A call for the second thread, and the queue for its result or its exception."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    done: SimpleQueue[Any]


class _SecondThread:
    """A thread that runs in parallel to its caller.

    Handing a call to this thread takes 53 us of CPU time. With a `ThreadPoolExecutor` and its futures it takes 69 us
    (empty calls on a busy host with two cores).
    """

    def __init__(self) -> None:
        self.tasks: SimpleQueue[_Task] = SimpleQueue()
        self._avoided_core: int | None = None
        thread = threading.Thread(target=self._work, name="right", daemon=True)
        thread.start()
        self._number = thread.native_id or 0

    def _work(self) -> None:
        while True:
            task = self.tasks.get()
            try:
                task.done.put(task.function(*task.arguments))
            except BaseException as error:
                task.done.put(error)
            del task  # so that images are freed before the next task

    def keep_off_this_core(self) -> None:
        """Restrict the thread to the other cores whenever the core of the caller has changed.

        The scheduler may place a thread on the core of the thread that wakes it, where it waits for milliseconds. This
        wait is longer than a typical task (measurements/localiser_trials.md, "Beside other methods, and the changes
        that followed").
        """
        core = None if _current_core is None else _current_core()
        if core is None or core == self._avoided_core:
            return
        self._avoided_core = core
        others = os.sched_getaffinity(0) - {core}
        if others:
            with suppress(OSError):  # a container may forbid this call
                os.sched_setaffinity(self._number, others)


_second_thread = cache(_SecondThread)  #: The thread, which is started for its first task.


def beside(function: Callable[..., R], *arguments: Any) -> Pending[R]:  # noqa: ANN401 - of the function
    """Start a call in the second thread. Calls run in the order in which they were started."""
    thread = _second_thread()
    thread.keep_off_this_core()
    done: SimpleQueue[R | BaseException] = SimpleQueue()
    thread.tasks.put(_Task(function, arguments, done))
    return Pending(done)


def both(function: Callable[..., R], left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[R, R]:
    """Return the results of a function for left and right arguments; the right call runs in the second thread."""
    of_right = beside(function, *right)
    of_left = function(*left)
    return of_left, of_right.result()


def in_halves(function: Callable[..., Rows], *points: Any) -> Rows:  # noqa: ANN401 - any arrays
    """Return `function(*points)`, which has a row for each point, from two calls with half of the points each.

    The row of a point must depend only on that point. Points are arrays with a row for each point, or named tuples of
    such arrays.
    """
    count = len(points[0][0]) if isinstance(points[0], tuple) else len(points[0])
    if count < MIN_POINTS:
        return function(*points)
    middle = count // 2
    first = tuple(_rows(array, slice(middle)) for array in points)
    second = tuple(_rows(array, slice(middle, None)) for array in points)
    halves = both(function, first, second)
    if isinstance(halves[0], tuple):
        return type(halves[0])(*map(np.concatenate, zip(*halves, strict=True)))
    return cast(Rows, np.concatenate(halves))


def _rows(array: Any, chosen: slice) -> Any:  # noqa: ANN401 - an array, or a named tuple of arrays
    """Return some rows of an array, or of each array of a named tuple."""
    if isinstance(array, tuple):
        return type(array)(*(part[chosen] for part in array))
    return array[chosen]
