"""A command of the user as a process group of its own: started, its output kept, ended with all that it started."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from contextlib import suppress
from functools import partial
from pathlib import Path

from sfr_loc_map.child_process import end_with_parent
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.process.supervisor import ESCALATION


class CommandProcess:
    """A command, split as a shell does, but run without one; a context manager that ends it."""

    def __init__(self, command: str, folder: Path) -> None:
        """Start nothing yet.

        Args:
            command: Program and arguments.
            folder: Folder for what it writes to standard output and error.

        Raises:
            ConfigError: If it is empty or its quotes do not close.
        """
        try:
            self.words = shlex.split(command)
        except ValueError as error:
            raise ConfigError(f"'--command {command}': {error}; give a program and its arguments") from error
        if not self.words:
            raise ConfigError("'--command' is empty: give a program and its arguments")
        self._log = folder / "external.log"
        self._popen: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> CommandProcess:
        """Start it.

        Raises:
            ConfigError: If there is no such program.
        """
        try:
            with self._log.open("ab") as stream:
                self._popen = subprocess.Popen(
                    self.words,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=partial(end_with_parent, signal.SIGTERM),
                )
        except OSError as error:
            raise ConfigError(f"'--command': cannot start '{self.words[0]}': {error.strerror}") from error
        return self

    def __exit__(self, *_: object) -> None:
        """End its process group: SIGINT, SIGTERM, SIGKILL."""
        if self._popen is None:
            return
        for number, timeout_s in ESCALATION:
            with suppress(ProcessLookupError):
                os.killpg(self._popen.pid, number)
            with suppress(subprocess.TimeoutExpired):
                self._popen.wait(timeout_s)
                break
        with suppress(ProcessLookupError):  # what it started and left behind
            os.killpg(self._popen.pid, signal.SIGKILL)

    @property
    def pid(self) -> int:
        """Its process id, -1 before it was started."""
        return -1 if self._popen is None else self._popen.pid

    @property
    def ended(self) -> str:
        """How it ended, with the last line it wrote; empty while it runs."""
        code = None if self._popen is None else self._popen.poll()
        if code is None:
            return ""
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        lines = self.text.strip().splitlines()
        return f"{how}: {lines[-1].strip()[:200] if lines else 'it wrote nothing'}"

    @property
    def text(self) -> str:
        """What it has written."""
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log.exists() else ""
