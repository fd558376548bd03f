"""Runs one task in a process of its own: limits of time and memory, new tries, and the cause where it fails."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.suite.fork_server import ForkServer, ForkServerError
from sfr_loc_map.suite.host import host_share
from sfr_loc_map.suite.process_tree import resident_bytes
from sfr_loc_map.suite.task import Task
from sfr_loc_map.suite.task_process import BAD_INPUT

TRIES = 3
"""A first try, then two more in fresh processes."""
POLL_S = 0.1
MESSAGE_LENGTH = 500


INSTEAD = ""
"""A Python file that is run in place of a task: for tests."""
END_S = 15.0
"""Longest wait for a killed task and what it started to be gone."""
_of_thread = threading.local()


class Cause(StrEnum):
    """Why a try failed."""

    BAD_INPUT = "bad input"
    FAULT = "fault of the program"
    SIGNAL = "ended by a signal"
    MEMORY = "over the memory limit"
    TIME = "over the time limit"
    WORKER = "its worker was lost"
    STOPPED = "stopped by the user"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One try that failed.

    Attributes:
        cause: Why.
        message: What the process said last, or what the limit was.
        seconds: How long it ran.
        peak_bytes: Largest resident memory seen.
    """

    cause: Cause
    message: str
    seconds: float
    peak_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a task.

    Attributes:
        key: Key of the task.
        result: The score as JSON; None if it failed, or where it has been written to its place already.
        failures: Tries that failed.
        seconds: How long the last try took, None where another has run it.
        peak_bytes: Largest resident memory of the last try, None where another has run it.
        done: Whether there is a score.
    """

    key: str
    result: str | None
    failures: tuple[Attempt, ...]
    seconds: float | None
    peak_bytes: int | None
    done: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Limits of a task, and where it runs.

    Attributes:
        memory_bytes: Resident memory of the process and its children.
        timeout_s: Time of one try.
        slot: Number of the slot, -1 for none.
        again: Whether a task is run that has a result.
    """

    memory_bytes: int
    timeout_s: float
    slot: int = -1
    again: bool = False


def execute(task: Task, bounds: Bounds, cache: Path, stop: threading.Event | None = None) -> Outcome:
    """Run a task until it is done or every try has failed; bad input is tried once only.

    Args:
        task: The task.
        bounds: Its limits.
        cache: Folder in which simulated sources are kept.
        stop: Once set, the try under way is ended and none begins.
    """
    stop = stop or threading.Event()
    failures: list[Attempt] = []
    while True:
        with host_share(alone=task.alone, stop=stop), _scratch() as scratch:
            result = scratch / "result.json"
            attempt = _attempt(task, bounds, cache, result, stop)
            text = result.read_text(encoding="utf-8") if isinstance(attempt, _Usage) else None
        if isinstance(attempt, _Usage):
            usage = attempt
            break
        failures.append(attempt)
        usage = _Usage(attempt.seconds, attempt.peak_bytes)
        if attempt.cause in (Cause.BAD_INPUT, Cause.STOPPED) or len(failures) == TRIES:
            break
    return Outcome(
        key=task.key,
        result=text,
        failures=tuple(failures),
        seconds=usage.seconds,
        peak_bytes=usage.peak_bytes,
        done=text is not None,
    )


@dataclass(frozen=True, slots=True)
class _Usage:
    seconds: float
    peak_bytes: int


@contextmanager
def _scratch() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="sfr-task-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _attempt(task: Task, bounds: Bounds, cache: Path, result: Path, stop: threading.Event) -> _Usage | Attempt:
    """Run a task once; return what it used, or why it failed."""
    folder = result.parent
    task_file, log, work = folder / "task.json", folder / "log", folder / "work"
    task_file.write_text(json.dumps(to_plain(task)), encoding="utf-8")
    work.mkdir()
    cache.mkdir(parents=True, exist_ok=True)
    arguments = [str(task_file), str(result), str(cache.absolute()), str(bounds.slot)]
    begin = time.monotonic()
    try:
        fork_server = _fork_server(task.threads)
        pid = fork_server.start(arguments, work, log, INSTEAD)
        code, broken, peak = _watch(fork_server, pid, bounds, stop)
    except ForkServerError as error:
        close_fork_server()
        return Attempt(cause=Cause.FAULT, message=str(error), seconds=time.monotonic() - begin, peak_bytes=0)
    seconds = time.monotonic() - begin
    if broken is None and code == 0:
        return _Usage(seconds, peak)
    cause, message = broken or _explain(code, log)
    return Attempt(cause=cause, message=message, seconds=seconds, peak_bytes=peak)


def _fork_server(threads: int) -> ForkServer:
    """Return what starts the tasks of this thread."""
    known: dict[int, ForkServer] = _of_thread.__dict__.setdefault("fork_servers", {})
    if threads not in known:
        known[threads] = ForkServer(threads)
    return known[threads]


def close_fork_server() -> None:
    """End what starts the tasks of this thread; the next task starts it again."""
    for fork_server in _of_thread.__dict__.pop("fork_servers", {}).values():
        fork_server.close()


def _watch(
    fork_server: ForkServer, pid: int, bounds: Bounds, stop: threading.Event
) -> tuple[int, tuple[Cause, str] | None, int]:
    """Wait for the end or a broken limit; return the exit code, the limit, and the largest memory seen."""
    begin, peak = time.monotonic(), 0
    while True:
        code = fork_server.wait(POLL_S)
        if code is not None:
            return code, None, peak
        peak = max(peak, resident_bytes(pid))
        broken = _broken_limit(bounds, peak, time.monotonic() - begin, stop)
        if broken is not None:
            _kill_session(pid)
            if fork_server.wait(END_S) is None:  # its answer would be taken for that of the next task
                close_fork_server()
            return -signal.SIGKILL, broken, peak


def _broken_limit(bounds: Bounds, peak: int, seconds: float, stop: threading.Event) -> tuple[Cause, str] | None:
    if peak > bounds.memory_bytes:
        return Cause.MEMORY, f"{peak / 1e6:.0f} MB, the limit is {bounds.memory_bytes / 1e6:.0f} MB"
    if stop.is_set():
        return Cause.STOPPED, "ended before it was done"
    return (Cause.TIME, f"not done after {bounds.timeout_s:g} s") if seconds > bounds.timeout_s else None


def _kill_session(pid: int) -> None:
    """End a task and all that it started: they are of its own session."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def _explain(code: int, log: Path) -> tuple[Cause, str]:
    lines = [line for line in log.read_text("utf-8", "replace").splitlines() if line.strip()]
    last = lines[-1].strip()[-MESSAGE_LENGTH:] if lines else "it said nothing"
    if code == BAD_INPUT:
        return Cause.BAD_INPUT, last
    if code < 0:
        return Cause.SIGNAL, f"{signal.Signals(-code).name}; last line of its log: {last}"
    return Cause.FAULT, f"exit code {code}: {last}"
