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
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import InputError, MissingExtraError, SfrError
from sfr_loc_map.suite.job import Job
from sfr_loc_map.suite.specification import SuiteSettings

if TYPE_CHECKING:
    from distributed import Client, Future

TRIES = 3
MESSAGE_LENGTH = 500
STARTED, OVER_TIME, OVER_MEMORY = "sfr-started", "sfr-over-time", "worker-restart-memory"
"""Topics of events: the first two are ours, the last is that of Dask's nanny."""
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
        "distributed.scheduler.no-workers-timeout": "5 minutes",
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": ["sfr_loc_map.suite.worker_start"],
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREADS, settings.threads),
        # not before the spawn, where it is set in this process too: numba reads it again and refuses a change
        "distributed.nanny.environ": {"NUMBA_NUM_THREADS": settings.threads},
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(options))
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="10s", set_as_default=False)
            except (OSError, ValueError) as error:
                raise InputError(f"no Dask scheduler answers at '{scheduler}' ({error}): start one") from error
            stack.callback(client.close, timeout=2)
        else:
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


def run_jobs(client: Client, jobs: Sequence[Job], timeout_s: float, cache: Path) -> Generator[tuple[Job, JobOutcome]]:
    """Yield each job with what came of it, as it is done.

    As many are handed out as run at a time; on a running cluster, which may grow with them, twice as many. Workers that
    do not see the cache of simulated sources use one of their own.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    waiting, running = deque(jobs), as_completed(loop=client.loop, raise_errors=False)
    handed_out: dict[Future[JobOutcome], Job] = {}
    tries: Counter[str] = Counter()
    try:
        while waiting or handed_out:
            while waiting and len(handed_out) < _places(client):
                job = waiting.popleft()
                key = (f"sfr-{job.kind}", job.key, time.time_ns())
                arguments = (job, timeout_s, str(cache.absolute()))
                future = client.submit(run_on_worker, *arguments, key=key, pure=False, retries=TRIES - 1)
                handed_out[future] = job
                running.add(future)
            future = next(running)
            job = handed_out.pop(future)
            error = future.exception() if future.status == "error" else None
            if isinstance(error, KilledWorker):
                worker = error.last_worker.address
                started = [event["key"] for _, event in client.get_events(STARTED) if event["worker"] == worker]
                # a job that only waited there while one of the others ran is not to blame
                if not started or started[-1] not in {other.key for other in handed_out.values()}:
                    tries[job.key] += error.allowed_failures + 1
                if tries[job.key] < TRIES:
                    waiting.appendleft(job)
                    continue
                outcome = _cause_of_death(client, worker)
            elif error is not None:
                message = " ".join(f"{type(error).__name__}: {error}".split())[:MESSAGE_LENGTH]
                outcome = JobOutcome(cause=FailureCause.FAULT, message=message)
            elif future.status == "finished":
                outcome = future.result()
            else:  # the scheduler has forgotten it
                raise ConnectionError(future.status)
            yield job, outcome
            future.release()
    except (OSError, StopIteration) as error:
        raise InputError(
            f"the Dask scheduler is gone ({type(error).__name__}): what was done is kept; start it and give the same "
            "command again"
        ) from error
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(handed_out), force=True)


def _places(client: Client) -> int:
    """Return how many jobs are handed out at a time; the workers of a running cluster come and go."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    threads = max(1, sum(int(worker["nthreads"]) for worker in workers))
    return threads if client.cluster is not None else 2 * threads


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
    """Run a job; bad input is an outcome. Beyond the time limit the process ends itself: a thread cannot be ended."""
    from distributed import get_worker

    from sfr_loc_map.metrics.score_json import to_json
    from sfr_loc_map.suite.job_run import run_job

    worker = get_worker()
    worker.log_event(STARTED, {"worker": worker.address, "key": job.key})
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
            return JobOutcome(result=to_json(run_job(job, Path(scratch), place)))
    except SfrError as error:
        return JobOutcome(cause=FailureCause.BAD_INPUT, message=" ".join(str(error).split())[:MESSAGE_LENGTH])
    finally:
        timer.cancel()
