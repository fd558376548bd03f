"""Feeds stereo pairs to one method and measures its calls: `python loop.py METHOD.py`, orders on standard input.

The first line is the setup, every further line an order, all JSON; each is answered by one line. The images of an
order lie in a file of `(2, H, W)` bytes that the setup names. `METHOD.py` has `open_method(setup)`, which warms the
method up and returns an object with

- `version`: text;
- `prepare(left, right, order)`: returns the call, a function without arguments; its own time does not count;
- `report(answer, order)`: returns the call's answer as plain values.

Only the call is timed. Its peak of resident memory is the kernel's high-water mark, reset before each call.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
import time
from typing import Any

import numpy as np


def main() -> None:
    """Answer orders until the input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # some methods print to standard output
    setup = json.loads(sys.stdin.readline())
    method = _load(sys.argv[1]).open_method(setup)
    images = np.memmap(setup["images"], np.uint8, "r", shape=(2, setup["height"], setup["width"]))
    _answer(answers, {"version": method.version, "idle_bytes": _status_bytes("VmRSS:")})
    for line in sys.stdin:
        order = json.loads(line)
        call = method.prepare(np.array(images[0]), np.array(images[1]), order)
        resettable = _reset_peak()
        begin = time.perf_counter()
        answer = call()
        seconds = time.perf_counter() - begin
        peak = _status_bytes("VmHWM:") if resettable else None
        _answer(answers, {"seconds": seconds, "peak_bytes": peak, "result": method.report(answer, order)})
    os._exit(0)  # some methods crash in their destructors; all answers have been written


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


def _reset_peak() -> bool:
    try:
        with open("/proc/self/clear_refs", "wb", buffering=0) as stream:
            stream.write(b"5")
    except OSError:
        return False
    return True


def _status_bytes(key: str) -> int | None:
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as stream:
            return next((int(line.split()[1]) * 1024 for line in stream if line.startswith(key)), None)
    except OSError:
        return None


if __name__ == "__main__":
    main()
