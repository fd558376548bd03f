"""The supervisor with the process of a method, and the three steps of their start.

Each step requires the result of the step before it, and raises MethodFailureError if it fails:

    restrict        Started          the process is restricted, and has loaded neither the adapter nor the method
    load_adapter    LoadedAdapter    the adapter is loaded, but no code of the method
    open_method     OpenedMethod     the method is loaded and warmed up
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Self, TypeVar

from sfr_loc_map.child_process import ending_of
from sfr_loc_map.methods.call_monitor import ProcessMemory
from sfr_loc_map.methods.channel import Channel, ClosedChannelError
from sfr_loc_map.methods.child.loop import Hello, Order, Ready, Setup
from sfr_loc_map.methods.child.supervisor import Rules, Started
from sfr_loc_map.methods.isolation import environment_of
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.methods.registry import ADAPTERS, CHILD, Method
from sfr_loc_map.methods.scratch_folder import ScratchFolder
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree

EXIT_TIMEOUT_S = 10.0  #: Time in which an ended process exits.

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
        """Send a message and return the answer, as `Channel.exchange`; a closed channel is a crash."""
        try:
            return self._channel.exchange(message, kind, timeout_s, check)
        except ClosedChannelError:
            raise self._crash() from None

    def _crash(self) -> MethodFailureError:
        """Return how the process has ended, with the last line of its log."""
        how = "closed its output but is still running"
        with suppress(subprocess.TimeoutExpired):
            how = ending_of(self._process.wait(EXIT_TIMEOUT_S))
        return MethodFailureError(FindingKind.CRASHED, f"{how}: {self._folder.last_log_line()}", ended=True)


@dataclass(frozen=True, slots=True)
class LoadedAdapter:
    """A restricted process that has loaded the adapter, but no code of the method."""

    process: int  #: Process id.
    base_bytes: int | None  #: Resident memory, None if unknown.


@dataclass(frozen=True, slots=True)
class OpenedMethod:
    """A method that is loaded and warmed up."""

    hello: Hello
    idle_bytes: int | None  #: Resident memory, None if unknown.


def restrict(supervised: SupervisedProcess, rules: Rules, timeout_s: float) -> Started:
    """Restrict the process to the paths of the rules."""
    return supervised.exchange(rules, Started, timeout_s, supervised.memory.usage)


def load_adapter(supervised: SupervisedProcess, started: Started, timeout_s: float) -> LoadedAdapter:
    """Wait until the restricted process has loaded the adapter."""
    supervised.exchange(None, Ready, timeout_s, supervised.memory.usage)
    return LoadedAdapter(started["process"], supervised.memory.resident_bytes(started["process"]))


def open_method(supervised: SupervisedProcess, loaded: LoadedAdapter, setup: Setup, timeout_s: float) -> OpenedMethod:
    """Let the adapter load the method and warm it up."""
    hello = supervised.exchange(setup, Hello, timeout_s, supervised.memory.usage)
    return OpenedMethod(hello, supervised.memory.resident_bytes(loaded.process))
