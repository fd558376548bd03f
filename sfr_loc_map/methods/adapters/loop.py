"""Feeds stereo pairs to one method and measures its calls: `python loop.py ADAPTER.py`, orders on standard input.

The first line is the setup, every further line an order, all JSON; each is answered by one line. The setup names a file
of `(N, 2, H, W)` bytes, where the images of an order lie, of one pair or of a `set`; the method gets copies, which it
may hold. `ADAPTER.py` has `open_method(setup)`, which warms the method up and returns an object with

- `version`: text;
- `prepare(left, right, order)`: returns the call, a function without arguments; images
  are `(H, W)`, of a set `(n, H, W)`;
- `report(answer, order)`: returns the call's answer as plain values; arrays are saved to `order["output"]`.

Time and memory are measured by the process that gives the orders, from the order to the answer with all results
written. The seconds in the answer are those of the call alone by the clock of this process, which the method could
change. An error that the method raises is an answer too; whatever ends the process is seen by who gave the order.
"""

from __future__ import annotations

import ctypes
import importlib
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
    folder, name = os.path.split(sys.argv[1])
    sys.path.insert(0, folder)
    method = importlib.import_module(name.removesuffix(".py")).open_method(setup)
    images = np.memmap(setup["images"], np.uint8, "r").reshape(-1, 2, setup["height"], setup["width"])
    able = {name: bool(getattr(method, name, False)) for name in ("fuses", "maps_sets")}
    _answer(answers, {"version": str(method.version), **able})
    for line in sys.stdin:
        order = json.loads(line)
        _answer(answers, _obey(method, np.array(images[: len(order.get("set", [order]))]), order))
    os._exit(0)  # some methods crash in their destructors; all answers have been written


def _obey(method: Any, images: Any, order: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401
    call = method.prepare(*(images.swapaxes(0, 1) if "set" in order else images[0]), order)
    begin = time.perf_counter()
    try:
        answer, raised = call(), None
    except Exception as error:
        answer, raised = None, f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    if raised is not None:
        return {"fault": "raised", "text": raised}
    try:
        return {"seconds": seconds, "result": method.report(answer, order)}
    except Exception as error:
        return {"fault": "invalid result", "text": str(error) or type(error).__name__}


def _answer(stream: Any, value: dict[str, Any]) -> None:  # noqa: ANN401
    stream.write(json.dumps(value) + "\n")
    stream.flush()


if __name__ == "__main__":
    main()
