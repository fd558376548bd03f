"""One thread that does the work of a node, job after job, so that the executor stays free to answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import StrEnum
from threading import Condition, Thread

Job = Callable[[], None]
OnFault = Callable[[Exception, bool], None]
MAX_WAITING_BYTES = 256_000_000  #: Of jobs that say how large they are: some sixteen clouds of a megapixel.


class Overload(StrEnum):
    """Which droppable jobs are kept when they come faster than they are done."""

    EVERY_PAIR = "every_pair"
    """The last ones, as many as there is room for."""
    NEWEST_ONLY = "newest_first"
    """The newest alone; the value is that of the nodes' parameter `overload`."""


class Worker:
    """Does jobs in the order in which they were given.

    Two kinds of jobs wait in one queue. Droppable ones (stereo pairs) are bounded in number and size. The others (a new
    rig, a new pose, a reset) are never dropped and keep their position among them.
    """

    def __init__(self, name: str, overload: Overload, capacity: int, on_fault: OnFault) -> None:
        """Start the thread; `on_fault` is called in it with what a job raised, and whether the job was droppable."""
        self.dropped = self.waiting = 0
        self._capacity = 1 if overload is Overload.NEWEST_ONLY else capacity
        self._on_fault = on_fault
        self._jobs: deque[tuple[Job, int | None]] = deque()  # with the bytes of droppable ones
        self._changed = Condition()
        self._busy = self._ending = False
        self._thread = Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def enqueue(self, job: Job) -> None:
        """Add a job that is never dropped."""
        with self._changed:
            self._append(job, None)

    def enqueue_droppable(self, job: Job, size_bytes: int = 0) -> None:
        """Add a job that may be dropped, with its size, 0 where that does not matter.

        If the queue is full the oldest droppable job is dropped, and counted. Where jobs become too large together, the
        oldest of those that have a size are dropped.
        """
        with self._changed:
            while self.waiting >= self._capacity:
                self._drop_oldest(0)
            while size_bytes and 0 < sum(other or 0 for _, other in self._jobs) > MAX_WAITING_BYTES - size_bytes:
                self._drop_oldest(1)
            self._append(job, size_bytes)

    @property
    def is_idle(self) -> bool:
        """Tell whether no job waits or runs."""
        return not self._busy and not self._jobs

    def clear(self) -> None:
        """Drop the droppable jobs that wait; they do not count as dropped."""
        with self._changed:
            self.waiting = 0
            self._jobs = deque(job for job in self._jobs if job[1] is None)

    def wait_idle(self) -> None:
        """Return when no job waits or runs."""
        with self._changed:
            self._changed.wait_for(lambda: not self._busy and not self._jobs)

    def stop(self, timeout_s: float = 10.0) -> None:
        """End the thread: waiting jobs are forgotten, the running one is finished, unless it takes too long."""
        with self._changed:
            self._ending = True
            self._jobs.clear()
            self.waiting = 0
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def _append(self, job: Job, size_bytes: int | None) -> None:
        if not self._ending:
            self._jobs.append((job, size_bytes))
            self.waiting += size_bytes is not None
            self._changed.notify_all()

    def _drop_oldest(self, least_bytes: int) -> None:
        sizes = enumerate(size for _, size in self._jobs)
        del self._jobs[next(number for number, size in sizes if size is not None and size >= least_bytes)]
        self.waiting -= 1
        self.dropped += 1

    def _work(self) -> None:
        while (taken := self._next()) is not None:
            job, size_bytes = taken
            try:
                job()
            except Exception as error:
                self._on_fault(error, size_bytes is not None)
            del job, taken  # an image must not be held until the next one comes
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> tuple[Job, int | None] | None:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._jobs) or self._ending)
            if self._ending:
                return None
            job, size_bytes = self._jobs.popleft()
            self.waiting -= size_bytes is not None
            self._busy = True
            return job, size_bytes
