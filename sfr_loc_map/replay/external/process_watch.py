"""Measure CPU time and memory of running processes by sampling from outside."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import psutil

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.figures.records import ProcessUsage
from sfr_loc_map.process_tree import ProcessTree

PERIOD_S = 0.05
FAST_DDS = (1, 15)
"""First bytes of a publisher's global id in Fast DDS. Bytes 4 and 5 of the id are the lowest bits of the process id."""
ENDED = "Z"  #: State in `/proc/PID/status` of a process that has ended and whose parent has not read its exit code.
METHOD = f"sum over the process tree, sampled {1 / PERIOD_S:.0f} times a second (psutil)"


def processes_watched(text: str, started: Sequence[int]) -> list[int]:
    """Return the process ids for `--watch`: a given id, or all processes with the text in name or command line.

    A text is not searched in this replay, in its ancestors (such as a shell), and in other replays with `--watch`,
    because their command lines contain the text. Processes that the replay has `started` are always included.
    Descendants of a found process are omitted, because the process is watched with its descendants.
    """
    found: dict[int, list[psutil.Process]] = {}
    this = psutil.Process()
    callers = {this, *this.parents()}
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = process.cmdline()
            if text.isdigit():
                is_watched = str(process.pid) == text
            else:
                is_replay = process in callers or any(word.partition("=")[0] == "--watch" for word in words)
                is_watched = not is_replay and (text == process.name() or text in " ".join(words))
            if is_watched:
                found[process.pid] = process.parents()
    if not found:
        raise ConfigError(f"'--watch {text}': there is no such process; give a process id or a part of a command line")
    roots = {*found, *started}
    found |= {pid: [] for pid in started}
    return [pid for pid, parents in found.items() if not any(parent.pid in roots for parent in parents)]


class ProcessWatch:
    """Samples CPU time and memory of processes and their descendants, in its own thread.

    An ended process keeps the processor time of its last sample. Peaks between two samples are missed.
    """

    def __init__(self, pids: Sequence[int]) -> None:
        """Start sampling; `pids` are the roots of the process trees."""
        self._trees = [ProcessTree(pid) for pid in pids if psutil.pid_exists(pid)]
        self._begin_s = [tree.usage().cpu_s for tree in self._trees]
        self._cpu_s = self._begin_s
        self._peak_bytes = 0
        self._most_processes = 0
        self._stop = threading.Event()
        self._sample()
        self._thread = threading.Thread(target=self._run, name="process-watch", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Take the last sample and end the thread; further calls have no effect."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            self._sample()

    def has_publishers(self, ids: Iterable[Sequence[int]]) -> bool:
        """Return whether publishers with these global ids belong to the watched processes.

        Only ids of Fast DDS name the process. Publishers with other ids are assumed to belong to the processes.
        """
        return self.runs_publishers([each for each in ids if tuple(each[:2]) == FAST_DDS])

    def runs_publishers(self, ids: Iterable[Sequence[int]]) -> bool:
        """Return whether publishers with these global ids are known to belong to watched processes that run now."""
        found = {pid & 0xFFFF for tree in self._trees for item in tree.members() for pid in _numbers_of(item.pid)}
        return all(tuple(each[:2]) == FAST_DDS and each[4] | each[5] << 8 in found for each in ids)

    @property
    def usage(self) -> ProcessUsage | None:
        """CPU time since the start and peak memory; None if the processes could not be observed."""
        if not self._peak_bytes:
            return None
        spent_s = sum(self._cpu_s) - sum(self._begin_s)
        return ProcessUsage(
            cpu_s=spent_s, peak_rss_bytes=self._peak_bytes, processes=self._most_processes, method=METHOD
        )

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self._sample()

    def _sample(self) -> None:
        now = [tree.usage() for tree in self._trees]
        self._cpu_s = [max(before_s, item.cpu_s) for before_s, item in zip(self._cpu_s, now, strict=True)]
        self._peak_bytes = max(self._peak_bytes, sum(item.rss_bytes for item in now))
        self._most_processes = max(self._most_processes, sum(item.processes for item in now))


def _numbers_of(pid: int) -> Iterator[int]:
    """Yield the ids of a running process in its namespaces, for example in a container."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("State:") and line.split()[1] == ENDED:
                return
            if line.startswith("NSpid:"):
                yield from map(int, line.split()[1:])
