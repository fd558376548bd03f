"""Runs the tasks of a suite on a Dask cluster (extra `[suite]`).

A worker starts each task as a process of its own, so that what numba and OpenCV keep, leaks and crashes stay there. A
worker that sees the folder of the suite writes the result into it; else the result travels through the scheduler.
Only so many tasks are handed out at a time as keep the workers busy: the scheduler's memory does not grow with the
suite.
"""

from __future__ import annotations

import contextlib
import logging
import secrets
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.metrics.score_json import from_plain, to_plain
from sfr_loc_map.suite.claim import execute_once
from sfr_loc_map.suite.execution import MESSAGE_LENGTH, TRIES, Attempt, Bounds, Cause, Outcome, execute
from sfr_loc_map.suite.runner import OnOutcome
from sfr_loc_map.suite.store import CACHE, Store
from sfr_loc_map.suite.task import Task

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = "10s"
ASK_AGAIN_S = 5.0
AHEAD = 2
"""Tasks handed out for each place of a worker: while one runs, the next is there."""
TOKEN = ".token"
QUIET = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "30s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Of the client: as `config/dask.yaml` for the others."""


class LostError(Exception):
    """The scheduler has forgotten a task."""


LOST = (OSError, LostError, StopIteration)
"""What is raised once a scheduler is gone."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a worker may write results.

    Attributes:
        folder: Folder of the suite, as the client sees it.
        token: Content of a file in it; who reads the same there sees the same folder.
    """

    folder: str
    token: str

    def visible(self) -> bool:
        """Tell whether this process sees the folder."""
        try:
            return (Path(self.folder) / TOKEN).read_text(encoding="utf-8") == self.token
        except OSError:
            return False


def run_on_worker(task: dict[str, Any], bounds: Bounds, place: Place) -> Outcome:
    """Run a task in a process of its own; called on a worker.

    Args:
        task: The task as JSON values.
        bounds: Its limits.
        place: Where the result may be written.
    """
    wanted = from_plain(Task, task)
    if not place.visible():
        return execute(wanted, bounds, _worker_cache())
    folder = Path(place.folder)
    return execute_once(wanted, bounds, folder, folder / CACHE)


def _worker_cache() -> Path:
    from distributed import get_worker

    return Path(get_worker().local_directory) / "sfr-cache"


class DaskExecutor:
    """Runs tasks on a running cluster."""

    def __init__(self, address: str) -> None:
        """Connect to a scheduler.

        Raises:
            MissingExtraError: If Dask is not installed.
            InputError: If nobody answers at the address.
        """
        try:
            import dask
            from distributed import Client
        except ImportError as error:
            raise MissingExtraError(
                f"'--scheduler' needs Dask ({error}): pip install 'sfr_loc_map[suite]', or use --workers"
            ) from error
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a lost scheduler is told in one line
        dask.config.set(QUIET)
        self._address = address
        self._places, self._asked_s = 1, float("-inf")
        try:
            self._client: Client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler answers at '{address}' ({error}): start one") from error

    @property
    def places(self) -> int:
        """Tasks that run at a time; at least 1. The scheduler is asked now and then: with many workers that costs."""
        now = time.monotonic()
        if now - self._asked_s > ASK_AGAIN_S:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            self._places, self._asked_s = max(1, sum(int(worker["nthreads"]) for worker in workers)), now
        return self._places

    def run(self, tasks: Sequence[Task], bounds: Bounds, store: Store, on_outcome: OnOutcome) -> None:
        """Run tasks.

        Raises:
            InputError: If the scheduler is lost; what is done is kept.
        """
        place = Place(str(store.folder.absolute()), secrets.token_hex(16))
        (store.folder / TOKEN).write_text(place.token, encoding="utf-8")
        flow = _Flow(self._client, bounds, place, self._allowed(tasks))
        waiting = iter(tasks)
        try:
            flow.fill(waiting, self.places)
            while flow.busy:
                task, outcome = flow.next()
                if outcome is not None:
                    on_outcome(task, outcome)
                flow.fill(waiting, self.places)
        except LOST as error:
            raise InputError(
                f"the Dask scheduler at '{self._address}' is gone ({type(error).__name__}): what was done is "
                "kept; start it and give the same command again"
            ) from error
        finally:
            flow.cancel()
            with contextlib.suppress(Exception):
                self._client.close(timeout=2)

    def _allowed(self, tasks: Sequence[Task]) -> list[str] | None:
        """Return the workers to use: one a host where tasks are timed, None for all."""
        if not any(task.alone for task in tasks):
            return None
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        return list({worker["host"]: address for address, worker in workers.items()}.values())


class _Flow:
    """The tasks that the cluster has at a time."""

    def __init__(self, client: Client, bounds: Bounds, place: Place, workers: list[str] | None) -> None:
        from distributed import as_completed

        self._client, self._bounds, self._place, self._workers = client, bounds, place, workers
        self._results = as_completed(loop=self._client.loop, raise_errors=False)
        self._tasks: dict[str, Task] = {}
        self._lost: dict[str, list[Attempt]] = {}

    @property
    def busy(self) -> bool:
        """Whether the cluster has tasks."""
        return bool(self._tasks)

    def fill(self, waiting: Iterator[Task], places: int) -> None:
        """Hand out tasks until each place has one and the next."""
        limit = len(self._workers) if self._workers is not None else AHEAD * places
        while len(self._tasks) < limit and (task := next(waiting, None)) is not None:
            self._submit(task)

    def next(self) -> tuple[Task, Outcome | None]:
        """Wait for a task; return it with what came of it, None where it was handed out again.

        Raises:
            LostError: If the scheduler has forgotten it.
        """
        future = next(self._results)
        task = self._tasks.pop(str(future.key))
        if future.status == "finished":
            outcome: Outcome = future.result()
            lost = tuple(self._lost.pop(task.key, ()))
            return task, replace(outcome, failures=lost + outcome.failures)
        if future.status != "error":
            raise LostError(future.status)
        error = future.exception()
        attempts = self._lost.setdefault(task.key, [])
        message = " ".join(f"{type(error).__name__}: {error}".split())[:MESSAGE_LENGTH]
        attempts.append(Attempt(cause=Cause.WORKER, message=message, seconds=0.0, peak_bytes=0))
        if len(attempts) < TRIES:
            self._submit(task)
            return task, None
        failures = tuple(self._lost.pop(task.key))
        return task, Outcome(key=task.key, result=None, failures=failures, seconds=None, peak_bytes=None, done=False)

    def cancel(self) -> None:
        """Take back what is not done."""
        with contextlib.suppress(Exception):
            self._client.cancel(list(self._results.futures), force=True)

    def _submit(self, task: Task) -> None:
        key = f"sfr-{task.key}-{len(self._lost.get(task.key, ()))}-{secrets.token_hex(4)}"
        future = self._client.submit(
            run_on_worker,
            to_plain(task),
            self._bounds,
            self._place,
            key=key,
            pure=False,
            workers=self._workers,
            allow_other_workers=self._workers
            is not None,  # once these are lost; no host runs two timed tasks at a time
        )
        self._tasks[key] = task
        self._results.add(future)
