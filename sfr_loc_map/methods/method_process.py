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
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import CAMERA, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.methods.isolation import ProcessTree, TreeUsage, environment_of, rules_of
from sfr_loc_map.methods.registry import WORKERS, Method, MethodLimits
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.score import FindingKind

EXIT_TIMEOUT_S = 10.0
POLL_S = 0.05  #: How often the memory of a process that is at work is looked at.
SHARED_MEMORY = Path("/dev/shm")
MB = 1_000_000
LEAKS = {10: 80 * MB, 50: 40 * MB}
"""A method leaks whose memory grows so much over so many calls: the least of each fifth of them is more than that of
the fifth before, so that a saw-tooth does not hide it; a window that fills up (24 MB in ours) is none."""
MARK_TOLERANCE = 2 * MB  #: Decrease of a high-water mark that its counters on several cores cause by themselves, bytes.
MISSTATED_RATIO = 0.5
"""Fraction of the time from outside by which the time that a method's process states may differ from it. Between the
two are copies of the images, the reading of the result and its transfer."""
MISSTATED_S, MISSTATED_CALLS = 0.25, 3
"""A larger difference, s, in so many calls in a row is a misstatement: a busy host delays single calls alone."""
MISSTATED_AT_ONCE_S = 1.0  #: A larger difference, s, is a misstatement in one call.
LOG_BYTES, LOG_KEPT = 4_000_000, 100_000  #: Size at which its log is cut, and what of it is kept.
LONGEST_ANSWER = 16_000_000


def leak_in(resident: Sequence[int]) -> str:
    """Return the finding of a leak in the memory after each of the last calls, empty where there is none."""
    for calls, most in LEAKS.items():
        if len(resident) >= calls:
            least = np.array(resident)[-calls:].reshape(5, -1).min(axis=1)
            grown = int(least[-1] - least[0])
            if grown > most and (np.diff(least) > 0).all():
                text = f"keeps {grown / (0.8 * calls) / MB:.1f} MB more after each of {calls} calls"
                return f"{FindingKind.LEAKING}: {text}"
    return ""


def exceeds(measured_s: float, stated_s: float, least_s: float) -> bool:
    """Return whether a stated time differs from the measured one by more than the bound, at least `least_s`."""
    return abs(measured_s - stated_s) > max(least_s, MISSTATED_RATIO * measured_s)


def cut_log(log: Path) -> None:
    """Keep the end of a log that has grown long."""
    with suppress(OSError):
        if log.stat().st_size > LOG_BYTES:
            with log.open("r+b") as stream:
                stream.seek(-LOG_KEPT, os.SEEK_END)
                end = stream.read(LOG_KEPT)
                stream.seek(0)
                stream.write(end)
                stream.truncate()


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
    step: FloatArray | None = None  # `(48,)` uncertainty of the step


class MethodProcess:
    """A method's process, warmed up and waiting once constructed, of a stated `version`.

    It `maps_sets` of pairs in one call, or `fuses` pairs that it has mapped, or neither.
    The arrays of its results are at `output`, followed by an ending that says what they are.
    """

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits,
        T_ds_rb: Transform,
        setup: Mapping[str, object],
        hidden: Sequence[Path] = (),
    ) -> None:
        """Start it, shut in, and wait until it is warmed up; the pose is that at the first pair."""
        self._limits = limits
        shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
        self._folder = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
        self._log, images = self._folder / "log", self._folder / "images"
        self.output = str(self._folder / "result")
        self._images = np.asarray(np.memmap(images, np.uint8, "w+", shape=(MAX_PAIRS, 2, rig.height, rig.width)))
        work = self._folder / "work"
        work.mkdir()
        rules = json.dumps(rules_of(method, self._folder, limits.memory_mb * MB, hidden))
        python = str(method.python)
        with self._log.open("ab") as log:  # appended to: it may be cut meanwhile
            self._process = subprocess.Popen(
                [python, "-ES", str(WORKERS / "shut_in.py"), rules, python]
                + [str(WORKERS / name) for name in ("loop.py", method.worker)],
                env=environment_of(method, work),
                cwd=work,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )
        self._rest, self._tree, self._peak_bytes = b"", None, 0
        self._mark_bytes: int | None = None  # last high-water mark of the present call
        self._is_mark_set_back = False
        self._misstated = 0  # calls in a row whose stated time differs from the measured one
        self._resident: deque[int] = deque(maxlen=max(LEAKS))
        self._ended = TreeUsage()  # when the last call ended
        T_rb_left = None if rig.T_rb_sb is None else rig.T_rb_left
        transforms = {"start": T_ds_rb, "T_rb_sb": rig.T_rb_sb, "T_rb_left": T_rb_left}
        poses = {name: None if T is None else T.matrix.ravel().tolist() for name, T in transforms.items()}
        about = {"task": method.task.value, "target": method.target, "config": method.config, "images": str(images)}
        camera = {name: getattr(rig, name) for name in CAMERA}
        try:
            shut_in = json.loads(self._line(limits.start_timeout_s))
            self._tree = ProcessTree(self._process.pid, shut_in["levels"])
            hello = self._exchange(camera | poses | about | dict(setup) | dict(method.setup), limits.start_timeout_s)
        except BaseException as error:
            self.close()
            if isinstance(error, MethodFailureError):
                raise MethodFailureError(FindingKind.CRASHED, f"method {method.name} {error}", ended=True) from error
            raise
        self.version, self.idle_bytes = str(hello["version"]), self._tree.set_back_peak()
        self.fuses, self.maps_sets = bool(hello["fuses"]), bool(hello["maps_sets"])
        self.isolation = ", ".join(shut_in["isolated"] + [f"not {reason}" for reason in shut_in["missing"]])
        self._ended = self._tree.usage()

    def call(self, pairs: Sequence[StereoPair], order: Mapping[str, object]) -> tuple[MethodCall, Mapping[str, Any]]:
        """Show it pairs, give an order and return what the call took, and what its adapter reports.

        MethodFailureError says what the method did if there is no result.
        """
        for images, pair in zip(self._images, pairs, strict=False):
            images[0], images[1] = pair.left, pair.right
        assert self._tree is not None
        about = {"output": self.output, "stamp_ns": pairs[-1].stamp_ns}
        begun, self._peak_bytes = self._tree.usage(), 0
        self._mark_bytes, self._is_mark_set_back = self._tree.set_back_peak(), False
        begin_s = time.monotonic()
        answer = self._exchange(about | dict(order), self._limits.call_timeout_s)
        seconds = time.monotonic() - begin_s
        now, last, self._ended = self._look(), self._ended, self._tree.usage()
        cut_log(self._log)
        try:
            if "fault" in answer:
                raise MethodFailureError(FindingKind(answer["fault"]), answer["text"])
            result, stated_s = dict(answer["result"]), float(answer["seconds"])
        except (KeyError, TypeError, ValueError) as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, f"no answer of its adapter: {error!r}") from error
        peak = self._mark_bytes
        if peak is not None and (now.processes > 1 or self._is_mark_set_back):
            peak = max(peak, self._peak_bytes)
        above = None if peak is None or self.idle_bytes is None else max(peak - self.idle_bytes, 0)
        taken = {
            "stated_s": stated_s,
            "cpu_s": round(self._ended.cpu_s - begun.cpu_s, 2),
            "cpu_between_s": round(max(begun.cpu_s - last.cpu_s, 0.0), 2),
            "threads": now.threads,
            "processes": now.processes,
        }
        statistics = {**(result.get("statistics") or {}), **taken}
        self._resident.append(now.rss_bytes)
        finding = leak_in(self._resident)
        if finding:
            self._resident.clear()
        elif self._is_mark_set_back:
            finding = f"{FindingKind.MISSTATED}: the high-water mark of its memory was set back within the call"
        elif self._misstates(seconds, stated_s):
            text = f"states {stated_s:.3f} s for a call that took {seconds:.3f} s from the request to the answer"
            finding = f"{FindingKind.MISSTATED}: {text}"
        elif strays := self._tree.new_strays():
            finding = f"{FindingKind.STRAY}: {', '.join(strays)}: ended with the method"
        return MethodCall(CallUsage(seconds, peak, above), finding, statistics=statistics), result

    def _misstates(self, measured_s: float, stated_s: float) -> bool:
        """Return whether the process states another time than was measured: at once much, or in several calls."""
        self._misstated = self._misstated + 1 if exceeds(measured_s, stated_s, MISSTATED_S) else 0
        return self._misstated >= MISSTATED_CALLS or exceeds(measured_s, stated_s, MISSTATED_AT_ONCE_S)

    def _exchange(self, order: Mapping[str, object], timeout_s: float) -> dict[str, Any]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
        except OSError:
            self._crashed()
        line = self._line(timeout_s)
        try:
            answer: dict[str, Any] = dict(json.loads(line))
        except (TypeError, ValueError) as error:
            self._end(FindingKind.INVALID_RESULT, f"no answer of its adapter: {line[:80]!r}", error)
        return answer

    def _line(self, timeout_s: float) -> bytes:
        assert self._process.stdout is not None
        place, end = self._process.stdout.fileno(), time.monotonic() + timeout_s
        answers = select.poll()
        answers.register(place, select.POLLIN)
        while b"\n" not in self._rest:
            if not answers.poll(1000 * POLL_S):
                self._look()
                cut_log(self._log)
                if time.monotonic() > end:
                    self._end(FindingKind.HANGING, f"has not answered for {timeout_s:g} s")
                continue
            data = os.read(place, 65536)
            if not data:
                self._crashed()
            self._rest += data
            if len(self._rest) > LONGEST_ANSWER:
                self._end(FindingKind.INVALID_RESULT, f"answered more than {LONGEST_ANSWER // MB} MB")
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _look(self) -> TreeUsage:
        """Return what its processes take; end them where that is more memory than they may have."""
        usage, limit = TreeUsage() if self._tree is None else self._tree.usage(), self._limits.memory_mb
        self._peak_bytes = max(self._peak_bytes, usage.rss_bytes)
        if self._tree is not None and self._mark_bytes is not None:
            mark = self._tree.peak() or 0
            self._is_mark_set_back |= mark < self._mark_bytes - MARK_TOLERANCE
            self._mark_bytes = max(self._mark_bytes, mark)
        if usage.rss_bytes > limit * MB:
            text = f"has {usage.rss_bytes // MB} MB resident, the limit is {limit} MB"
            self._end(FindingKind.OUT_OF_MEMORY, text)
        return usage

    def _end(self, kind: FindingKind, text: str, error: Exception | None = None) -> NoReturn:
        self.close()
        raise MethodFailureError(kind, text, ended=True) from error

    def _crashed(self) -> NoReturn:
        try:
            code = self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            code = 0
        lines = [line.strip() for line in self._log.read_text("utf-8", "replace").splitlines() if line.strip()]
        last = (lines or ["its log is empty"])[-1][:300]
        name = next((item.name for item in signal.Signals if item == -code), f"signal {-code}")
        how = f"with {code}" if code >= 0 else f"by {name}"
        self._end(FindingKind.CRASHED, f"has ended {how}: {last}")

    def close(self) -> None:
        """End the process and all that it has started, now."""
        if self._tree is not None:
            self._tree.kill()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        shutil.rmtree(self._folder, ignore_errors=True)
