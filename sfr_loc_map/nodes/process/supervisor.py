"""Several nodes as processes that one other process starts, watches and ends."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.node_process import NodeProcess

TASKS = ("localisation", "mapping", "monitor")
EVERYTHING = "all"
ESCALATION = ((signal.SIGINT, 5.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
"""Signals that end processes, and how many seconds each gets."""
CANNOT_START = 2
"""Exit code of a node that cannot work with its arguments and settings."""
WATCH_S = 0.2
RESTART_PAUSE_S = 1.0
"""Pause after a restart, so that a node that crashes at once does not occupy the host."""


class Supervisor:
    """Starts nodes and makes sure that none is left; a context manager."""

    def __init__(self, folder: Path | None = None) -> None:
        """Start nothing yet.

        Args:
            folder: Folder for what the nodes write to standard output and error; None: they write to those of this
                process.
        """
        self._folder = folder
        self.processes: dict[str, NodeProcess] = {}

    def __enter__(self) -> Supervisor:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all nodes."""
        end_processes(list(self.processes.values()))

    def start(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Start a node of this package.

        Args:
            name: Name of the module and of the node, such as `localisation_node`.
            arguments: Its command line.

        Raises:
            NodeError: If the system cannot start a process.
        """
        process = NodeProcess(f"nodes.{name}", arguments, self._folder)
        process.start()
        self.processes[name] = process

    def check(self) -> None:
        """Make sure that all nodes run.

        Raises:
            NodeError: If one has ended; says how, with its last log line.
        """
        for process in self.processes.values():
            if process.exit_code is not None:
                raise NodeError(f"{process.ending}: {process.last_log_line}; correct that and start again")

    def note_segments(self) -> None:
        """Note the shared memory of all nodes, so that it can be removed if they crash."""
        for process in self.processes.values():
            process.note_segments()

    def restart_crashed(self) -> list[str]:
        """Start the nodes again that have crashed.

        Returns:
            How each of them ended.

        Raises:
            NodeError: If one ended by itself (exit code 0), or because it cannot work with its arguments.
        """
        endings = []
        for process in self.processes.values():
            if process.exit_code in (0, CANNOT_START):
                self.check()
            if process.exit_code is not None:
                endings.append(process.ending)
                process.remove_segments()
                process.start()
        return endings


def end_processes(processes: Sequence[NodeProcess]) -> None:
    """End processes together: SIGINT, then SIGTERM, then SIGKILL; returns when none is left.

    What a process that crashed or was killed has left in shared memory is removed for it.
    """
    for number, timeout_s in ESCALATION:
        running = [process for process in processes if process.is_running]
        for process in running:
            process.note_segments()
            process.send(number)
        deadline = time.monotonic() + timeout_s
        for process in running:
            process.wait(deadline - time.monotonic())
    for process in processes:
        process.remove_segments()


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


@contextmanager
def first_signal_stops(stop: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Let the first SIGINT or SIGTERM call `stop`, so that a run ends in good order; the next one does as before.

    Args:
        stop: What ends the run.

    Yields:
        What tells whether there was a signal.
    """
    before: dict[int, Any] = {}
    received = []

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def handle(number: int, frame: FrameType | None) -> None:
        received.append(number)
        restore()
        stop()

    before.update({number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)})
    try:
        yield lambda: bool(received)
    finally:
        if not received:  # otherwise that is done, and the next signal may have changed what follows it
            restore()


def node_names(tasks: Sequence[str]) -> list[str]:
    """Return the names of the nodes of tasks, each once.

    Args:
        tasks: Of `TASKS`, or `all`; none stands for all.

    Raises:
        ConfigError: For another word.
    """
    for task in tasks:
        if task not in (*TASKS, EVERYTHING):
            raise ConfigError(
                f"'{task}' is not a node: give {EVERYTHING}, {', '.join(TASKS)}; for ROS after --ros-args"
            )
    everything = not tasks or EVERYTHING in tasks
    return [f"{task}_node" for task in TASKS if everything or task in tasks]


def run_nodes(nodes: Sequence[str], arguments: Sequence[str], say: Callable[[str], None], *, respawn: bool) -> None:
    """Run nodes, one process each, until SIGINT or SIGTERM; they write to standard output and error.

    Args:
        nodes: Their names.
        arguments: Command line of each.
        say: Called with a line for each restart.
        respawn: Start a node again that crashes, rather than end the others.

    Raises:
        NodeError: If a node ends; the others have been ended then.
    """
    environment.prepare()
    try:
        with sigterm_as_interrupt(), Supervisor() as supervisor:
            for node in nodes:
                supervisor.start(node, arguments)
            while True:
                time.sleep(WATCH_S)
                supervisor.note_segments()
                if not respawn:
                    supervisor.check()
                    continue
                for ending in supervisor.restart_crashed():
                    say(f"{ending}: started again")
                    time.sleep(RESTART_PAUSE_S)
    except KeyboardInterrupt:
        return
