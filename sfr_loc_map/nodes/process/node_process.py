"""A node as one process: started so that it does not outlive the process that started it, signalled, ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO

from sfr_loc_map.child_process import child_environment, end_with_parent
from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.process.shared_segments import remove_ownerless, segment_locks

SUPERVISOR_VARIABLE = "SFR_SUPERVISOR_PID"
"""Tells a process which process started it and must not be outlived; see `end_with_supervisor`."""


class NodeProcess:
    """A module of this package, run as a process; what it writes goes to one log, also after a restart."""

    def __init__(
        self,
        module: str,
        arguments: Sequence[str] = (),
        folder: Path | None = None,
        environment: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Start nothing yet.

        Args:
            module: Name below `sfr_loc_map`, such as `nodes.localisation_node`.
            arguments: Command line.
            folder: Folder for its log; None: it writes to standard output and error of this process.
            environment: Variables beside those of this process.
        """
        self.name = module.rpartition(".")[2]
        self._module = module
        self._arguments = tuple(arguments)
        self._environment = dict(environment)
        self._log = None if folder is None else folder / f"{self.name}.log"
        self._popen: subprocess.Popen[bytes] | None = None
        self._segment_locks: set[Path] = set()

    def start(self) -> None:
        """Start it, for the first time or again.

        Raises:
            NodeError: If the system cannot start a process.
        """
        try:
            if self._log is None:
                self._popen = self._start(None)
                return
            with self._log.open("ab") as stream:
                self._popen = self._start(stream)
        except OSError as error:
            raise NodeError(f"cannot start {self.name}: {error.strerror}; check memory and process limits") from error

    def _start(self, log: IO[bytes] | None) -> subprocess.Popen[bytes]:
        own = {SUPERVISOR_VARIABLE: str(os.getpid()), "PYTHONUNBUFFERED": "1"}
        # A session of its own: Ctrl-C at the terminal reaches this process alone, which then ends the nodes.
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "sfr_loc_map.nodes.process.start", self._module, *self._arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT if log is not None else None,
            env=child_environment() | own | self._environment,
            start_new_session=True,
        )

    @property
    def popen(self) -> subprocess.Popen[bytes]:
        """The process.

        Raises:
            NodeError: If it was not started.
        """
        if self._popen is None:
            raise NodeError(f"{self.name} was not started")
        return self._popen

    @property
    def exit_code(self) -> int | None:
        """Its exit code, the negative signal that killed it, or None while it runs (or was not started)."""
        return None if self._popen is None else self._popen.poll()

    @property
    def is_running(self) -> bool:
        """Tell whether it runs (or is stopped by SIGSTOP)."""
        return self._popen is not None and self._popen.poll() is None

    @property
    def text(self) -> str:
        """What it has written to its log."""
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log and self._log.exists() else ""

    @property
    def last_log_line(self) -> str:
        """The last line that it wrote."""
        if self._log is None:
            return "its output is above"
        lines = self.text.strip().splitlines()
        return lines[-1].strip() if lines else "it wrote nothing"

    @property
    def ending(self) -> str:
        """How it ended, in words."""
        code = self.popen.returncode
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return f"{self.name} {how}"

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.popen.send_signal(number)

    def wait(self, timeout_s: float) -> int | None:
        """Wait for its end; return its exit code, None where it still runs."""
        try:
            return self.popen.wait(max(timeout_s, 0.01))
        except subprocess.TimeoutExpired:
            return None

    def kill(self) -> None:
        """End it by SIGKILL, and wait for its end."""
        if self._popen is not None:
            self._popen.kill()
            self._popen.wait()

    def note_segments(self) -> None:
        """Note which segments of shared memory are its own; only a process that runs tells that."""
        if self.is_running:
            self._segment_locks.update(segment_locks(self.popen.pid))

    def remove_segments(self) -> None:
        """Remove those of the noted segments that it has left: it has crashed or was killed."""
        remove_ownerless(self._segment_locks)
        self._segment_locks.clear()


def end_with_supervisor() -> None:
    """Ask the kernel to end this process when the one that started it ends, however it ends (Linux).

    Does nothing for a process that no `NodeProcess` started.

    Raises:
        KeyboardInterrupt: If it has ended already.
    """
    supervisor = os.environ.pop(SUPERVISOR_VARIABLE, "")
    if not supervisor or not sys.platform.startswith("linux"):
        return
    end_with_parent(signal.SIGTERM)
    if os.getppid() != int(supervisor):
        raise KeyboardInterrupt
