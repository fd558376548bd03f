"""Runs jobs on Dask: on worker processes of this machine, or on a cluster that is running.

Dask starts the processes, ends one that needs too much memory, starts another in its place, and runs again what was
lost with it. Here is only what Dask does not know: the time limit of a job, and why a job failed.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import InputError, MissingExtraError, SfrError
from sfr_loc_map.inputs import one_line, refusing
from sfr_loc_map.signals import deferred_signals
from sfr_loc_map.suite.digests import JOINED, code_facts, code_fingerprint, proof_plugin
from sfr_loc_map.suite.job import Job
from sfr_loc_map.suite.specification import SuiteSettings

if TYPE_CHECKING:
    from distributed import Client, Future

TRIES = 3
STARTED, OVER_TIME, OVER_MEMORY = "sfr-started", "sfr-over-time", "worker-restart-memory"
"""Topics of events: the first two are ours, the last is that of Dask's nanny."""
ASK_EVERY_S = 1.0  #: How often the scheduler is asked for its workers.
SAY_AFTER_S = 2.0  #: Time without a worker after which it is said.
SHOWN = 10  #: Workers of which it is said what they lack.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class FailureCause(StrEnum):
    """Why a job failed."""

    BAD_INPUT = "bad input"
    FAULT = "fault of the program"
    DIED = "its process ended"
    MEMORY = "over the memory limit"
    TIME = "over the time limit"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """What came of a job."""

    result: str | None = None  #: The score as JSON; None if it failed.
    cause: FailureCause | None = None  #: Why it failed.
    message: str = ""  #: The error, or the limit.
    worker: str = ""  #: Address of the worker that ran it.


@contextlib.contextmanager
def connected(settings: SuiteSettings, *, workers: int, scheduler: str | None) -> Iterator[Client]:
    """Yield a client of workers that are started here, or of the running scheduler at an address."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise MissingExtraError(f"suites run on Dask ({error}): pip install 'sfr_loc_map[suite]'") from error
    for name in ("distributed", "distributed.client"):  # what is lost is told in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    options: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": 0,  # a job that only waited on a worker would be blamed as well
        **{f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")},
        "distributed.worker.memory.terminate": 1.0,
        # a worker may just be restarting when Dask looks for it; without any for long, jobs fail
        "distributed.deploy.lost-worker-timeout": "1000 days",
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": ["sfr_loc_map.suite.worker_start"],
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREADS, settings.threads),
        # not before the spawn, where it is set in this process too: numba reads it again and refuses a change
        "distributed.nanny.environ": {"NUMBA_NUM_THREADS": settings.threads},
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(options))
        if scheduler is not None:
            with refusing(f"no Dask scheduler answers at '{scheduler}'", "start one"):
                client = Client(scheduler, timeout="10s", set_as_default=False)
            stack.callback(client.close, timeout=2)
        else:
            with deferred_signals():  # of a whole group they would end workers that start
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    memory_limit=settings.memory_mb * 10**6,
                    host="127.0.0.1",
                    dashboard_address=None,
                    local_directory=stack.enter_context(tempfile.TemporaryDirectory(prefix="sfr-suite-")),
                    silence_logs=logging.CRITICAL,
                )
                stack.callback(_end, cluster)
            client = stack.enter_context(Client(cluster, set_as_default=False))
        yield client


def _end(cluster: Any) -> None:  # noqa: ANN401 - distributed is typed in part
    """End the workers at once; a polite close waits for what they still run."""
    for nanny in cluster.workers.values():
        with contextlib.suppress(Exception):
            nanny.auto_restart = False
            os.kill(nanny.process.pid, signal.SIGKILL)
    with contextlib.suppress(Exception):
        cluster.close(timeout=5)


@dataclass(slots=True, kw_only=True)
class WorkerRecord:
    """A worker of a suite: what it has, what it did, and why it got no task."""

    worker: str  #: Its address.
    host: str = ""
    version: str = ""  #: Of sfr_loc_map.
    python: str = ""
    code: str = ""  #: Fingerprint of its code.
    data_checked: int | None = None  #: Always None: the client hashes the data, workers do not.
    done: int = 0  #: Tasks.
    set_aside: str = ""  #: How its code differs, so that it gets no task; empty if it may run tasks.


class Crew:
    """The workers of a scheduler: those that have the code of the client, and the others."""

    def __init__(self, client: Client, say: Callable[[str], None], wait_s: float) -> None:
        self.client, self.say, self.wait_s = client, say, wait_s
        self.resource = f"sfr-{code_fingerprint()}"  # that workers with this code offer
        self.records: dict[str, WorkerRecord] = {}
        self._alone_since: float | None = time.monotonic()
        self._said, self._asked, self._places = "", -ASK_EVERY_S, 0
        self._read = len(client.get_events(JOINED))  # those of runs before
        with contextlib.suppress(Exception):  # one that cannot even read it offers nothing
            client.register_plugin(proof_plugin(self.resource, code_facts()))

    def places(self) -> int:
        """Return how many jobs run at a time on the workers that there are now; say if there is none.

        InputError if there was none for the time that one waits for them.
        """
        now = time.monotonic()
        if self._places and now - self._asked < ASK_EVERY_S:
            return self._places
        self._asked = now
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        events = self.client.get_events(JOINED)
        for _, event in events[self._read :]:
            if event["resource"] == self.resource:
                record = self._record(event["worker"])
                record.set_aside = event["lacks"]
                for name in ("host", "version", "python", "code"):
                    setattr(record, name, event.get(name, ""))
        self._read = len(events)
        fit = [worker for worker in workers.values() if worker["resources"].get(self.resource, 0) > 0]
        self._places = sum(int(worker["nthreads"]) for worker in fit)
        if self._places:
            self._alone_since, self._said = None, ""
            return self._places
        self._alone_since = self._alone_since or now
        waited, what = now - self._alone_since, self._lacks(list(workers))
        if waited > self.wait_s:
            raise InputError(f"{what}: none came in {self.wait_s:g} s; what was done is kept, the same command goes on")
        if waited > SAY_AFTER_S and what != self._said:
            self._said = what
            self.say(f"{what}: waiting {self.wait_s:g} s for one that may run a task")
        return 0

    def _record(self, worker: str) -> WorkerRecord:
        return self.records.setdefault(worker, WorkerRecord(worker=worker))

    def _lacks(self, workers: Sequence[str]) -> str:
        if not workers:
            return f"no worker at the scheduler {self.client.scheduler_info()['address']}"
        unknown = WorkerRecord(worker="", set_aside="has told nothing of its code")
        known = [self.records.get(worker, unknown) for worker in workers]
        lacks = [f"{at.host} ({worker}): {at.set_aside}" for worker, at in zip(workers, known, strict=True)]
        more = f"; and {len(lacks) - SHOWN} more" if len(lacks) > SHOWN else ""
        return f"none of {len(lacks)} workers may run a task: {'; '.join(lacks[:SHOWN])}{more}"

    def count(self, outcome: JobOutcome) -> None:
        """Count what a worker did."""
        self._record(outcome.worker).done += outcome.cause is None


def run_jobs(
    client: Client, jobs: Sequence[Job], timeout_s: float, cache: Path, crew: Crew
) -> Generator[tuple[Job, JobOutcome]]:
    """Yield each job with what came of it, as it is done.

    Twice as many are handed out as run at a time, so that no worker waits for the next one. Workers that do not see the
    cache of simulated sources use one of their own.
    """
    from distributed.scheduler import KilledWorker

    waiting = deque(jobs)
    handed_out: dict[Future[JobOutcome], Job] = {}
    done: SimpleQueue[Future[JobOutcome]] = SimpleQueue()
    tries: Counter[str] = Counter()
    ended: set[str] = set()
    try:
        while waiting or handed_out:
            places = crew.places()
            while waiting and len(handed_out) < 2 * places:
                job = waiting.popleft()
                future = client.submit(
                    run_on_worker,
                    *(job, timeout_s, str(cache.absolute())),
                    key=(f"sfr-{job.kind}", job.key, time.time_ns()),
                    resources={crew.resource: 1},
                    retries=TRIES - 1,
                    pure=False,
                )
                handed_out[future] = job
                future.add_done_callback(done.put)
            try:
                future = done.get(timeout=ASK_EVERY_S)
            except Empty:
                continue
            job = handed_out.pop(future)
            outcome, error = _result_of(future)
            if isinstance(error, KilledWorker):
                worker = error.last_worker.address
                started = [event["key"] for _, event in client.get_events(STARTED) if event["worker"] == worker]
                # one of its jobs is to blame: that which ran, not those that only waited there
                others = {other.key for other in handed_out.values()}
                if worker not in ended and (not started or started[-1] not in others):
                    ended.add(worker)
                    tries[job.key] += error.allowed_failures + 1
                if tries[job.key] < TRIES:
                    waiting.appendleft(job)
                    continue
                outcome = _cause_of_death(client, worker)
            elif error is not None:
                message = one_line(f"{type(error).__name__}: {error}")
                outcome = JobOutcome(cause=FailureCause.FAULT, message=message)
            if outcome.worker:
                crew.count(outcome)
            yield job, outcome
            future.release()
    except OSError as error:
        raise InputError(
            f"the Dask scheduler is gone ({type(error).__name__}): what was done is kept; start it and give the same "
            "command again"
        ) from error
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(handed_out), force=True)


def _result_of(future: Future[JobOutcome]) -> tuple[JobOutcome, BaseException | None]:
    """Return the outcome of a job that ended, and the error that it ended with, None if it has an outcome."""
    from distributed.scheduler import KilledWorker

    if future.status == "error":
        return JobOutcome(), future.exception()
    if future.status != "finished":  # the scheduler has forgotten it
        raise ConnectionError(future.status)
    try:
        return future.result(), None
    except KilledWorker as error:  # the worker was killed before its result was fetched
        return JobOutcome(), error


def _cause_of_death(client: Client, address: str) -> JobOutcome:
    cause, message = FailureCause.DIED, "its worker process was killed or crashed"
    for _, event in client.get_events(OVER_MEMORY):
        if event["worker"] == address:
            cause, message = FailureCause.MEMORY, f"{event['rss'] / 1e6:.0f} MB, more than its worker may use"
    for _, event in client.get_events(OVER_TIME):
        if event["worker"] == address:
            cause, message = FailureCause.TIME, f"not done after {event['seconds']:g} s"
    return JobOutcome(cause=cause, message=message)


def run_on_worker(job: Job, timeout_s: float, cache: str) -> JobOutcome:
    """Run a job; bad input is an outcome.

    Beyond the time limit the process ends itself: a thread cannot be ended.
    """
    from distributed import get_worker
    from distributed.utils import sync

    from sfr_loc_map.metrics.score_json import to_json
    from sfr_loc_map.suite.job_run import run_job

    worker = get_worker()
    started = {"worker": worker.address, "key": job.key}
    sync(worker.loop, worker.scheduler.log_event, topic=STARTED, msg=started)  # known before it can end the process
    place = Path(cache) if Path(cache).is_dir() else Path(worker.local_directory) / "sfr-cache"

    def end() -> None:
        worker.log_event(OVER_TIME, {"worker": worker.address, "seconds": timeout_s})
        time.sleep(0.5)  # until the event is sent
        os._exit(1)

    timer = threading.Timer(timeout_s, end)
    timer.daemon = True
    timer.start()
    try:
        with tempfile.TemporaryDirectory(dir=worker.local_directory) as scratch:
            return JobOutcome(worker=worker.address, result=to_json(run_job(job, Path(scratch), place)))
    except SfrError as error:
        return JobOutcome(worker=worker.address, cause=FailureCause.BAD_INPUT, message=one_line(str(error)))
    finally:
        timer.cancel()
