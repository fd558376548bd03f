"""The process of a method: its start, its calls with images in shared memory, and its end."""

from __future__ import annotations

import json
import mmap
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sfr_loc_map.child_process import ending_of
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.methods.call_monitor import CallFindings, CallMonitor
from sfr_loc_map.methods.channel import Channel, ClosedChannelError
from sfr_loc_map.methods.child.loop import Answer, Camera, Hello, Order, OrderedPair, Pose, Reply, Setup
from sfr_loc_map.methods.isolation import environment_of, isolation_of, rules_of
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.registry import ADAPTERS, CHILD, Method, MethodLimits
from sfr_loc_map.metrics.table.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree, bytes_of_files
from sfr_loc_map.suite_names import Task

EXIT_TIMEOUT_S = 10.0
SHARED_MEMORY = Path("/dev/shm")


def numbers_of(pose: Transform) -> Pose:
    """Return the matrix `(4, 4)` of a transform, row by row, for a method."""
    numbers: Pose = pose.matrix.ravel().tolist()
    return numbers


class MethodProcess:
    """The process of a method, which is warmed up once constructed.

    `maps_sets`: a mapper maps all pairs in one call. `fuses`: a separate call fuses the maps of single pairs. Both may
    be false. Arrays of the results are at `output` plus a suffix for their kind.
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
        self._limits = limits
        shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
        self._folder = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
        # open in this process, so that the kernel grants no lease of the log
        self._log = (self._folder / "log").open("w+b", buffering=0)
        self.output = str(self._folder / "result")
        self._is_in_memory = shared is not None  # whether the files of the folder use memory
        images = self._folder / "images"
        self._images = np.asarray(np.memmap(images, np.uint8, "w+", shape=(MAX_PAIRS, 2, rig.height, rig.width)))
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
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        tree = ProcessTree(self._process.pid, is_supervisor=True)
        self._monitor = CallMonitor(tree, self._file_bytes, limits.memory_mb, keeps_rate=keeps_rate)
        self._findings = CallFindings()
        orders, answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._channel = Channel(orders, answers, self._monitor.check_memory)
        try:
            with self._closed_if_ended():
                supervisor = json.loads(self._channel.line(limits.start_timeout_s))
                hello = self._channel.exchange(setup, Hello, limits.start_timeout_s)
        except BaseException as error:
            self.close()
            if isinstance(error, MethodFailureError):
                raise MethodFailureError(error.kind, f"method {method.name} {error}", ended=True) from error
            raise
        self.version = hello["version"]
        self.isolation = isolation_of(
            str(supervisor["isolation"]), can_read_all_files=bool(supervisor["can_read_all_files"])
        )
        self.fuses, self.maps_sets = hello["fuses"], hello["maps_sets"]
        self._monitor.start(int(supervisor["process"]))
        self.idle_bytes = self._monitor.idle_bytes

    def _start(self, method: Method, hidden: Sequence[Path]) -> subprocess.Popen[bytes]:
        """Start the supervisor, which starts `loop.py` with the adapter of the method."""
        work = self._folder / "work"
        work.mkdir()
        rules = json.dumps(rules_of(method, self._folder, hidden))
        python = str(method.python)
        supervisor = [python, "-ES", str(CHILD / "supervisor.py"), rules]
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
        self,
        kind: str,
        pairs: Sequence[StereoPair],
        about: Sequence[OrderedPair],
        since_start_s: float = 0.0,
        arrays: Mapping[str, int] = MappingProxyType({}),
    ) -> tuple[MethodCall, Answer, dict[str, bytes]]:
        """Share the pairs, send an order, and return the call, the answer of the adapter, and the files of its arrays.

        The call ends when the answer and the files are read; `arrays` has the largest sizes of the files by suffix,
        bytes. Work of the method between two calls is added to the second call. MethodFailureError describes the
        failure if there is no valid result.
        """
        order = Order(call=kind, pairs=list(about), since_start_s=since_start_s, output=self.output)
        with self._closed_if_ended():
            self._monitor.begin_call()
            self._log.truncate(0)  # the log then holds only this call, for the message after a crash
            for images, pair in zip(self._images, pairs, strict=False):
                images[0], images[1] = pair.left, pair.right
            reply = self._channel.exchange(order, Reply, self._limits.call_timeout_s)
            contents = {suffix: self._content(suffix, limit) for suffix, limit in arrays.items()}
            measured = self._monitor.end_call()
        if "fault" in reply:
            raise MethodFailureError(FindingKind(reply["fault"]), reply.get("text", ""))
        if "result" not in reply or "seconds" not in reply:
            raise MethodFailureError(FindingKind.INVALID_RESULT, "the adapter returned no result")
        if problems := [content for content in contents.values() if isinstance(content, MethodFailureError)]:
            raise problems[0]
        answer, stated_s = reply["result"], reply["seconds"]
        statistics = {**answer.get("statistics", {}), "stated_s": stated_s, **measured.figures}
        call = MethodCall(measured.usage, self._findings.add(measured, stated_s), statistics=statistics)
        return call, answer, {suffix: content for suffix, content in contents.items() if isinstance(content, bytes)}

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

    def _file_bytes(self) -> int:
        """Return the memory occupied by files that the method can write; no process's resident memory includes it."""
        if not self._is_in_memory:
            return 0
        whole_pages = -(-self._images.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
        return bytes_of_files(self._folder, self._folder / "images", whole_pages)

    @contextmanager
    def _closed_if_ended(self) -> Iterator[None]:
        """Close the process after a failure that ends it; a closed channel is a crash."""
        try:
            yield
        except ClosedChannelError:
            failure = self._crash()
            self.close()
            raise failure from None
        except MethodFailureError as error:
            if error.ended:
                self.close()
            raise

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
