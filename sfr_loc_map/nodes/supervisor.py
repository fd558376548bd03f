"""The nodes as processes that one other process starts, watches and ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.errors import NodeError

SUPERVISOR_VARIABLE = "SFR_SUPERVISOR_PID"
"""Tells a node which process started it and must not outlive; see `runner.end_with_supervisor`."""
ESCALATION = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
"""Signals that end a process, and how many seconds each gets."""


@dataclass(frozen=True, slots=True)
class _Process:
    name: str
    popen: subprocess.Popen[bytes]
    log: Path


class Supervisor:
    """Starts nodes and makes sure that none is left; a context manager."""

    def __init__(self, folder: Path) -> None:
        """Start nothing yet.

        Args:
            folder: Folder for what the nodes write to standard output and error.
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
        log = self._folder / f"{name}.log"
        environment = os.environ | {SUPERVISOR_VARIABLE: str(os.getpid()), "PYTHONUNBUFFERED": "1"}
        command = [sys.executable, "-m", f"sfr_loc_map.nodes.{name}", *arguments]
        try:
            with log.open("wb") as stream:
                # A session of its own: Ctrl-C at the terminal reaches this process alone, which then ends the nodes.
                popen = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    start_new_session=True,
                )
        except OSError as error:
            raise NodeError(f"cannot start {name}: {error.strerror}; check memory and process limits") from error
        self._processes.append(_Process(name, popen, log))

    def check(self) -> None:
        """Make sure that all nodes live.

        Raises:
            NodeError: If one has ended; says how and its last words.
        """
        for process in self._processes:
            code = process.popen.poll()
            if code is not None:
                how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
                raise NodeError(f"{process.name} {how}: {self.last_words(process.name)}; correct that and start again")

    def last_words(self, name: str) -> str:
        """Return the last line that a node wrote."""
        for process in self._processes:
            if process.name == name:
                lines = process.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
                return lines[-1].strip() if lines else "it said nothing"
        return "it was not started"

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
