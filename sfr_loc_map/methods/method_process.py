"""The process of a method: its start, its calls with images in shared memory, and its end."""

from __future__ import annotations

import mmap
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from sfr_loc_map.child_process import ending_of
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.methods.call_monitor import CallFindings, CallMonitor, Measurement, ProcessMemory
from sfr_loc_map.methods.channel import Channel, ClosedChannelError
from sfr_loc_map.methods.child.loop import Answer, Camera, Hello, Order, Pose, Ready, Reply, Setup
from sfr_loc_map.methods.child.supervisor import Rules, Started
from sfr_loc_map.methods.isolation import environment_of, isolation_of, rules_of, search_path_of
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.registry import ADAPTERS, CHILD, Method, MethodLimits
from sfr_loc_map.metrics.calls.call_score import is_statistic
from sfr_loc_map.metrics.table.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree, bytes_of_files
from sfr_loc_map.suite_names import Task

EXIT_TIMEOUT_S = 10.0
SHARED_MEMORY = Path("/dev/shm")

T = TypeVar("T")


def numbers_of(pose: Transform) -> Pose:
    """Return the matrix `(4, 4)` of a transform, row by row, for a method."""
    numbers: Pose = pose.matrix.ravel().tolist()
    return numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessSettings:
    """The settings of all processes of one method."""

    method: Method
    rig: StereoRig
    limits: MethodLimits
    rate_hz: float = 0.0  #: Rate of the pairs; not used by a mapper.
    keeps_rate: bool = False  #: Whether no pair is sent earlier than at this rate; the method may work between calls.
    disparities: int = 0  #: Number of disparities that a matcher searches; not used by a localiser.
    hidden: Sequence[Path]  #: Paths that the process cannot read.

    def setup(self, images: Path, T_ds_rb: Transform) -> Setup:
        """Return the parameters of the adapter: the file of the images, and the initial pose of RB."""
        method, rig = self.method, self.rig
        camera = Camera(
            width=rig.width, height=rig.height, fx=rig.fx, fy=rig.fy, cx=rig.cx, cy=rig.cy, baseline_m=rig.baseline_m
        )
        return Setup(
            task=method.task.value,
            target=method.target,
            search_path=search_path_of(method),
            config=method.config,
            images=str(images),
            camera=camera,
            T_rb_sb=None if rig.T_rb_sb is None else numbers_of(rig.T_rb_sb),
            T_rb_left=numbers_of(rig.T_rb_left if method.task is Task.LOCALISATION else Transform.identity()),
            T_ds_rb=numbers_of(T_ds_rb),
            rate_hz=self.rate_hz,
            disparities=self.disparities,
            vocabulary=method.vocabulary,
        )


@dataclass(frozen=True, slots=True)
class Returned:
    """What a process returned in a call: the reply, and the content of each requested file that exists."""

    reply: Reply
    contents: Mapping[str, bytes | MethodFailureError]  #: The error is the reason why a file cannot be read.

    def result(self) -> tuple[Answer, dict[str, bytes]]:
        """Return the answer of the adapter and the files of its arrays; MethodFailureError without a valid result."""
        if "fault" in self.reply:
            raise MethodFailureError(FindingKind(self.reply["fault"]), self.reply.get("text", ""))
        if "result" not in self.reply or "seconds" not in self.reply:
            raise MethodFailureError(
                FindingKind.INVALID_RESULT, "the process of the method answered without a result or a time"
            )
        contents: dict[str, bytes] = {}
        for suffix, content in self.contents.items():
            if isinstance(content, MethodFailureError):
                raise content
            contents[suffix] = content
        return self.reply["result"], contents


class MethodProcess:
    """The process of a method, which is warmed up once constructed.

    `maps_sets`: a mapper maps all pairs in one call. `fuses`: a separate call fuses the maps of single pairs. Both may
    be false. Arrays of the results are at `output` plus a suffix for their kind. `idle_bytes` is the resident memory
    after warm-up, None if unknown.
    """

    def __init__(self, settings: ProcessSettings, T_ds_rb: Transform) -> None:
        """Start the process, and wait for its warm-up; `T_ds_rb` is the initial pose."""
        rig, limits = settings.rig, settings.limits
        self._call_timeout_s = limits.call_timeout_s
        self._findings = CallFindings()
        self._last_call: Measurement | None = None
        with ExitStack() as resources:
            shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
            self._is_in_memory = shared is not None  # whether the files of the folder use memory
            self._folder = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
            resources.callback(shutil.rmtree, self._folder, ignore_errors=True)
            # open in this process, so that the kernel grants the method no lease on the log
            self._log = resources.enter_context((self._folder / "log").open("w+b", buffering=0))
            self.output = str(self._folder / "result")
            images = self._folder / "images"
            self._images = np.asarray(np.memmap(images, np.uint8, "w+", shape=(MAX_PAIRS, 2, rig.height, rig.width)))
            self._process = self._start(settings.method)
            resources.callback(self._end)
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._channel = Channel(self._process.stdin.fileno(), self._process.stdout.fileno())
            tree = ProcessTree(self._process.pid, is_supervisor=True)
            memory = ProcessMemory(tree, self._file_bytes, limits.memory_mb)
            rules = rules_of(settings.method, self._folder, settings.hidden)
            try:
                started = self._exchange(rules, Started, limits.start_timeout_s, memory.usage)
                self._exchange(None, Ready, limits.start_timeout_s, memory.usage)
                base_bytes = memory.resident_bytes(started["process"])  # before any code of the method is loaded
                setup = settings.setup(images, T_ds_rb)
                hello = self._exchange(setup, Hello, limits.start_timeout_s, memory.usage)
            except MethodFailureError as error:
                raise MethodFailureError(error.kind, f"method {settings.method.name} {error}", ended=True) from error
            self.isolation = isolation_of(started["isolation"], can_read_all_files=started["can_read_all_files"])
            self.idle_bytes = memory.resident_bytes(started["process"])
            self._monitor = CallMonitor(memory, started["process"], base_bytes, keeps_rate=settings.keeps_rate)
            self._resources = resources.pop_all()
        self.version = hello["version"]
        self.fuses, self.maps_sets = hello["fuses"], hello["maps_sets"]

    def _start(self, method: Method) -> subprocess.Popen[bytes]:
        """Start the supervisor, which starts `loop.py` with the adapter of the method."""
        work = self._folder / "work"
        work.mkdir()
        python = str(method.python)
        supervisor = [python, "-ES", str(CHILD / "supervisor.py")]
        loop = [python, str(CHILD / "loop.py"), str(ADAPTERS / method.adapter)]
        with open(self._log.name, "ab") as log:
            return subprocess.Popen(
                supervisor + loop,
                env=environment_of(method, work),
                cwd=work,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )

    def call(
        self, order: Order, pairs: Sequence[StereoPair], largest_files: Mapping[str, int]
    ) -> tuple[MethodCall, Returned]:
        """Share the pairs, send an order, and return the record of the call and what the process returned.

        The call ends when the answer and the files of its arrays are read; `largest_files` has their largest sizes by
        suffix, bytes. Work of the method between two calls is added to the second call. MethodFailureError if
        the call fails. The process is then closed.
        """
        for suffix in largest_files:
            with suppress(OSError):  # the method may have made a folder of this name, which is then no valid array
                self._file(suffix).unlink()
        try:
            running = self._monitor.begin_call(self._last_call)
            self._log.truncate(0)  # the log then holds only this call, for the message after a crash
            for number, pair in enumerate(pairs):
                self._images[number] = pair.left, pair.right
            reply = self._exchange(order, Reply, self._call_timeout_s, running.check_memory)
            if reply.get("number") != order["number"]:  # the method wrote a line, so that later answers would lag
                text = (
                    f"the process of the method answered call {reply.get('number')} in place of call {order['number']}"
                    ": the method must not write to the pipe of the answers"
                )
                raise MethodFailureError(FindingKind.INVALID_RESULT, text, ended=True)
            contents = {suffix: self._content(suffix, limit) for suffix, limit in largest_files.items()}
            measured = running.end()
        except MethodFailureError:
            self.close()
            raise
        self._last_call = measured
        known = {suffix: content for suffix, content in contents.items() if content is not None}
        return self._record(measured, reply), Returned(reply, known)

    def _record(self, measured: Measurement, reply: Reply) -> MethodCall:
        """Return the record of a call; without time and memory if the method raised an error."""
        if "seconds" not in reply:
            return MethodCall()
        stated_s = reply["seconds"]
        stated = reply.get("result", {}).get("statistics", {})
        usable = {name: value for name, value in stated.items() if is_statistic(name, value)}
        statistics = {**usable, "stated_s": stated_s, **measured.figures}
        return MethodCall(measured.usage, self._findings.add(measured, stated_s), statistics=statistics)

    def _file(self, suffix: str) -> Path:
        return Path(f"{self.output}.{suffix}.npy")

    def _content(self, suffix: str, limit: int) -> bytes | MethodFailureError | None:
        """Return the content of an array's file, or why the file cannot be read; None without a file.

        The method can write anything to this folder, at any time.
        """
        try:
            return read_bytes(self._file(suffix), limit)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            return MethodFailureError(FindingKind.INVALID_RESULT, f"the {suffix} cannot be read: {error}")

    def _exchange(
        self, message: Rules | Setup | Order | None, kind: type[T], timeout_s: float, check: Callable[[], object]
    ) -> T:
        """Send a message and return the answer, as `Channel.exchange`; a closed channel is a crash."""
        try:
            return self._channel.exchange(message, kind, timeout_s, check)
        except ClosedChannelError:
            raise self._crash() from None

    def _file_bytes(self) -> int:
        """Return the memory occupied by files that the method can write; no process's resident memory includes it."""
        if not self._is_in_memory:
            return 0
        whole_pages = -(-self._images.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
        return bytes_of_files(self._folder, self._folder / "images", whole_pages)

    def _crash(self) -> MethodFailureError:
        """Return how the process has ended, with the last line of its log."""
        how = "closed its output but is still running"
        with suppress(subprocess.TimeoutExpired):
            how = ending_of(self._process.wait(EXIT_TIMEOUT_S))
        self._log.seek(0)
        text = self._log.read().decode("utf-8", "replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        last = (lines or ["its log is empty"])[-1][:300]
        return MethodFailureError(FindingKind.CRASHED, f"{how}: {last}", ended=True)

    def close(self) -> None:
        """End the process and its descendants immediately, and remove its folder."""
        self._resources.close()

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
