"""The process of a method, with images in shared memory, JSON messages, and limits of time and memory."""

from __future__ import annotations

import json
import math
import mmap
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
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import NoReturn, TypeVar

import msgspec
import numpy as np

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.host_clock import CallClock
from sfr_loc_map.inputs import Task, read_bytes
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.memory_mark import peak_of, reset_peak
from sfr_loc_map.methods.child.loop import Answer, Camera, Hello, Order, OrderedPair, Pose, Reply, Setup
from sfr_loc_map.methods.isolation import environment_of, rules_of
from sfr_loc_map.methods.registry import ADAPTERS, CHILD, Method, MethodLimits
from sfr_loc_map.metrics.call_meter import CallUsage
from sfr_loc_map.metrics.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree, TreeUsage, bytes_of_files

EXIT_TIMEOUT_S = 10.0
POLL_S = 0.05  #: Period of memory checks during a call.
SHARED_MEMORY = Path("/dev/shm")
MB = 1_000_000
LEAK_CALLS, LEAK_BYTES = 50, 40 * MB
"""Number of calls and growth, bytes, of a leak. The growth is between the minima of the fifths of the calls, so that a
saw-tooth does not hide the growth. Our own keyframe window grows by 24 MB while it fills."""
LEAK_SHARE = 0.02
"""Fraction of the growth by which each fifth must exceed the previous fifth. Loading of libraries and a window that
fills also grow memory by more than `LEAK_BYTES`, but the memory is then constant."""
MISSTATED_S, MISSTATED_RATIO = 1.0, 0.5
"""Allowed difference, s and fraction, of the sums of stated and measured times. The measured time includes copies of
the images and the transfer of the result, and a busy host delays single calls."""
MISSTATED_CALL_S = 0.01
"""Allowed difference per call, s. A transfer takes 5 ms, which adds up to 1 s in 200 calls."""
LONGEST_ANSWER = 16_000_000  #: Bytes.
BETWEEN_S = 0.002
"""Processor time between two calls that is not added to the second call, s. The process of an idle method needs less to
end a call."""

T = TypeVar("T")


def leak_in(resident: Sequence[int]) -> str:
    """Return the finding of a leak, from the memory after each of the last calls; empty without a leak."""
    if len(resident) < LEAK_CALLS:
        return ""
    least = np.array(resident)[-LEAK_CALLS:].reshape(5, -1).min(axis=1)
    growth = int(least[-1] - least[0])
    if growth <= LEAK_BYTES or (np.diff(least) < LEAK_SHARE * growth).any():
        return ""
    return (
        f"{FindingKind.LEAKING}: memory grows by {growth / (0.8 * LEAK_CALLS) / MB:.1f} MB per call "
        f"over {LEAK_CALLS} calls"
    )


def is_misstated(measured_s: float, stated_s: float, calls: int) -> bool:
    """Return whether stated and measured times differ by more than copies and transfers explain."""
    return abs(measured_s - stated_s) > max(MISSTATED_S, MISSTATED_RATIO * measured_s, MISSTATED_CALL_S * calls)


class MethodFailureError(MethodError):
    """A call returned no valid result; `kind` classifies the failure, `ended` is True if the process has ended."""

    def __init__(self, kind: FindingKind, text: str, *, ended: bool = False) -> None:
        super().__init__(text)
        self.kind, self.ended = kind, ended


class NotStartedAgainError(MethodFailureError):
    """A call was not made, because the method was started too often; the earlier failures are the findings."""

    def __init__(self) -> None:
        super().__init__(FindingKind.CRASHED, "not started again")


@dataclass(frozen=True, slots=True, eq=False)
class MethodCall:
    """Resource use, result and findings of one call of a method under test."""

    usage: CallUsage = field(default_factory=lambda: CallUsage(math.nan))  #: NaN if the call did not return.
    finding: str = ""  #: Misbehaviour, `KIND: text`; empty if there is none.
    reason: str = ""  #: Why the pose is degraded or lost.
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None  #: `(6, 6)` covariance of the pose.
    step: FloatArray | None = None  #: `(48,)` uncertainty of the step.


def _ending(code: int) -> str:
    """Describe the exit code of a process; a negative code is the number of the signal that killed the process."""
    name = next((item.name for item in signal.Signals if item == -code), f"signal {-code}")
    return f"with {code}" if code >= 0 else f"by {name}"


def numbers_of(pose: Transform) -> Pose:
    """Return the matrix `(4, 4)` of a transform, row by row, for a method."""
    numbers: Pose = pose.matrix.ravel().tolist()
    return numbers


class MethodProcess:
    """The process of a method, which is warmed up once constructed.

    A mapper `maps_sets` of pairs in one call, or `fuses` maps of single pairs, or neither. Arrays of the results are at
    `output` plus a suffix for their kind.
    """

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits,
        *,
        T_ds_rb: Transform,
        rate_hz: float = 0.0,
        disparities: int = 0,
        keeps_rate: bool = False,
        hidden: Sequence[Path],
    ) -> None:
        """Start the process without access to `hidden`, and wait for its warm-up; `T_ds_rb` is the initial pose.

        `keeps_rate` states that pairs are sent at `rate_hz`, so that the method may work between its calls.
        """
        self._limits, self._keeps_rate = limits, keeps_rate
        shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
        self._folder = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
        # open in this process, so that the kernel grants no lease of the log
        self._log = (self._folder / "log").open("w+b", buffering=0)
        self.output = str(self._folder / "result")
        self._is_in_memory = shared is not None  # whether the files of the folder use memory
        images = self._folder / "images"
        self._images = np.asarray(np.memmap(images, np.uint8, "w+", shape=(MAX_PAIRS, 2, rig.height, rig.width)))
        self._unread = b""  # bytes of the standard output
        self._method_pid = 0
        self._tree: ProcessTree | None = None
        self._peak_bytes = 0  # largest sampled memory of the current call
        self._resident: deque[int] = deque(maxlen=LEAK_CALLS)
        self._measured_s = self._stated_s = 0.0  # summed over the calls since the last finding
        self._stated_calls = 0
        self._clock = CallClock()
        self._answered_s: float | None = None  # end of the last call, by the monotonic clock
        self._answered_cpu_s = 0.0  # processor time of all processes at that time
        setup = Setup(
            task=method.task.value,
            target=method.target,
            config=method.config,
            images=str(images),
            camera=Camera(
                width=rig.width,
                height=rig.height,
                fx=rig.fx,
                fy=rig.fy,
                cx=rig.cx,
                cy=rig.cy,
                baseline_m=rig.baseline_m,
            ),
            T_rb_sb=None if rig.T_rb_sb is None else numbers_of(rig.T_rb_sb),
            T_rb_left=numbers_of(rig.T_rb_left if method.task is Task.LOCALISATION else Transform.identity()),
            T_ds_rb=numbers_of(T_ds_rb),
            rate_hz=rate_hz,
            disparities=disparities,
            vocabulary=method.vocabulary,
        )
        self._process = self._start(method, hidden)
        try:
            supervisor = json.loads(self._line(limits.start_timeout_s))
            self._method_pid = int(supervisor["process"])
            self._tree = ProcessTree(self._process.pid, is_supervisor=True)
            hello = self._exchange(setup, Hello, limits.start_timeout_s)
        except BaseException as error:
            self.close()
            if isinstance(error, MethodFailureError):
                raise MethodFailureError(error.kind, f"method {method.name} {error}", ended=True) from error
            raise
        self.version, self.isolation = hello["version"], str(supervisor["isolation"])
        self.fuses, self.maps_sets = hello["fuses"], hello["maps_sets"]
        idle_bytes = reset_peak(self._method_pid)
        self.idle_bytes = None if idle_bytes is None else idle_bytes + self._file_bytes()
        self._tree.usage()
        self._answered_cpu_s = self._tree.cpu_s()

    def _start(self, method: Method, hidden: Sequence[Path]) -> subprocess.Popen[bytes]:
        """Start the supervisor, which starts `loop.py` with the adapter of the method."""
        work = self._folder / "work"
        work.mkdir()
        rules = json.dumps(rules_of(method, self._folder, hidden))
        python = str(method.python)
        supervisor = [python, "-ES", str(CHILD / "supervisor.py"), rules]
        loop = [python, str(CHILD / "loop.py"), str(ADAPTERS / method.adapter)]
        with open(self._log.name, "ab") as log:
            process = subprocess.Popen(
                supervisor + loop,
                env=environment_of(method, work),
                cwd=work,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)  # a method that does not read must not delay the timeout
        return process

    def call(
        self,
        kind: str,
        pairs: Sequence[StereoPair],
        about: Sequence[OrderedPair],
        since_start_s: float = 0.0,
        arrays: Mapping[str, int] = MappingProxyType({}),
    ) -> tuple[MethodCall, Answer, dict[str, bytes]]:
        """Share the pairs, send an order, and return the call, the answer of the adapter, and the files of its arrays.

        The call begins before the images are shared, because the method could already work on them. The call ends when
        the answer and the files are read; `arrays` has the largest sizes of the files by suffix, bytes. Work of the
        method between two calls is added to the second call. MethodFailureError describes the failure if there is no
        valid result.
        """
        assert self._tree is not None
        order = Order(call=kind, pairs=list(about), since_start_s=since_start_s, output=self.output)
        begun = self._tree.usage()
        self._peak_bytes = 0
        reset_peak(self._method_pid)
        between_s = max(self._tree.cpu_s() - self._answered_cpu_s, 0.0)
        worked_s = self._worked_s(between_s)
        self._clock.begin()
        self._log.truncate(0)  # the log then holds only this call, for the message after a crash
        for images, pair in zip(self._images, pairs, strict=False):
            images[0], images[1] = pair.left, pair.right
        reply = self._exchange(order, Reply, self._limits.call_timeout_s)
        contents = {suffix: self._content(suffix, limit) for suffix, limit in arrays.items()}
        seconds = self._clock.end()
        self._answered_s, self._answered_cpu_s = time.monotonic(), self._tree.cpu_s()
        now = self._look()
        if "fault" in reply:
            raise MethodFailureError(FindingKind(reply["fault"]), reply.get("text", ""))
        if "result" not in reply or "seconds" not in reply:
            raise MethodFailureError(FindingKind.INVALID_RESULT, "the adapter returned no result")
        if problems := [content for content in contents.values() if isinstance(content, MethodFailureError)]:
            raise problems[0]
        answer, stated_s = reply["result"], reply["seconds"]
        # the peak covers only the method itself; the sampled sum includes its child processes
        peak = peak_of(self._method_pid)
        peak = None if peak is None else max(peak, self._peak_bytes)
        above = None if peak is None or self.idle_bytes is None else max(peak - self.idle_bytes, 0)
        taken = {
            "stated_s": stated_s,
            "cpu_s": round(now.cpu_s - begun.cpu_s, 2),
            "cpu_between_s": round(between_s, 2),
            "threads": now.threads,
            "processes": now.processes,
        }
        statistics = {**answer.get("statistics", {}), **taken}
        finding = self._leak(now.rss_bytes) or self._misstatement(seconds, stated_s)
        usage = CallUsage(seconds + worked_s, peak, above)
        found = {suffix: content for suffix, content in contents.items() if isinstance(content, bytes)}
        return MethodCall(usage, finding, statistics=statistics), answer, found

    def _worked_s(self, between_s: float) -> float:
        """Return the time that the method worked since the last call, s.

        This time is at most the processor time of all processes, `between_s`, and at most the time that passed. Before
        the first call the method has no images. A method that receives pairs at their rate may work between its calls.
        """
        if self._answered_s is None or self._keeps_rate or between_s <= BETWEEN_S:
            return 0.0
        return min(between_s, time.monotonic() - self._answered_s)

    def _content(self, suffix: str, limit: int) -> bytes | MethodFailureError | None:
        """Return the content of an array's file, or why the file cannot be read; None without a file.

        The method can write anything to this folder, at any time.
        """
        try:
            return read_bytes(Path(f"{self.output}.{suffix}.npy"), limit)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            return MethodFailureError(FindingKind.INVALID_RESULT, f"the {suffix} cannot be read: {error}")

    def _leak(self, resident_bytes: int) -> str:
        self._resident.append(resident_bytes)
        finding = leak_in(self._resident)
        if finding:
            self._resident.clear()  # each growth is reported once
        return finding

    def _misstatement(self, measured_s: float, stated_s: float) -> str:
        self._measured_s += measured_s
        self._stated_s += stated_s
        self._stated_calls += 1
        if not is_misstated(self._measured_s, self._stated_s, self._stated_calls):
            return ""
        text = f"reports {self._stated_s:.3f} s for calls that took {self._measured_s:.3f} s from request to answer"
        self._measured_s = self._stated_s = 0.0
        self._stated_calls = 0
        return f"{FindingKind.MISSTATED}: {text}"

    def _exchange(self, message: Setup | Order, kind: type[T], timeout_s: float) -> T:
        line = self._line(timeout_s, json.dumps(message).encode() + b"\n")
        try:
            return msgspec.convert(json.loads(line), kind)
        except (ValueError, RecursionError) as error:
            self._end(FindingKind.INVALID_RESULT, f"invalid answer of the adapter ({error}): {line[:80]!r}", error)

    def _line(self, timeout_s: float, request: bytes = b"") -> bytes:
        """Send a request, and return the next line of the output.

        Memory and timeout are checked by the clock, whatever the method reads or writes meanwhile.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        orders, answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        streams = select.poll()
        streams.register(answers, select.POLLIN)
        if request:
            streams.register(orders, select.POLLOUT)
        now_s = time.monotonic()
        end_s, look_s = now_s + timeout_s, now_s + POLL_S
        while request or b"\n" not in self._unread:
            now_s = time.monotonic()
            if now_s >= look_s:
                self._look()
                look_s = time.monotonic() + POLL_S
            if now_s > end_s:
                self._end(FindingKind.HANGING, f"has not answered for {timeout_s:g} s")
            ready = dict(streams.poll(1000 * max(look_s - now_s, 0.0)))
            if orders in ready:
                request = self._sent(orders, request)
                if not request:
                    streams.unregister(orders)
            if answers in ready:
                self._receive(answers)
        line, _, self._unread = self._unread.partition(b"\n")
        return line

    def _sent(self, orders: int, request: bytes) -> bytes:
        """Write as much of a request as the pipe accepts; return the rest."""
        try:
            return request[os.write(orders, request) :]
        except BlockingIOError:
            return request
        except OSError:
            self._crashed()

    def _receive(self, answers: int) -> None:
        data = os.read(answers, 65536)
        if not data:
            self._crashed()
        self._unread += data
        if len(self._unread) > LONGEST_ANSWER:
            self._end(FindingKind.INVALID_RESULT, f"answered more than {LONGEST_ANSWER // MB} MB")

    def _look(self) -> TreeUsage:
        """Return the resource use of the processes; end them if they exceed the memory limit."""
        usage = TreeUsage() if self._tree is None else self._tree.usage()
        usage = replace(usage, rss_bytes=usage.rss_bytes + self._file_bytes())
        self._peak_bytes = max(self._peak_bytes, usage.rss_bytes)
        limit = self._limits.memory_mb
        if usage.rss_bytes > limit * MB:
            text = f"has {usage.rss_bytes // MB} MB resident, the limit is {limit} MB"
            self._end(FindingKind.OUT_OF_MEMORY, text)
        return usage

    def _file_bytes(self) -> int:
        """Return the memory occupied by files that the method can write; no process's resident memory includes it."""
        if not self._is_in_memory:
            return 0
        whole_pages = -(-self._images.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
        return bytes_of_files(self._folder, self._folder / "images", whole_pages)

    def _end(self, kind: FindingKind, text: str, error: Exception | None = None) -> NoReturn:
        self.close()
        raise MethodFailureError(kind, text, ended=True) from error

    def _crashed(self) -> NoReturn:
        how = "has closed its output and still runs"
        with suppress(subprocess.TimeoutExpired):
            how = f"has ended {_ending(self._process.wait(EXIT_TIMEOUT_S))}"
        self._log.seek(0)
        text = self._log.read().decode("utf-8", "replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        last = (lines or ["its log is empty"])[-1][:300]
        self._end(FindingKind.CRASHED, f"{how}: {last}")

    def close(self) -> None:
        """End the process and its descendants immediately."""
        self._process.terminate()
        try:
            self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream is not None:
                stream.close()
        shutil.rmtree(self._folder, ignore_errors=True)
