"""CPU and memory of processes that are not ours, seen from outside."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Sequence

import psutil

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.score import ProcessUsage

PERIOD_S = 0.05
METHOD = f"sum over the process tree, sampled {1 / PERIOD_S:.0f} times a second (psutil)"


def processes_named(text: str) -> list[int]:
    """Return the process ids that `--watch` means: one by its number, or all whose name or command line has the text.

    Raises:
        ConfigError: If there is none.
    """
    if text.isdigit():
        found = [int(text)] if psutil.pid_exists(int(text)) else []
    else:
        found = [process.pid for process in psutil.process_iter() if _is_named(process, text)]
    if not found:
        raise ConfigError(f"'--watch {text}': there is no such process; give its number or a part of its command line")
    return found


def _is_named(process: psutil.Process, text: str) -> bool:
    with contextlib.suppress(psutil.Error):
        words = process.cmdline()
        return "--watch" not in words and (text == process.name() or text in " ".join(words))
    return False


class ProcessWatch:
    """Samples processes and their descendants in a thread of its own.

    A process that ends keeps the processor time of its last sample. A peak between two samples is missed.
    """

    def __init__(self, pids: Sequence[int], period_s: float = PERIOD_S) -> None:
        """Watch nothing yet.

        Args:
            pids: Roots of the trees.
            period_s: Time between samples.
        """
        self._pids, self._period_s = list(pids), period_s
        self._cpu_s: dict[tuple[int, float], float] = {}
        self._begin_s: dict[tuple[int, float], float] = {}
        self._peak_bytes, self._most = 0, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="process-watch", daemon=True)

    def start(self) -> None:
        """Begin to sample."""
        self._sample(first=True)
        self._thread.start()

    def stop(self) -> None:
        """Take the last sample; once is enough."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            self._sample()

    @property
    def usage(self) -> ProcessUsage | None:
        """What was used since the watch began; None if nothing could be seen."""
        if not self._most:
            return None
        spent = sum(self._cpu_s[key] - self._begin_s[key] for key in self._cpu_s)
        return ProcessUsage(cpu_s=spent, peak_rss_bytes=self._peak_bytes, processes=self._most, method=METHOD)

    def _run(self) -> None:
        while not self._stop.wait(self._period_s):
            self._sample()

    def _sample(self, *, first: bool = False) -> None:
        resident = seen = 0
        for process in self._tree():
            with contextlib.suppress(psutil.Error):
                key = (process.pid, process.create_time())
                times = process.cpu_times()
                resident += process.memory_info().rss
                self._cpu_s[key] = times.user + times.system
                self._begin_s.setdefault(key, self._cpu_s[key] if first else 0.0)
                seen += 1
        self._peak_bytes, self._most = max(self._peak_bytes, resident), max(self._most, seen)

    def _tree(self) -> list[psutil.Process]:
        found: dict[int, psutil.Process] = {}
        for pid in self._pids:
            with contextlib.suppress(psutil.Error):
                root = psutil.Process(pid)
                found |= {process.pid: process for process in (root, *root.children(recursive=True))}
        return list(found.values())
