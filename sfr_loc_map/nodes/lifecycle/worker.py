"""One thread that does a node's work, one job after the other, so that the node goes on answering meanwhile."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Literal

Job = Callable[[], None]
Overload = Literal["every_pair", "newest_first"]


@dataclass(frozen=True, slots=True)
class _Waiting:
    run: Job
    droppable: bool


class Worker:
    """Does jobs in the order in which they were given.

    Two kinds of jobs wait in one queue. Those that `offer` gives (stereo pairs) are bounded in number and may be
    dropped; those that `put` gives (a new rig, a new pose, a reset) are never dropped and keep their place between
    the others.

    Attributes:
        dropped: Jobs dropped since the start because there was no room for them.
    """

    def __init__(self, name: str, overload: Overload, room: int, on_fault: Callable[[Exception], None]) -> None:
        """Start the thread.

        Args:
            name: Name of the thread.
            overload: `every_pair`: up to `room` jobs wait, the oldest goes when one more comes; `newest_first`: only
                the newest waits.
            room: Most droppable jobs that wait.
            on_fault: Called, in the thread, with an exception that a job let through; the next job is done all the
                same.
        """
        self.dropped = 0
        self._room = 1 if overload == "newest_first" else room
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

    def put(self, job: Job) -> None:
        """Add a job that is never dropped."""
        self._add(_Waiting(job, droppable=False))

    def offer(self, job: Job) -> None:
        """Add a job; where there is no room for it the oldest of its kind is dropped, and counted."""
        with self._changed:
            while self._droppable >= self._room:
                self._drop_oldest()
                self.dropped += 1
        self._add(_Waiting(job, droppable=True))

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

    def stop(self, patience_s: float = 10.0) -> None:
        """End the thread: what waits is forgotten, the job under way is waited for.

        Args:
            patience_s: How long; a thread that hangs ends with the process.
        """
        with self._changed:
            self._ending = True
            self._jobs.clear()
            self._droppable = 0
            self._changed.notify_all()
        self._thread.join(patience_s)

    def _add(self, job: _Waiting) -> None:
        with self._changed:
            if self._ending:
                return
            self._jobs.append(job)
            self._droppable += job.droppable
            self._changed.notify_all()

    def _drop_oldest(self) -> None:
        index = next(number for number, job in enumerate(self._jobs) if job.droppable)
        del self._jobs[index]
        self._droppable -= 1

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception as error:
                self._on_fault(error)
            del job  # a picture must not be held until the next one comes
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
