"""Passes stereo pairs to a method and measures its calls: `python loop.py ADAPTER.py`, orders on standard input.

The client and this process exchange lines of JSON. This process sends a `Ready` before any code of the method is
loaded, so that the client can measure the memory without the method. The client then sends a `Setup`, answered by a
`Hello`, and an `Order` for each call, answered by a `Reply`. Images are in a file of `(N, 2, H, W)` bytes. The method
receives copies of the images, which the method may keep. `ADAPTER.py` must not load code of the method when it is
imported. The adapter defines `open_method(setup)`, which loads the method, warms the method up and returns an object
with

- `version`: text;
- `prepare(left, right, order)`: returns the call, a function without arguments; images are `(H, W)`, or `(n, H, W)` for
  a set;
- `report(answer, order)`: returns the `Answer`; arrays are saved to `order["output"]` plus `.cloud.npy` or
  `.disparity.npy`.

The client measures the time and memory of a call from the sending of the order until it has the answer and all results
are written. The seconds in the reply cover only the call, by a clock that the method could manipulate. An exception of
the method is returned as a reply. This file requires only Python and numpy, because it runs in the interpreter of the
method.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from typing import Any, Literal, TypedDict

import numpy as np

Pose = list[float]  #: A matrix `(4, 4)`, row by row.
CallKind = Literal["pair", "set", "fuse"]
"""One pair, one to three pairs of a map in one call, or the fusion of the maps of the previous pairs."""


class Ready(TypedDict):
    """First line: the interpreter and the adapter are loaded, but no code of the method."""

    adapter: str  #: Name of the adapter.


class Camera(TypedDict):
    """The rectified stereo camera, with the fields of `StereoRig`, in pixels and metres."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float


class Setup(TypedDict):
    """Parameters that an adapter receives when it starts."""

    task: str  #: `localisation` or `mapping`.
    target: str  #: Loaded by the adapter: `package.module:Class`, `FILE.py:Class` or the path of a library.
    search_path: list[str]  #: Folders that are searched before all others for modules of the method.
    config: str  #: Text of the method's configuration.
    images: str  #: File of the images.
    camera: Camera
    T_rb_sb: Pose | None  #: Pose of the stereo rig in RB; None if unknown.
    T_rb_left: Pose  #: Pose of the left camera in RB; the identity for mappers.
    T_ds_rb: Pose  #: Initial pose of RB.
    rate_hz: float  #: Rate of the pairs.
    disparities: int  #: Number of disparities that a matcher searches.
    vocabulary: str  #: Path of a vocabulary file; empty if not required.


class Hello(TypedDict):
    """Answer to the setup."""

    version: str
    fuses: bool  #: Whether a separate call fuses the maps of single pairs.
    maps_sets: bool  #: Whether one call maps all pairs of a map.


class OrderedPair(TypedDict):
    """A stereo pair of an order."""

    stamp_ns: int
    index: int  #: Index of the pair in the map, from 0.
    T_lm_navsb: Pose | None  #: Pose of the mapping cameras; None for a localiser and for `fuse`.


class Order(TypedDict):
    """One call."""

    number: int  #: Number of the order, from 1.
    call: CallKind
    pairs: list[OrderedPair]  #: The pairs of the call; for `fuse`, the last mapped pair.
    begins_map: bool  #: Whether the pair is the first of a map; the results of the previous map are not used again.
    since_start_s: float  #: Time of the pair since the first pair, for a localiser.
    output: str  #: Path of the arrays of the answer, without the suffixes.


class Answer(TypedDict, total=False):
    """Result of a call; the method may omit any field."""

    stamp_ns: int  #: Stamp of the last pair of the order.
    T_ds_rb: Pose | None  #: Pose of RB; None if the localiser is lost.
    covariance: list[float] | None  #: Covariance of the pose, `(6, 6)` row by row, in DS.
    step: list[float] | None  #: Uncertainty of the step, 48 numbers.
    state: str  #: State of the localiser.
    reason: str  #: Why the pose is degraded or lost.
    statistics: dict[str, float]
    fused: bool  #: Whether the pairs were fused into one surface.
    warnings: list[str]


class Reply(TypedDict, total=False):
    """Answer to an order: the result and the time of the call, or a fault and its text."""

    number: int  #: Number of the order.
    seconds: float
    result: Answer
    fault: Literal["raised", "invalid result"]
    text: str


def main() -> None:
    """Answer orders until the input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # some methods print to standard output
    folder, name = os.path.split(sys.argv[1])
    sys.path.insert(0, folder)
    adapter = importlib.import_module(name.removesuffix(".py"))
    ready: Ready = {"adapter": name}
    _send(answers, json.dumps(ready))
    setup = json.loads(sys.stdin.readline())
    _search_first(setup["search_path"])
    method = adapter.open_method(setup)
    camera = setup["camera"]
    images = np.memmap(setup["images"], np.uint8, "r").reshape(-1, 2, camera["height"], camera["width"])
    hello: Hello = {
        "version": str(method.version),
        "fuses": bool(getattr(method, "fuses", False)),
        "maps_sets": bool(getattr(method, "maps_sets", False)),
    }
    _send(answers, json.dumps(hello))
    for line in sys.stdin:
        order = json.loads(line)
        _send(answers, _reply(method, np.array(images[: len(order["pairs"])]), order))
    os._exit(0)  # some methods crash in their destructors; all answers are already written


def _search_first(folders: list[str]) -> None:
    """Let this interpreter and those that the method starts search folders for modules, before all others.

    The interpreter does not receive these folders at its start, because it would run a `sitecustomize.py` in them.
    """
    sys.path[:0] = folders
    inherited = filter(None, [os.environ.get("PYTHONPATH")])
    os.environ["PYTHONPATH"] = os.pathsep.join([*folders, *inherited])


def _reply(method: Any, images: Any, order: Order) -> str:  # noqa: ANN401
    """Return the reply to an order as JSON."""
    number = order["number"]
    call = method.prepare(*(images.swapaxes(0, 1) if order["call"] == "set" else images[0]), order)
    begin = time.perf_counter()
    try:
        answer, raised = call(), None
    except Exception as error:
        answer, raised = None, f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    reply: Reply
    if raised is not None:
        reply = {"number": number, "fault": "raised", "text": raised}
        return json.dumps(reply)
    try:
        reply = {"number": number, "seconds": seconds, "result": method.report(answer, order)}
        return json.dumps(reply, default=_without_numpy)
    except Exception as error:
        reply = {"number": number, "fault": "invalid result", "text": str(error) or type(error).__name__}
        return json.dumps(reply)


def _without_numpy(value: object) -> object:
    """Return a NumPy scalar or array as Python numbers; TypeError for any other value."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"the result has a value of the type {type(value).__name__}: numbers and texts are required")


def _send(stream: Any, line: str) -> None:  # noqa: ANN401
    stream.write(line + "\n")
    stream.flush()


if __name__ == "__main__":
    main()
