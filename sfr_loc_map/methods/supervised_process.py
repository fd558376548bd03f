"""The supervisor with the process of a method, and the messages to and from this process."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Self, TypeVar

import msgspec

from sfr_loc_map.child_process import ending_of
from sfr_loc_map.methods.call_monitor import ProcessMemory
from sfr_loc_map.methods.child.loop import Order, Setup
from sfr_loc_map.methods.child.supervisor import Rules
from sfr_loc_map.methods.isolation import environment_of
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.methods.registry import ADAPTERS, CHILD, Method
from sfr_loc_map.methods.scratch_folder import ScratchFolder
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree

CHECK_S = 0.05  #: Period of the checks while an answer is awaited.
EXIT_TIMEOUT_S = 10.0  #: Time in which an ended process exits.
LONGEST_ANSWER = 16_000_000  #: Bytes.

T = TypeVar("T")


class SupervisedProcess(AbstractContextManager["SupervisedProcess"]):
    """The supervisor, which starts `loop.py` with the adapter of a method, and the pipes to `loop.py`."""

    def __init__(self, method: Method, folder: ScratchFolder, memory_mb: int) -> None:
        """Start the supervisor; `memory_mb` is the memory limit of all processes of the method."""
        self._folder = folder
        python = str(method.python)
        supervisor = [python, "-ES", str(CHILD / "supervisor.py")]
        loop = [python, str(CHILD / "loop.py"), str(ADAPTERS / method.adapter)]
        with folder.log.open("ab") as log:
            self._process = subprocess.Popen(
                supervisor + loop,
                env=environment_of(method, folder.work),
                cwd=folder.work,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._streams = (self._process.stdin, self._process.stdout)
        self._channel = Channel(*(stream.fileno() for stream in self._streams))
        tree = ProcessTree(self._process.pid, is_supervisor=True)
        self.memory = ProcessMemory(tree, folder.memory_bytes, memory_mb)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process and its descendants immediately."""
        self._process.terminate()
        try:
            self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for stream in self._streams:
            stream.close()

    def exchange(
        self, message: Rules | Setup | Order | None, kind: type[T], timeout_s: float, check: Callable[[], object]
    ) -> T:
        """Send a message and return the answer (`Channel.exchange`); MethodFailureError if the process has crashed."""
        try:
            return self._channel.exchange(message, kind, timeout_s, check)
        except ClosedChannelError:
            raise self._crash() from None

    def _crash(self) -> MethodFailureError:
        """Return how the process has ended, with the last line of its log."""
        how = "closed its output but is still running"
        with suppress(subprocess.TimeoutExpired):
            how = ending_of(self._process.wait(EXIT_TIMEOUT_S))
        return MethodFailureError(FindingKind.CRASHED, f"{how}: {self._folder.last_log_line()}")


class ClosedChannelError(Exception):
    """The process has closed its end of the channel."""


class Channel:
    """The pipes of a process, through which messages pass as lines of JSON."""

    def __init__(self, orders: int, answers: int) -> None:
        """Use the descriptors of the process's standard input and output."""
        os.set_blocking(orders, False)  # a method that does not read must not delay the timeout
        self._orders, self._answers = orders, answers
        self._unread = b""

    def exchange(
        self, message: Rules | Setup | Order | None, kind: type[T], timeout_s: float, check: Callable[[], object]
    ) -> T:
        """Send a message, and return the answer of the process.

        Without a message, return the next line of the process. While the answer is awaited, `check` is called
        periodically, and may raise an error. MethodFailureError if the answer is late or not of this kind.
        """
        request = b"" if message is None else json.dumps(message).encode() + b"\n"
        line = self._answer(request, timeout_s, check)
        try:
            return msgspec.convert(json.loads(line), kind)
        except (ValueError, RecursionError) as error:
            text = (
                f"the process of the method wrote {line[:80]!r} in place of an answer ({error}): the method must not "
                "write to the pipe of the answers"
            )
            raise MethodFailureError(FindingKind.INVALID_RESULT, text) from error

    def _answer(self, request: bytes, timeout_s: float, check: Callable[[], object]) -> bytes:
        """Send a request, and return the next line of the output.

        Check and timeout depend on the clock only, whatever the method reads or writes meanwhile.
        """
        streams = select.poll()
        streams.register(self._answers, select.POLLIN)
        if request:
            streams.register(self._orders, select.POLLOUT)
        now_s = time.monotonic()
        end_s, check_s = now_s + timeout_s, now_s + CHECK_S
        while request or b"\n" not in self._unread:
            now_s = time.monotonic()
            if now_s >= check_s:
                check()
                check_s = time.monotonic() + CHECK_S
            if now_s > end_s:
                text = f"has not answered for {timeout_s:g} s"
                raise MethodFailureError(FindingKind.HANGING, text)
            ready = dict(streams.poll(1000 * max(check_s - now_s, 0.0)))
            if self._orders in ready:
                request = self._send(request)
                if not request:
                    streams.unregister(self._orders)
            if self._answers in ready:
                self._receive()
        line, _, self._unread = self._unread.partition(b"\n")
        return line

    def _send(self, request: bytes) -> bytes:
        """Write as much of a request as the pipe accepts; return the rest."""
        try:
            return request[os.write(self._orders, request) :]
        except BlockingIOError:
            return request
        except OSError as error:
            raise ClosedChannelError from error

    def _receive(self) -> None:
        data = os.read(self._answers, 65536)
        if not data:
            raise ClosedChannelError
        self._unread += data
        if len(self._unread) > LONGEST_ANSWER:
            text = f"answered more than {LONGEST_ANSWER // 1_000_000} MB"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
