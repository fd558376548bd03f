"""One thread that does the work of a node, job after job, so that the executor stays free to answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from threading import Condition, Thread

Job = Callable[[], None]
MAX_WAITING_BYTES = 256_000_000
"""Of jobs that say how large they are: some sixteen clouds of a megapixel."""


class Overload(StrEnum):
    """Which droppable jobs are kept when they come faster than they are done."""

    EVERY_PAIR = "every_pair"
    """The last ones, as many as there is room for."""
    NEWEST_FIRST = "newest_first"
    """The newest alone."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    run: Job
    droppable: bool
    size_bytes: int = 0


class Worker:
    """Does jobs in the order in which they were given.

    Two kinds of jobs wait in one queue. Droppable ones (stereo pairs) are bounded in number and size. The others (a new
    rig, a new pose, a reset) are never dropped and keep their position among them.

    Attributes:
        dropped: Jobs dropped since the start because the queue was full.
    """

    def __init__(self, name: str, overload: Overload, capacity: int, on_fault: Callable[[Exception], None]) -> None:
        """Start the thread.

        Args:
            name: Name of the thread.
            overload: Which droppable jobs are kept.
            capacity: Most droppable jobs that wait (`EVERY_PAIR`).
            on_fault: Called, in the thread, with an exception that a job did not catch; the next job is done anyway.
        """
        self.dropped = 0
        self._capacity = 1 if overload is Overload.NEWEST_FIRST else capacity
        self._on_fault = on_fault
        self._jobs: deque[_Waiting] = deque()
        self._droppable = 0
        self._changed = Condition()
        self._busy = self._ending = False
        self._thread = Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Droppable jobs that wait."""
        return self._droppable

    def enqueue(self, job: Job) -> None:
        """Add a job that is never dropped."""
        self._add(_Waiting(job, droppable=False))

    def enqueue_droppable(self, job: Job, size_bytes: int = 0) -> None:
        """Add a job; if the queue is full the oldest droppable job is dropped, and counted.

        Args:
            job: To be done.
            size_bytes: Of what it holds; where such jobs become too large together, the oldest of them are dropped.
        """
        with self._changed:
            while self._droppable >= self._capacity:
                self._drop_oldest()
            while size_bytes and 0 < self._waiting_bytes() > MAX_WAITING_BYTES - size_bytes:
                self._drop_oldest(least_bytes=1)
        self._add(_Waiting(job, droppable=True, size_bytes=size_bytes))

    def clear(self) -> int:
        """Drop the droppable jobs that wait; return how many (they do not count as dropped)."""
        with self._changed:
            count = self._droppable
            self._jobs = deque(job for job in self._jobs if not job.droppable)
            self._droppable = 0
            return count

    def wait_idle(self) -> None:
        """Return when no job waits or runs."""
        with self._changed:
            self._changed.wait_for(lambda: not self._busy and not self._jobs)

    def stop(self, timeout_s: float = 10.0) -> None:
        """End the thread: waiting jobs are forgotten, the running one is finished.

        Args:
            timeout_s: How long the running job may take; a thread that hangs ends with the process.
        """
        with self._changed:
            self._ending = True
            self._jobs.clear()
            self._droppable = 0
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def _add(self, job: _Waiting) -> None:
        with self._changed:
            if self._ending:
                return
            self._jobs.append(job)
            self._droppable += job.droppable
            self._changed.notify_all()

    def _waiting_bytes(self) -> int:
        return sum(job.size_bytes for job in self._jobs)

    def _drop_oldest(self, least_bytes: int = 0) -> None:
        jobs = enumerate(self._jobs)
        index = next(number for number, job in jobs if job.droppable and job.size_bytes >= least_bytes)
        del self._jobs[index]
        self._droppable -= 1
        self.dropped += 1

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception as error:
                self._on_fault(error)
            del job  # an image must not be held until the next one comes
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> Job | None:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._jobs) or self._ending)
            if self._ending:
                return None
            first = self._jobs.popleft()
            self._droppable -= first.droppable
            self._busy = True
            return first.run
