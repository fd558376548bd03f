"""The nodes as processes that one other process starts, watches and ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import IO

from sfr_loc_map.errors import NodeError

SUPERVISOR_VARIABLE = "SFR_SUPERVISOR_PID"
"""Tells a node which process started it and must not outlive; see `runner.end_with_supervisor`."""
ESCALATION = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
"""Signals that end a process, and how many seconds each gets."""
CANNOT_START = 2
"""Exit code of a node that cannot work with what it was given."""


def start_process(
    module: str, arguments: Sequence[str], log: IO[bytes] | None, environment: Mapping[str, str] = MappingProxyType({})
) -> subprocess.Popen[bytes]:
    """Start a module of this package as a process that does not outlive this one.

    Args:
        module: Name below `sfr_loc_map`, such as `nodes.localisation_node`.
        arguments: Its command line.
        log: File for its standard output and error; None: those of this process.
        environment: Variables beside those of this process.

    Raises:
        OSError: If the system cannot start a process.
    """
    # A session of its own: Ctrl-C at the terminal reaches this process alone, which then ends the nodes.
    return subprocess.Popen(
        [sys.executable, "-m", f"sfr_loc_map.{module}", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT if log is not None else None,
        env=os.environ | {SUPERVISOR_VARIABLE: str(os.getpid()), "PYTHONUNBUFFERED": "1"} | dict(environment),
        start_new_session=True,
    )


@dataclass(frozen=True, slots=True)
class _Process:
    name: str
    arguments: tuple[str, ...]
    popen: subprocess.Popen[bytes]


class Supervisor:
    """Starts nodes and makes sure that none is left; a context manager."""

    def __init__(self, folder: Path | None = None) -> None:
        """Start nothing yet.

        Args:
            folder: Folder for what the nodes write to standard output and error; None: they write to those of this
                process.
        """
        self._folder = folder
        self._processes: list[_Process] = []

    def __enter__(self) -> Supervisor:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all nodes."""
        self.stop()

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by the nodes' names."""
        return {process.name: process.popen.pid for process in self._processes}

    def start(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Start a node of this package.

        Args:
            name: Name of the module and of the node, such as `localisation_node`.
            arguments: Its command line.

        Raises:
            NodeError: If the system cannot start a process.
        """
        try:
            with ExitStack() as stack:
                log = stack.enter_context(self._log(name).open("wb")) if self._folder is not None else None
                popen = start_process(f"nodes.{name}", arguments, log)
        except OSError as error:
            raise NodeError(f"cannot start {name}: {error.strerror}; check memory and process limits") from error
        self._processes.append(_Process(name, tuple(arguments), popen))

    def check(self) -> None:
        """Make sure that all nodes live.

        Raises:
            NodeError: If one has ended; says how and its last words.
        """
        for process in self._processes:
            if process.popen.poll() is not None:
                words = f"{_how_it_ended(process)}: {self.last_log_line(process.name)}"
                raise NodeError(f"{words}; correct that and start again")

    def revive(self) -> list[str]:
        """Start the nodes again that have broken down.

        Returns:
            How each of them ended.

        Raises:
            NodeError: If one ended on purpose, or because it cannot work with what it was given.
        """
        ends = []
        for process in list(self._processes):
            code = process.popen.poll()
            if code in (0, CANNOT_START):
                self.check()
            if code is not None:
                ends.append(_how_it_ended(process))
                self._processes.remove(process)
                self.start(process.name, process.arguments)
        return ends

    def last_log_line(self, name: str) -> str:
        """Return the last line that a node wrote."""
        if self._folder is None:
            return "what it said is above"
        if name not in self.pids:
            return "it was not started"
        lines = self._log(name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else "it said nothing"

    def stop(self) -> None:
        """End all nodes: ask, then insist, then kill. Returns when none is left."""
        for number, patience_s in ESCALATION:
            running = [process for process in self._processes if process.popen.poll() is None]
            for process in running:
                process.popen.send_signal(number)
            deadline = time.monotonic() + patience_s
            for process in running:
                try:
                    process.popen.wait(max(deadline - time.monotonic(), 0.01))
                except subprocess.TimeoutExpired:
                    continue
        self._processes = [process for process in self._processes if process.popen.poll() is None]

    def _log(self, name: str) -> Path:
        return (self._folder or Path()) / f"{name}.log"


def _how_it_ended(process: _Process) -> str:
    code = process.popen.returncode
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return f"{process.name} {how}"


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Turn SIGTERM into KeyboardInterrupt, so that the nodes are ended; more signals are ignored while that is done."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        for other in (signal.SIGTERM, signal.SIGINT):
            signal.signal(other, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
