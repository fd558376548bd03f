"""Starts processes of tasks through a process that has imported what they need."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from sfr_loc_map.child_process import child_environment

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
END_S = 5.0


class ForkServerError(Exception):
    """The process that forks has ended; the message has its last line."""


class ForkServer:
    """One process that forks tasks, one at a time."""

    def __init__(self, threads: int) -> None:
        """Start it.

        Args:
            threads: Threads that the libraries of a task may use.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "sfr_loc_map.suite.fork_server_process"],
            env=child_environment() | dict.fromkeys(ONE_THREAD, str(threads)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._process.stdout, selectors.EVENT_READ)
        self._rest = b""

    def start(self, arguments: list[str], work: Path, log: Path, instead: str = "") -> int:
        """Fork a task; return its process number.

        Args:
            arguments: As of `task_process.main`.
            work: Its current directory.
            log: File of its output.
            instead: A Python file that is run in place of the task, empty for none.

        Raises:
            ForkServerError: If this process has ended.
        """
        order = {"arguments": arguments, "work": str(work), "log": str(log), "instead": instead}
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
        except OSError:
            self._fail()
        answer = self._answer(None)
        assert answer is not None
        return int(answer["pid"])

    def wait(self, seconds: float) -> int | None:
        """Return the exit code of the task, negative for a signal; None if it still runs after a time.

        Raises:
            ForkServerError: If this process has ended.
        """
        answer = self._answer(seconds)
        return None if answer is None else int(answer["code"])

    def _answer(self, seconds: float | None) -> dict[str, Any] | None:
        assert self._process.stdout is not None
        while b"\n" not in self._rest:
            if not self._selector.select(seconds):
                return None
            data = os.read(self._process.stdout.fileno(), 4096)
            if not data:
                self._fail()
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _fail(self) -> None:
        assert self._process.stderr is not None
        self._process.wait()
        lines = self._process.stderr.read().decode("utf-8", "replace").split("\n")
        raise ForkServerError(next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing"))

    def close(self) -> None:
        """End the process."""
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()
        self._selector.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
