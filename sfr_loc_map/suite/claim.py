"""One at a time runs a task of a suite's folder, whichever client has asked for it.

A client that is killed leaves tasks running on workers. The next client asks for them again: who comes second waits for
the first and finds the result. The claim is a lock on `running/KEY`, which ends with its process; the result is written
into that file, and takes its place in `results/` whole.
"""

from __future__ import annotations

import fcntl
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.errors import OutputError
from sfr_loc_map.suite.execution import Attempt, Bounds, Cause, Outcome, execute
from sfr_loc_map.suite.task import Task

RUNNING = "running"
RESULTS = "results"
ASK_AGAIN_S = 0.1


def execute_once(task: Task, bounds: Bounds, folder: Path, cache: Path, stop: threading.Event | None = None) -> Outcome:
    """Run a task and write its result, unless another has done so; the outcome is without the result's text.

    Args:
        task: The task.
        bounds: Its limits; `again` runs what is done.
        folder: Folder of the suite.
        cache: Folder of fetched and simulated sources.
        stop: Ends the run, and the wait for another.

    Raises:
        OutputError: If the result cannot be written.
    """
    stop = stop or threading.Event()
    with _claimed(folder, task.key, stop) as claim:
        if claim is None:
            return _stopped(task.key)
        if result_path(folder, task.key).is_file() and not bounds.again:
            return Outcome(key=task.key, result=None, failures=(), seconds=None, peak_bytes=None, done=True)
        outcome = execute(task, bounds, cache, stop)
        if outcome.result is not None:
            claim.write_text(outcome.result, encoding="utf-8")
            os.replace(claim, result_path(folder, task.key))
    return replace(outcome, result=None)


def write_result(folder: Path, key: str, text: str) -> None:
    """Write the score of a task, whole or not at all.

    Raises:
        OutputError: If it cannot be written.
    """
    with _claimed(folder, key, threading.Event()) as claim:
        assert claim is not None
        claim.write_text(text, encoding="utf-8")
        os.replace(claim, result_path(folder, key))


def result_path(folder: Path, key: str) -> Path:
    """Return where the score of a task stands."""
    return folder / RESULTS / f"{key}.json"


def _stopped(key: str) -> Outcome:
    attempt = Attempt(cause=Cause.STOPPED, message="ended before it began", seconds=0.0, peak_bytes=0)
    return Outcome(key=key, result=None, failures=(attempt,), seconds=None, peak_bytes=None, done=False)


@contextmanager
def _claimed(folder: Path, key: str, stop: threading.Event) -> Iterator[Path | None]:
    """Yield a file that nobody else has, beside the results; None where it was stopped before that."""
    path = folder / RUNNING / key
    try:
        lock = _locked(path, stop)
        if lock is None:
            yield None
            return
        try:
            yield path
        finally:
            with suppress(FileNotFoundError):  # it has become the result
                path.unlink()
            os.close(lock)
    except OSError as error:
        raise OutputError(f"cannot write into '{folder}': {error.strerror}; check the rights and the space") from error


def _locked(path: Path, stop: threading.Event) -> int | None:
    """Return the lock of a file, None once it is stopped; where the file system has no locks, nobody is waited for."""
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            if stop.wait(ASK_AGAIN_S):
                return None
            continue
        except OSError:
            return lock
        with suppress(FileNotFoundError):
            if os.stat(path).st_ino == os.fstat(lock).st_ino:
                return lock
        os.close(lock)  # it became a result, or was removed, before it was locked
