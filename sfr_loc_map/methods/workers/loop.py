"""Feeds stereo pairs to one method and measures its calls: `python loop.py ADAPTER.py`, orders on standard input.

The first line is the setup, every further line an order, all JSON; each is answered by one line. The setup names a file
of `(2, H, W)` bytes, where the images of an order lie; the method gets copies, which it may hold. `ADAPTER.py` has
`open_method(setup)`, which warms the method up and returns an object with

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


def main() -> None:
    """Answer orders until the input ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # a method that hangs must not outlive its caller
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # some methods print to standard output
    setup = json.loads(sys.stdin.readline())
    method = _load(sys.argv[1]).open_method(setup)
    images = np.memmap(setup["images"], np.uint8, "r", shape=(2, setup["height"], setup["width"]))
    memory = Memory()
    hello = {"version": str(method.version), "fuses": bool(getattr(method, "fuses", False))}
    _answer(answers, {**hello, "idle_bytes": memory.bytes()[1]})
    for line in sys.stdin:
        _answer(answers, _obey(method, memory, np.array(images), json.loads(line)))
    os._exit(0)  # some methods crash in their destructors; all answers have been written


def _obey(method: Any, memory: Memory, images: Any, order: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401
    call = method.prepare(images[0], images[1], order)
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
