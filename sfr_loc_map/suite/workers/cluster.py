"""Runs jobs on Dask: on worker processes of this machine, or on a running cluster.

Dask starts the processes, replaces a process that exceeds its memory limit, and repeats a job after the death of its
worker. An error fails a job at once, because a job is a pure function of its inputs. This module adds the time limit of
a job, the check that a worker has the code of the client, and the cause of a failure.

    connected ── Client ── SuiteWorkers ── run_jobs ──> JobOutcome of each job

A Dask plugin compares the digest of the code once for each run, on the present workers and on those that join later. A
worker with the code of the client offers a resource that the jobs require, so that Dask assigns jobs only to such
workers (`SuiteWorkers`).
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.inputs import refusing
from sfr_loc_map.message_text import one_line
from sfr_loc_map.signals import deferred_signals
from sfr_loc_map.suite.jobs.digests import code_facts, code_fingerprint
from sfr_loc_map.suite.jobs.job import NATIVE_THREADS, Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome, WorkerRecord
from sfr_loc_map.suite.planning.specification import SuiteSettings
from sfr_loc_map.suite.workers.worker import OVER_TIME, run_on_worker

if TYPE_CHECKING:
    from distributed import Client, Future, WorkerPlugin

TRIES = 3  #: Number of deaths of its worker after which a job has failed.
JOINED = "sfr-joined"  #: Topic of the event by which a worker reports its code.
OVER_MEMORY = "worker-restart-memory"  #: Topic of the event by which the Dask nanny reports an exceeded memory limit.
EVENT_S = 2.0  #: Maximum delay, s, of an event after the end of its worker.
ASK_EVERY_S = 1.0  #: Period, s, at which the scheduler is asked for its workers.
SAY_AFTER_S = 2.0  #: Time, s, without a worker after which a message is printed.
SHOWN = 10  #: Maximum number of reported workers with different code.
NETWORK_SCHEMES = ("tcp", "tls")  #: Schemes of the addresses of Dask that have a host and a port.


# ---- the connection


@contextlib.contextmanager
def connected(settings: SuiteSettings, *, workers: int, scheduler: str | None) -> Iterator[Client]:
    """Yield a client of local workers, or of the running scheduler at an address."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise MissingExtraError(f"suites require Dask ({error}): pip install 'sfr_loc_map[suite]'") from error
    for name in ("distributed", "distributed.client"):  # this module reports lost workers itself, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    options: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": TRIES - 1,  # a running scheduler has its own number, by default 3
        **{f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")},
        "distributed.worker.memory.terminate": 1.0,
        # Dask waits for a missing worker, which may be restarting; `SuiteWorkers` limits the waiting time
        "distributed.deploy.lost-worker-timeout": "1000 days",
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": ["sfr_loc_map.suite.workers.worker_start"],
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(NATIVE_THREADS, settings.threads),
        # not pre-spawn, which also sets the variable in this process, where numba refuses a change
        "distributed.nanny.environ": {"NUMBA_NUM_THREADS": settings.threads},
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(_unchanged_environment())
        stack.enter_context(dask.config.set(options))
        if scheduler is not None:
            with refusing(f"'{scheduler}' is not the address of a Dask scheduler", "give one like tcp://host:8786"):
                _check_address(scheduler)  # the client of an invalid address prints a traceback when it is deleted
            with refusing(f"no Dask scheduler answers at '{scheduler}'", "start a scheduler"):
                client = Client(scheduler, timeout="10s", set_as_default=False)
            stack.callback(client.close, timeout=2)
        else:
            with deferred_signals():  # signals to the process group would kill starting workers
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


@contextlib.contextmanager
def _unchanged_environment() -> Iterator[None]:
    """Restore the environment of this process afterwards, because Dask sets the variables of its workers there."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def _check_address(address: str) -> None:
    """Raise ValueError if an address of a network lacks its port."""
    from distributed.comm.addressing import parse_address, parse_host_port

    scheme, location = parse_address(address)
    if scheme in NETWORK_SCHEMES:
        parse_host_port(location)


def _end(cluster: Any) -> None:  # noqa: ANN401 - distributed is typed in part
    """Kill the workers; a normal close would wait for running jobs."""
    for nanny in cluster.workers.values():
        with contextlib.suppress(Exception):
            nanny.auto_restart = False
            os.kill(nanny.process.pid, signal.SIGKILL)
    with contextlib.suppress(Exception):
        cluster.close(timeout=5)


# ---- the workers with the code of the client


def proof_plugin(resource: str, expected: Mapping[str, str]) -> WorkerPlugin:
    """Return the plugin that compares the code of its worker, and offers a resource if the code is equal.

    A class in a function is pickled by value, so the plugin works on workers with different code or without the
    package. For the same reason the class must not use names of this module.
    """
    from distributed import Status, WorkerPlugin

    topic = JOINED

    class Proof(WorkerPlugin):
        name = resource

        async def setup(self, worker: Any) -> None:  # noqa: ANN401 - distributed is typed in part
            try:
                from sfr_loc_map.suite.workers.worker import about_here

                about = about_here(expected)
            except Exception as error:  # any version may be installed there
                about = {"lacks": f"sfr_loc_map of another version, or none ({type(error).__name__}: {error})"}
            worker.log_event(topic, {**about, "worker": worker.address, "resource": resource})
            if not about["lacks"]:
                # Dask assigns waiting jobs by resources only when a worker changes to running
                worker.status = Status.paused
                await worker.set_resources(**{resource: worker.state.nthreads})
                worker.status = Status.running

    return Proof()


class SuiteWorkers:
    """The workers of a scheduler. Workers with the code of the client offer the resource that each job requires."""

    def __init__(self, client: Client, settings: SuiteSettings, say: Callable[[str], None]) -> None:
        self.client = client
        self.settings = settings
        self.resource = f"sfr-{code_fingerprint()}"
        self.records: dict[str, WorkerRecord] = {}
        self._say = say
        self._asked_at = -math.inf
        self._slots = 0
        self._without_since = time.monotonic()  # start of the time without a suitable worker
        self._reported = ""
        self._events_read = len(client.get_events(JOINED))  # skip the events of earlier runs
        with contextlib.suppress(Exception):  # a worker that cannot load the plugin offers no resource
            client.register_plugin(proof_plugin(self.resource, code_facts()))

    def poll_slots(self) -> int:
        """Return the number of parallel jobs on the present workers; report if no worker may run a job.

        Raise InputError if no usable worker was present for longer than `wait_s`.
        """
        now = time.monotonic()
        if self._slots and now - self._asked_at < ASK_EVERY_S:
            return self._slots
        self._asked_at = now
        self._read_events()
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        fit = [worker for worker in workers.values() if worker["resources"].get(self.resource, 0) > 0]
        self._slots = sum(int(worker["nthreads"]) for worker in fit)
        if self._slots:
            self._without_since = now
            self._reported = ""
            return self._slots
        waited_s = now - self._without_since
        reason = self._reason(list(workers))
        if waited_s > self.settings.wait_s:
            raise InputError(
                f"{reason}: no usable worker joined in {self.settings.wait_s:g} s; finished results are kept: start a "
                "worker of the same version, then repeat the command to run the remaining jobs"
            )
        if waited_s > SAY_AFTER_S and reason != self._reported:
            self._reported = reason
            self._say(f"{reason}: waiting up to {self.settings.wait_s:g} s for a usable worker")
        return 0

    def count(self, outcome: JobOutcome) -> None:
        """Count a job of a worker if the job has a result. A job that has ended its worker leaves fewer slots."""
        if outcome.worker:
            self._record(outcome.worker).done += outcome.cause is None
        else:
            self._asked_at = -math.inf  # `poll_slots` asks the scheduler again

    def _read_events(self) -> None:
        """Read the events in which joining workers have reported their code."""
        events = self.client.get_events(JOINED)
        for _, event in events[self._events_read :]:
            if event["resource"] == self.resource:
                record = self._record(event["worker"])
                record.set_aside = event["lacks"]
                for name in ("host", "version", "python", "code"):
                    setattr(record, name, event.get(name, ""))
        self._events_read = len(events)

    def _record(self, worker: str) -> WorkerRecord:
        return self.records.setdefault(worker, WorkerRecord(worker=worker))

    def _reason(self, workers: Sequence[str]) -> str:
        """Return why no worker may run a job."""
        if not workers:
            return f"no worker at the scheduler {self.client.scheduler_info()['address']}"
        unknown = WorkerRecord(worker="", set_aside="has not reported its version")
        known = [self.records.get(worker, unknown) for worker in workers]
        lacks = [f"{at.host} ({worker}): {at.set_aside}" for worker, at in zip(workers, known, strict=True)]
        more = f"; and {len(lacks) - SHOWN} more" if len(lacks) > SHOWN else ""
        return f"none of {len(lacks)} workers is usable: {'; '.join(lacks[:SHOWN])}{more}"


# ---- the jobs


def run_jobs(jobs: Sequence[Job], workers: SuiteWorkers, cache: Path) -> Generator[tuple[Job, JobOutcome]]:
    """Yield each job with its outcome when the job has finished.

    Only as many jobs are submitted as run in parallel, because Dask counts the death of a worker against all jobs on
    this worker, including waiting jobs. Workers that cannot see the cache of simulated sources use their own cache.
    """
    client = workers.client
    waiting = deque(jobs)
    submitted: dict[Future[JobOutcome], Job] = {}
    done: SimpleQueue[Future[JobOutcome]] = SimpleQueue()

    def submit() -> None:
        slots = workers.poll_slots()
        while waiting and len(submitted) < slots:
            job = waiting.popleft()
            future = client.submit(
                run_on_worker,
                *(job, workers.settings.timeout_s, str(cache.absolute())),
                key=(f"sfr-{job.task}", job.key, time.time_ns()),
                resources={workers.resource: 1},
                pure=False,
            )
            submitted[future] = job
            future.add_done_callback(done.put)

    try:
        while waiting or submitted:
            submit()
            try:
                future = done.get(timeout=ASK_EVERY_S)
            except Empty:
                continue
            job = submitted.pop(future)
            outcome = _outcome_of(future, job, client)
            future.release()
            workers.count(outcome)
            submit()  # before the caller saves the outcome, so that no worker is idle
            yield job, outcome
    except OSError as error:
        raise InputError(
            f"the connection to the Dask scheduler was lost ({type(error).__name__}): results so far are kept; start "
            "the scheduler and repeat the command"
        ) from error
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(submitted), force=True)


def _outcome_of(future: Future[JobOutcome], job: Job, client: Client) -> JobOutcome:
    """Return the outcome of a job that Dask has finished or given up; ConnectionError if Dask has lost the job."""
    from distributed.scheduler import KilledWorker

    if future.status not in ("finished", "error"):
        raise ConnectionError(f"Dask has lost a job: {future.status}")
    try:
        return future.result()
    except KilledWorker as killed:
        return _cause_of_death(client, killed.last_worker.address, job)
    except Exception as error:
        if future.status == "finished":  # the job raised no error: its result was not received
            raise
        return JobOutcome(cause=FailureCause.FAULT, message=one_line(f"{type(error).__name__}: {error}"))


def _cause_of_death(client: Client, address: str, job: Job) -> JobOutcome:
    """Return the outcome of a job that killed its worker.

    The event with the cause may arrive after the scheduler has noticed the end of the worker.
    """
    end_s = time.monotonic() + EVENT_S
    while (outcome := _reported_cause(client, address, job)) is None and time.monotonic() < end_s:
        time.sleep(0.1)
    return outcome or JobOutcome(cause=FailureCause.DIED, message="its worker process was killed or crashed")


def _reported_cause(client: Client, address: str, job: Job) -> JobOutcome | None:
    """Return the outcome of a job that exceeded a limit, from the events of its worker; None without an event."""
    for _, event in client.get_events(OVER_TIME):
        if event["worker"] == address and event["job"] == job.key:
            return JobOutcome(cause=FailureCause.TIME, message=f"not finished after {event['seconds']:g} s")
    for _, event in client.get_events(OVER_MEMORY):
        if event["worker"] == address:
            message = f"{event['rss'] / 1e6:.0f} MB of memory, more than the limit of its worker"
            return JobOutcome(cause=FailureCause.MEMORY, message=message)
    return None
