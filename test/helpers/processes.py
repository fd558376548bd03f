"""Nodes and commands as processes: their output, their end and their resources."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from helpers import HELPERS

PATIENCE_S = 60.0


def wait_until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what} did not happen within {patience_s} s"
        time.sleep(0.02)
    return found


class Process:
    """A Python process, which can import the helpers; its output goes to a file.

    The process is killed at the end of its block if it still runs.
    """

    def __init__(self, log: Path, *command: str, environment: dict[str, str] | None = None) -> None:
        self.log = log
        with log.open("wb") as stream:
            self.popen = subprocess.Popen(
                [sys.executable, *command],
                stdout=stream,
                stderr=subprocess.STDOUT,
                env=os.environ | {"PYTHONPATH": str(HELPERS.parent)} | (environment or {}),
                start_new_session=True,
            )

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.popen.kill()
        self.popen.wait()

    @property
    def text(self) -> str:
        return self.log.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, words: str) -> None:
        wait_until(lambda: words in self.text or self.popen.poll() is not None, f"'{words}' in {self.log}")
        assert words in self.text, self.text

    def end(self, *signals: signal.Signals, pause_s: float = 0.1) -> int:
        for number in signals:
            if self.popen.poll() is None:
                self.popen.send_signal(number)
            time.sleep(pause_s)
        return self.popen.wait(PATIENCE_S)


def node_process(folder: Path, name: str, *arguments: str) -> Process:
    return Process(folder / f"{name}.log", "-m", "sfr_loc_map.nodes.start", f"nodes.{name}", *arguments)


def nodes_of(pid: int) -> list[int]:
    """Return the process ids of the suite's nodes that a process has started."""
    found = []
    for child in psutil.Process(pid).children():
        with suppress(psutil.NoSuchProcess):
            if any("sfr_loc_map.nodes." in word for word in child.cmdline()):
                found.append(child.pid)
    return found


def handles_signals(pid: int) -> bool:
    """Return whether a process handles SIGTERM, as a node does after the import of its first module."""
    (line,) = [line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigCgt:")]
    return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def segments_of(pids: list[int]) -> set[Path]:
    """Return the shared-memory segments of Fast DDS that processes have mapped, without its port files."""
    lines = [line for pid in pids for line in Path(f"/proc/{pid}/maps").read_text().splitlines()]
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/fastrtps_" in line and "_port" not in line}


def abandoned(segments: set[Path]) -> set[Path]:
    """Return the segments that still exist although no process has mapped them.

    A process may also have mapped segments of other participants in its ROS domain, such as those of a concurrent test.
    """
    mapped = set()
    for pid in psutil.pids():
        with suppress(OSError):
            mapped |= segments_of([pid])
    return {path for path in segments if path.exists()} - mapped


def has_started_ros(pid: int) -> bool:
    """Return whether ROS has started in a process, which then has a segment of Fast DDS."""
    return bool(segments_of([pid]))
