"""Start, watch and end child processes: programs of this package with a ROS node, and a command of the user."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

import psutil

from sfr_loc_map.child_process import adopt_descendants, child_environment, end_with_parent, ending_of
from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.signals import END_SIGNALS, hold

ESCALATION = ((signal.SIGINT, 10.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 3.0))
"""Signals that end processes, each with the time until the next signal, s."""
START = "sfr_loc_map.nodes.start"
"""Module that runs the `main` of another module. It delivers signals that are blocked while Python starts."""
CANNOT_START = 2  #: Exit code of a node with invalid arguments or settings.
ROUTINE = ("[DEBUG]", "[INFO]")  #: Prefixes of the ROS log lines that report no problem.
WATCH_S = 0.2  #: Period of the check whether a process still runs, s.


class ChildProcess:
    """A child process in its own session, which ends when its parent process ends (Linux).

    Ctrl-C at the terminal therefore reaches only the parent process, which then ends its children.
    """

    def __init__(
        self,
        name: str,
        words: Sequence[str],
        log: Path | None = None,
        variables: Mapping[str, str] | None = None,
        *,
        adopts: bool = False,
        blocked: Sequence[signal.Signals] = (),
    ) -> None:
        """Start the process. Without a log file, its output goes to standard output and error of this process.

        With `adopts`, its orphaned descendants are adopted and remain in its process tree. The signals `blocked` are
        not delivered until the program unblocks them.
        """
        self.name, self._words = name, words
        self._log, self._variables = log, variables
        self._adopts, self._blocked = adopts, blocked
        self.start()

    def start(self) -> None:
        """Start or restart the process."""
        stream = None if self._log is None else self._log.open("ab")
        try:
            self.popen = subprocess.Popen(
                self._words,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream and subprocess.STDOUT,
                env=self._variables,
                start_new_session=True,
                preexec_fn=self._before_exec,
            )
        except OSError as error:
            raise NodeError(f"cannot start '{self.name}': {error.strerror}; check memory and process limits") from error
        finally:
            if stream is not None:
                stream.close()

    def _before_exec(self) -> None:
        end_with_parent(signal.SIGTERM, self._blocked)
        if self._adopts:
            adopt_descendants()

    @property
    def is_running(self) -> bool:
        """Return whether the process runs (or is stopped by SIGSTOP)."""
        return self.popen.poll() is None

    @property
    def text(self) -> str:
        """Content of the log."""
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log and self._log.exists() else ""

    @property
    def last_log_line(self) -> str:
        """Last line of the log that is not a routine message (`ROUTINE`), for messages."""
        if self._log is None:
            return "its output is above"
        lines = [line.strip() for line in self.text.splitlines() if not line.startswith(ROUTINE)]
        return next((line[:1000] for line in reversed(lines) if line), "its log has no error")

    @property
    def ending(self) -> str:
        """How the process ended, in words; empty while the process runs."""
        code = self.popen.poll()
        return "" if code is None else ending_of(code)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process and its children in the same session."""
        with suppress(ProcessLookupError):
            os.killpg(self.popen.pid, number)


def node_process(module: str, arguments: Sequence[str], folder: Path | None = None) -> ChildProcess:
    """Start a module of `sfr_loc_map` as a process; its log goes to the folder, if given."""
    name = module.rpartition(".")[2]
    words = [sys.executable, "-P", "-m", START, module, *arguments]
    log = None if folder is None else folder / f"{name}.log"
    return ChildProcess(name, words, log, child_environment() | {"PYTHONUNBUFFERED": "1"}, blocked=END_SIGNALS)


@contextmanager
def user_command(command: str, folder: Path) -> Iterator[ChildProcess]:
    """Run a command of the user during the `with` block; its words are split as in a shell, but no shell is used."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f"'--command {command}': {error}; give a program and its arguments") from error
    if not words:
        raise ConfigError("'--command' is empty: give a program and its arguments")
    try:
        process = ChildProcess(os.path.basename(words[0]), words, folder / "external.log", adopts=True)
    except NodeError as error:
        raise ConfigError(f"'--command': {str(error).partition(';')[0]}") from error
    try:
        yield process
    finally:
        started = descendants(process.popen.pid)
        end_processes([process])
        process.send(signal.SIGKILL)  # children that the process has not ended
        for each in started:  # descendants in other sessions
            with suppress(psutil.Error):
                each.kill()


def descendants(pid: int) -> list[psutil.Process]:
    """Return the descendants of a running process; empty if the process has ended."""
    with suppress(psutil.Error):
        return psutil.Process(pid).children(recursive=True)
    return []


class Supervisor(AbstractContextManager["Supervisor"]):
    """Starts nodes and ends all of them at exit; a context manager."""

    def __init__(self, folder: Path | None = None) -> None:
        """Set the folder of the logs; without a folder, nodes write to standard output and error of this process."""
        self._folder = folder
        self.processes: dict[str, ChildProcess] = {}

    def __exit__(self, *_: object) -> None:
        end_processes(list(self.processes.values()))

    def start(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Start a node of this package, such as `localisation_node`, with command-line arguments."""
        self.processes[name] = node_process(f"nodes.{name}", arguments, self._folder)

    def check(self) -> None:
        """Raise a NodeError if a node has ended."""
        for process in self.processes.values():
            if ending := process.ending:
                raise NodeError(f"{process.name} {ending}: {process.last_log_line}; correct the cause and start again")

    def restart_crashed(self) -> list[str]:
        """Restart the nodes that have crashed; return how each of them ended."""
        endings = []
        for process in self.processes.values():
            if process.popen.poll() in (0, CANNOT_START):
                self.check()
            if ending := process.ending:
                endings.append(f"{process.name} {ending}")
                process.start()
        return endings


def end_processes(processes: Sequence[ChildProcess]) -> None:
    """End processes together by SIGINT, then SIGTERM, then SIGKILL; return when all have ended.

    Further signals to this process are ignored from now on, so that they cannot interrupt the shutdown.
    """
    hold()
    for number, timeout_s in ESCALATION:
        running = [process for process in processes if process.is_running]
        for process in running:
            process.send(number)
        deadline = time.monotonic() + timeout_s
        for process in running:
            with suppress(subprocess.TimeoutExpired):
                process.popen.wait(max(deadline - time.monotonic(), 0.01))
