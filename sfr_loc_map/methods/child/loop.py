"""Gives stereo pairs to one method and measures its calls: `python loop.py ADAPTER.py`, orders on standard input.

The process that asks and the process of the method exchange lines of JSON: a `Setup`, answered by a `Hello`, then an
`Order` for each call, answered by a `Reply`. Images are in a file of `(N, 2, H, W)` bytes. The method gets copies of
the images of its order, which it may keep. `ADAPTER.py` has `open_method(setup)`, which warms the method up and
returns an object with

- `version`: text;
- `prepare(left, right, order)`: returns the call, a function without arguments; images are `(H, W)`, of a set
  `(n, H, W)`;
- `report(answer, order)`: returns the `Answer`; arrays are saved to `order["output"]` with an ending of their own:
  `.cloud.npy`, or `.disparity.npy`.

Time and memory are measured by the process that asks, from the order to the answer with all results written. The
seconds in the reply are those of the call alone by the clock of this process, which the method could change. An error
that the method raises is a reply, too. This file requires Python and numpy alone, because it runs in the interpreter
that has the method.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from typing import Any, TypedDict

import numpy as np

Pose = list[float]  #: A matrix `(4, 4)`, row by row.


class Camera(TypedDict):
    """The rectified stereo camera, with the fields of `StereoRig`: pixels, and metres."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float


class Setup(TypedDict):
    """What an adapter is told at the start."""

    task: str  #: `localisation` or `mapping`.
    target: str  #: What the adapter loads: `package.module:Class`, `FILE.py:Class`, the path of a library.
    config: str  #: Text of the method's configuration.
    images: str  #: File of the images.
    camera: Camera
    T_rb_sb: Pose | None  #: Pose of the stereo rig in RB, None if it is unknown.
    T_rb_left: Pose  #: Pose of the left camera in RB; the identity if it is unknown.
    T_ds_rb: Pose  #: First pose of RB.
    rate_hz: float  #: Rate of the pairs.
    disparities: int  #: Number of disparities that a matcher searches.
    vocabulary: str  #: File of a method that needs one, otherwise empty.


class Hello(TypedDict):
    """Answer to the setup."""

    version: str
    fuses: bool  #: Maps that were made pair by pair are fused by a call of their own.
    maps_sets: bool  #: All pairs of a map are mapped in one call.


class OrderedPair(TypedDict):
    """A stereo pair of an order."""

    stamp_ns: int
    index: int  #: Number of the pair in the map, from 0.
    T_lm_navsb: Pose | None  #: Pose of the mapping cameras; None for a localiser.


class Order(TypedDict):
    """One call."""

    call: str  #: `pair`, `set` (one to three pairs in one call), or `fuse` (the maps of the pairs before).
    pairs: list[OrderedPair]  #: The pairs of the call; of `fuse` the last one before.
    since_start_s: float  #: Time of the pair since the first one.
    output: str  #: Path of the arrays of the answer, before their endings.


class Answer(TypedDict, total=False):
    """What a call gave; what is omitted is not stated by the method."""

    stamp_ns: int  #: Of the last pair of the order.
    T_ds_rb: Pose | None  #: Pose of RB; None if the localiser is lost.
    covariance: list[float] | None  #: Of the pose, `(6, 6)` row by row, in DS.
    step: list[float] | None  #: Uncertainty of the step, 48 numbers.
    state: str  #: State of the localiser.
    reason: str  #: Why it is degraded or lost.
    statistics: dict[str, float]
    fused: bool  #: Whether surfaces that several pairs see are in the cloud once.
    warnings: list[str]


class Reply(TypedDict, total=False):
    """Answer to an order: the result with its time, or a fault with its text."""

    seconds: float
    result: Answer
    fault: str
    text: str


def main() -> None:
    """Answer orders until the input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # some methods print to standard output
    setup = json.loads(sys.stdin.readline())
    folder, name = os.path.split(sys.argv[1])
    sys.path.insert(0, folder)
    method = importlib.import_module(name.removesuffix(".py")).open_method(setup)
    camera = setup["camera"]
    images = np.memmap(setup["images"], np.uint8, "r").reshape(-1, 2, camera["height"], camera["width"])
    able = {name: bool(getattr(method, name, False)) for name in ("fuses", "maps_sets")}
    _answer(answers, {"version": str(method.version), **able})
    for line in sys.stdin:
        order = json.loads(line)
        _answer(answers, _obey(method, np.array(images[: len(order["pairs"])]), order))
    os._exit(0)  # some methods crash in their destructors; all answers have been written


def _obey(method: Any, images: Any, order: Order) -> Reply:  # noqa: ANN401
    call = method.prepare(*(images.swapaxes(0, 1) if order["call"] == "set" else images[0]), order)
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


def _answer(stream: Any, value: Any) -> None:  # noqa: ANN401
    stream.write(json.dumps(value) + "\n")
    stream.flush()


if __name__ == "__main__":
    main()
