"""Feeds stereo pairs to one method and measures its calls: `python loop.py ADAPTER.py`, orders on standard input.

The first line is the setup, every further line an order, all JSON; each is answered by one line. The setup names a file
of `(N, 2, H, W)` bytes; the images of an order lie in one of these N places, that which the last answer named as
`place`, 0 at first. `ADAPTER.py` has `open_method(setup)`, which warms the
method up and returns an object with

- `version`: text;
- `prepare(left, right, order)`: returns the call, a function without arguments; its own time does not count;
- `report(answer, order)`: returns the call's answer as plain values; arrays are saved to `order["output"]`.

Only the call is timed. Its peak of resident memory is the kernel's high-water mark, reset before each call. An error
that the method raises is an answer too; whatever ends the process is seen by who gave the order.
"""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import signal
import sys
import time
from typing import Any

import numpy as np

PR_SET_PDEATHSIG = 1
PAGE_BYTES = 4096


def main() -> None:
    """Answer orders until the input ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # a method that hangs must not outlive its caller
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # some methods print to standard output
    setup = json.loads(sys.stdin.readline())
    method = _load(sys.argv[1]).open_method(setup)
    images, memory = SharedImages(setup), Memory()
    hello = {"version": str(method.version), "fuses": bool(getattr(method, "fuses", False))}
    _answer(answers, {**hello, "idle_bytes": memory.bytes()[1]})
    for line in sys.stdin:
        order = json.loads(line)
        answer = _obey(method, memory, (*images.shown(order["place"]), order))
        _answer(answers, {**answer, "place": images.free_place()})
    os._exit(0)  # some methods crash in their destructors; all answers have been written


class SharedImages:
    """Pairs of images where the caller has written them: a method may hold them, the next pair takes a free place."""

    def __init__(self, setup: dict[str, Any]) -> None:
        """Map the file, and count the references to an image that nobody else holds."""
        self._shape = (setup["height"], setup["width"])
        self._map = np.memmap(setup["images"], np.uint8, "r+")
        self._last = self._map.size // (2 * setup["height"] * setup["width"]) - 1
        self._pairs: list[list[Any]] = [self._mapped(0)]
        self._unused = self._references(0)

    def _mapped(self, place: int) -> list[Any]:
        """Return the images of a place; each is an array of its own, which all views of it refer to."""
        height, width = self._shape
        begins = [(2 * place + side) * height * width for side in (0, 1)]
        images = [np.ndarray(self._shape, np.uint8, self._map, begin) for begin in begins]
        for image in images:
            image.ravel()[::PAGE_BYTES].max()  # the first look at a page costs, and is not the method's
        return images

    def _references(self, place: int) -> list[int]:
        return [sys.getrefcount(image) for image in self._pairs[place]]

    def shown(self, place: int) -> list[Any]:
        """Return the images of a place; copies of those of the last place, which so stays free."""
        if place == len(self._pairs):
            self._pairs.append(self._mapped(place))
        pair = self._pairs[place]
        return [image.copy() for image in pair] if place == self._last else pair

    def free_place(self) -> int:
        """Return the first place that nobody holds an image of."""
        known = range(len(self._pairs))
        return next((place for place in known if self._references(place) == self._unused), len(known))


def _obey(method: Any, memory: Memory, given: tuple[Any, Any, dict[str, Any]]) -> dict[str, Any]:  # noqa: ANN401
    order = given[2]
    call = method.prepare(*given)
    memory.reset_peak()
    begin = time.perf_counter()
    try:
        answer, raised = call(), None
    except Exception as error:
        answer, raised = None, f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    peak, resident = memory.bytes()
    costs = {"seconds": seconds, "peak_bytes": peak, "resident_bytes": resident}
    if raised is not None:
        return {**costs, "fault": "raised", "text": raised}
    try:
        return {**costs, "result": method.report(answer, order)}
    except Exception as error:
        return {**costs, "fault": "invalid result", "text": str(error) or type(error).__name__}


def _load(path: str) -> Any:  # noqa: ANN401 - a module
    spec = importlib.util.spec_from_file_location("method", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _answer(stream: Any, value: dict[str, Any]) -> None:  # noqa: ANN401
    stream.write(json.dumps(value) + "\n")
    stream.flush()


class Memory:
    """Resident memory of this process; its files are opened once."""

    def __init__(self) -> None:
        """Open them; a system without them measures nothing."""
        self._status = _opened("/proc/self/status", os.O_RDONLY)
        self._clear = _opened("/proc/self/clear_refs", os.O_WRONLY)

    def reset_peak(self) -> None:
        """Set the high-water mark back to what is resident now."""
        if self._clear is not None:
            os.write(self._clear, b"5")

    def bytes(self) -> tuple[int | None, int | None]:
        """Return the high-water mark and what is resident now, None where not known."""
        if self._status is None or self._clear is None:
            return None, None
        text = os.pread(self._status, 8192, 0)
        peak, resident = (int(text[text.index(key) :].split(None, 2)[1]) * 1024 for key in (b"VmHWM:", b"VmRSS:"))
        return peak, resident


def _opened(path: str, mode: int) -> int | None:
    try:
        return os.open(path, mode)
    except OSError:
        return None


if __name__ == "__main__":
    main()
