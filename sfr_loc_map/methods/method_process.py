"""The process of a method: images in shared memory, orders and answers as lines of JSON, limits of time and memory."""

from __future__ import annotations

import json
import math
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.child_process import child_environment
from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.score import FindingKind, MethodKind

EXIT_TIMEOUT_S = 10.0
POLL_S = 0.05  #: How often the memory of a process that is at work is looked at.
CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")
SHARED_MEMORY = Path("/dev/shm")
MB = 1_000_000
LEAKS = {10: 100 * MB, 50: 20 * MB}
"""A method leaks that keeps more after each of so many calls, so much in all; a window that fills up does not."""


class MethodFailureError(MethodError):
    """A call of a method gave no valid result: of what kind, and whether its process is gone."""

    def __init__(self, kind: FindingKind, text: str, *, ended: bool = False) -> None:
        super().__init__(text)
        self.kind, self.ended = kind, ended


@dataclass(frozen=True, slots=True, eq=False)
class MethodCall:
    """What one call of a method under test took, stated and did wrong."""

    usage: CallUsage = field(default_factory=lambda: CallUsage(math.nan))  # NaN where it did not return
    finding: str = ""  # what it did wrong, `KIND: text`; empty for nothing
    reason: str = ""  # why its pose is degraded or lost
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None  # of the pose
    step: FloatArray | None = None  # `(27,)` uncertainty of the step


class MethodProcess:
    """A method's process, warmed up and waiting once constructed, of a stated `version`.

    It `maps_sets` of pairs in one call, or `fuses` pairs that it has mapped, or neither.
    The arrays of its results are at `output`, followed by an ending that says what they are.
    """

    def __init__(
        self, method: Method, rig: StereoRig, limits: MethodLimits, T_ds_rb: Transform, setup: Mapping[str, object]
    ) -> None:
        """Start it and wait until it is warmed up; the pose is that at the first pair."""
        self._limits = limits
        shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
        self._folder = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
        self._log, images = self._folder / "log", self._folder / "images"
        self.output = str(self._folder / "result")
        self._images = np.asarray(np.memmap(images, np.uint8, "w+", shape=(MAX_PAIRS, 2, rig.height, rig.width)))
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                method.command,
                env=None if method.kind is MethodKind.PEER else child_environment(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )
        self._rest = b""
        self._kept: list[int] = []  # resident bytes after each of the last calls that each kept more
        T_rb_left = None if rig.T_rb_sb is None else rig.T_rb_left
        transforms = {"start": T_ds_rb, "T_rb_sb": rig.T_rb_sb, "T_rb_left": T_rb_left}
        poses = {name: None if T is None else T.matrix.ravel().tolist() for name, T in transforms.items()}
        about = {"task": method.task.value, "target": method.target, "config": method.config, "images": str(images)}
        camera = {name: getattr(rig, name) for name in CAMERA}
        try:
            hello = self._exchange(camera | poses | about | dict(setup) | dict(method.setup), limits.start_timeout_s)
        except BaseException as error:
            self.close()
            if isinstance(error, MethodFailureError):
                raise MethodError(f"method {method.name} {error}") from error
            raise
        self.version, self.idle_bytes = str(hello["version"]), hello["idle_bytes"]
        self.fuses, self.maps_sets = bool(hello["fuses"]), bool(hello["maps_sets"])

    def call(self, pairs: Sequence[StereoPair], order: Mapping[str, object]) -> tuple[MethodCall, Mapping[str, Any]]:
        """Show it pairs, give an order and return what the call took, and what its adapter reports.

        MethodFailureError says what the method did if there is no result.
        """
        for images, pair in zip(self._images, pairs, strict=False):
            images[0], images[1] = pair.left, pair.right
        about = {"output": self.output, "stamp_ns": pairs[-1].stamp_ns}
        answer = self._exchange(about | dict(order), self._limits.call_timeout_s)
        peak, resident = answer["peak_bytes"], answer["resident_bytes"] or 0
        self._check_limits(resident)
        if "fault" in answer:
            raise MethodFailureError(FindingKind(answer["fault"]), answer["text"])
        above = None if peak is None or self.idle_bytes is None else max(peak - self.idle_bytes, 0)
        result: dict[str, Any] = answer["result"]
        usage = CallUsage(answer["seconds"], peak, above)
        self._kept = [*self._kept, resident] if resident > (self._kept or [resident])[-1] else [resident]
        calls, grown = len(self._kept) - 1, resident - self._kept[0]
        leak = f"{FindingKind.LEAKING}: keeps {grown / max(calls, 1) / MB:.1f} MB more after each of {calls} calls"
        finding = leak if grown > LEAKS.get(calls, math.inf) else ""
        return MethodCall(usage, finding, statistics=result.get("statistics") or {}), result

    def _exchange(self, order: Mapping[str, object], timeout_s: float) -> dict[str, Any]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
        except OSError:
            self._crashed()
        answer: dict[str, Any] = json.loads(self._line(timeout_s))
        return answer

    def _line(self, timeout_s: float) -> bytes:
        assert self._process.stdout is not None
        place, end = self._process.stdout.fileno(), time.monotonic() + timeout_s
        answers = select.poll()
        answers.register(place, select.POLLIN)
        while b"\n" not in self._rest:
            if not answers.poll(1000 * POLL_S):
                with suppress(FileNotFoundError, ProcessLookupError, IndexError):
                    pages = Path(f"/proc/{self._process.pid}/statm").read_text("ascii").split()[1]
                    self._check_limits(int(pages) * os.sysconf("SC_PAGE_SIZE"))
                if time.monotonic() > end:
                    self.close()
                    raise MethodFailureError(FindingKind.HANGING, f"has not answered for {timeout_s:g} s", ended=True)
                continue
            data = os.read(place, 65536)
            if not data:
                self._crashed()
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _check_limits(self, resident: int) -> None:
        limit = self._limits.memory_mb
        if resident > limit * MB:
            self.close()
            text = f"has {resident // MB} MB resident, the limit is {limit} MB"
            raise MethodFailureError(FindingKind.OUT_OF_MEMORY, text, ended=True)

    def _crashed(self) -> None:
        try:
            code = self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            code = 0
        lines = [line.strip() for line in self._log.read_text("utf-8", "replace").splitlines() if line.strip()]
        last = (lines or ["its log is empty"])[-1][:300]
        self.close()
        name = next((item.name for item in signal.Signals if item == -code), f"signal {-code}")
        how = f"with {code}" if code >= 0 else f"by {name}"
        raise MethodFailureError(FindingKind.CRASHED, f"has ended {how}: {last}", ended=True)

    def close(self) -> None:
        """End the process and all that it has started, now."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        shutil.rmtree(self._folder, ignore_errors=True)
