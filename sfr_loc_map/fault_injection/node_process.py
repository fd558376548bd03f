"""A node as a process that is killed, stopped and started again."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import psutil

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.process.supervisor import start_process

MB = 1_000_000


class NodeProcess:
    """A module of this package, run as a process; what it writes goes to a file, also after it was started again."""

    def __init__(self, module: str, arguments: Sequence[str], folder: Path, environment: Mapping[str, str]) -> None:
        """Start nothing yet.

        Args:
            module: Name below `sfr_loc_map`, such as `nodes.localisation_node`.
            arguments: Command line.
            folder: Folder for its log.
            environment: Variables beside those of this process.
        """
        self.name = module.rpartition(".")[2]
        self._module = module
        self._arguments = tuple(arguments)
        self._environment = dict(environment)
        self._log = folder / f"{module.replace('.', '_')}.log"
        self._popen: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, again or for the first time."""
        with self._log.open("ab") as stream:
            self._popen = start_process(self._module, self._arguments, stream, self._environment)

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
    def lives(self) -> bool:
        """Tell whether it runs (or is stopped)."""
        return self._popen is not None and self._popen.poll() is None

    @property
    def resident_bytes(self) -> int:
        """Its resident memory; 0 where it does not run."""
        return int(psutil.Process(self.popen.pid).memory_info().rss) if self.lives else 0

    @property
    def processor_s(self) -> float:
        """Processor time that it has used, its own and the system's for it, seconds."""
        times = psutil.Process(self.popen.pid).cpu_times()
        return float(times.user + times.system)

    @property
    def text(self) -> str:
        """What it has written."""
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log.exists() else ""

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.popen.send_signal(number)

    def kill(self) -> None:
        """End it without a chance to tidy up (SIGKILL), and wait for its end."""
        if self._popen is not None:
            self._popen.kill()
            self._popen.wait()

    def end(self, patience_s: float = 10.0) -> int | None:
        """Ask it to end (SIGINT); return its exit code, None where it had to be killed."""
        if not self.lives:
            return self._popen.returncode if self._popen is not None else None
        self.send(signal.SIGINT)
        try:
            return self.popen.wait(patience_s)
        except subprocess.TimeoutExpired:
            self.kill()
            return None
