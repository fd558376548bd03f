"""A thread that runs the jobs of a node one after another, so that the executor stays responsive."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from threading import Condition, Thread

Work = Callable[[], None]
OnFault = Callable[[Exception, bool], None]
MAX_WAITING_BYTES = 256_000_000
"""Maximum total size of the waiting messages that are limited by size, bytes: sixteen clouds of 1 Mpx."""


class Overload(StrEnum):
    """Droppable jobs that are kept when jobs arrive faster than they are run: values of the parameter `overload`."""

    ALL = "every_pair"
    """The newest jobs, up to the capacity of the queue."""
    NEWEST = "newest_first"
    """Only the newest job."""


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """Work in the queue of the worker."""

    work: Work
    is_droppable: bool = False
    size_bytes: int = 0  #: Size of the message that the job holds; 0 if only the number of such jobs is bounded.


class Worker:
    """Runs jobs in the order in which they were added.

    Droppable jobs (stereo pairs, messages) are bounded in number, and those with a size (clouds) also in total size.
    Other jobs (a new pose, new parameters, a reset) are never dropped and keep their position in the common queue.
    """

    def __init__(self, name: str, overload: Overload, capacity: int, on_fault: OnFault) -> None:
        """Start the thread; it calls `on_fault` with the exception of a job, and whether the job was droppable."""
        self.dropped = self.waiting = 0
        self._capacity = 1 if overload is Overload.NEWEST else capacity
        self._on_fault = on_fault
        self._jobs: deque[Job] = deque()
        self._changed = Condition()
        self._busy = self._ending = False
        self._thread = Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def enqueue(self, work: Work) -> None:
        """Add a job that is never dropped."""
        with self._changed:
            self._append(Job(work))

    def enqueue_droppable(self, work: Work, size_bytes: int = 0) -> None:
        """Add a job that may be dropped, with the size of its message; 0 if only the number of jobs is bounded.

        If the queue is full, the oldest droppable job is dropped and counted. If the total size would exceed
        `MAX_WAITING_BYTES`, the oldest droppable jobs with a size are dropped.
        """
        with self._changed:
            while self.waiting >= self._capacity:
                self._drop_first(lambda job: job.is_droppable)
            while self._exceeds_memory(size_bytes):
                self._drop_first(lambda job: job.is_droppable and job.size_bytes > 0)
            self._append(Job(work, True, size_bytes))

    @property
    def is_idle(self) -> bool:
        """Return whether no job waits or runs."""
        return not self._busy and not self._jobs

    def clear(self) -> None:
        """Remove the droppable jobs from the queue without counting them as dropped."""
        with self._changed:
            self.waiting = 0
            self._jobs = deque(item for item in self._jobs if not item.is_droppable)

    def wait_idle(self) -> None:
        """Return when no job waits or runs."""
        with self._changed:
            self._changed.wait_for(lambda: not self._busy and not self._jobs)

    def stop(self, timeout_s: float = 10.0) -> None:
        """End the thread: waiting jobs are removed, and the running job is finished unless it exceeds the timeout."""
        with self._changed:
            self._ending = True
            self._jobs.clear()
            self.waiting = 0
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def _append(self, item: Job) -> None:
        if not self._ending:
            self._jobs.append(item)
            self.waiting += item.is_droppable
            self._changed.notify_all()

    def _exceeds_memory(self, size_bytes: int) -> bool:
        """Return whether the total size would be too large with another job; False if no job with a size waits."""
        waiting_bytes = sum(job.size_bytes for job in self._jobs)
        return size_bytes > 0 and waiting_bytes > 0 and waiting_bytes + size_bytes > MAX_WAITING_BYTES

    def _drop_first(self, is_dropped: Callable[[Job], bool]) -> None:
        """Drop and count the oldest job that meets a condition."""
        self._jobs.remove(next(job for job in self._jobs if is_dropped(job)))
        self.waiting -= 1
        self.dropped += 1

    def _work(self) -> None:
        while (item := self._next()) is not None:
            self._run(item)
            del item  # an image must not be held until the next job arrives
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _run(self, item: Job) -> None:
        try:
            item.work()
        except Exception as error:
            try:
                self._on_fault(error, item.is_droppable)
            except Exception:  # the thread must survive, because services and transitions wait for it
                traceback.print_exc()

    def _next(self) -> Job | None:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._jobs) or self._ending)
            if self._ending:
                return None
            item = self._jobs.popleft()
            self.waiting -= item.is_droppable
            self._busy = True
            return item
