"""Time and memory of the calls of a method, measured from outside its process, and what they say of the method."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.host_clock import CallClock
from sfr_loc_map.memory_mark import peak_of, reset_peak
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.table.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree, TreeUsage

MB = 1_000_000
LEAK_CALLS, LEAK_BYTES = 50, 40 * MB
"""Number of calls and growth, bytes, of a leak. The growth is between the minima of the fifths of the calls, so that a
saw-tooth does not hide the growth. Our own keyframe window grows by 24 MB while it fills."""
LEAK_SHARE = 0.02
"""Fraction of the growth by which each fifth must exceed the previous fifth. Loading of libraries and a window that
fills also grow memory by more than `LEAK_BYTES`, but the memory is then constant."""
MISSTATED_S, MISSTATED_RATIO = 1.0, 0.5
"""Allowed difference, s and fraction, of the sums of stated and measured times. The measured time includes copies of
the images and the transfer of the result. Time in which a busy host delays both processes is subtracted."""
MISSTATED_CALL_S = 0.01
"""Allowed difference per call, s. A transfer takes 5 ms, which adds up to 1 s in 200 calls."""
BETWEEN_S = 0.002
"""Processor time between two calls that is not added to the second call, s. The process of an idle method needs less to
end a call."""


def leak_in(resident: Sequence[int]) -> str:
    """Return the finding of a leak, from the memory after each of the last calls; empty without a leak."""
    if len(resident) < LEAK_CALLS:
        return ""
    least = np.array(resident)[-LEAK_CALLS:].reshape(5, -1).min(axis=1)
    growth = int(least[-1] - least[0])
    if growth <= LEAK_BYTES or (np.diff(least) < LEAK_SHARE * growth).any():
        return ""
    return (
        f"{FindingKind.LEAKING}: memory grows by {growth / (0.8 * LEAK_CALLS) / MB:.1f} MB per call "
        f"over {LEAK_CALLS} calls"
    )


def is_misstated(measured_s: float, stated_s: float, calls: int, waited_s: float = 0.0) -> bool:
    """Return whether stated and measured times differ by more than copies and transfers explain.

    `waited_s` is the time in which the call waited for a processor. A stated time may contain any part of it.
    """

    def allowed_s(of_s: float) -> float:
        return max(MISSTATED_S, MISSTATED_RATIO * of_s, MISSTATED_CALL_S * calls)

    worked_s = max(measured_s - waited_s, 0.0)
    is_explained = worked_s - allowed_s(worked_s) <= stated_s <= measured_s + allowed_s(measured_s)
    return not is_explained  # also for a stated time of NaN


def waits_for_processor_s(pid: int) -> FloatArray:
    """Return the times `(2,)`, s, that this thread and the main thread of a process have waited for a processor.

    A time is 0 if the kernel does not report it (CONFIG_SCHED_INFO).
    """
    waited_s = np.zeros(2)
    for row, path in enumerate((Path("/proc/thread-self/schedstat"), Path(f"/proc/{pid}/schedstat"))):
        with suppress(OSError):
            waited_s[row] = int(path.read_text(encoding="ascii").split()[1]) / NS_PER_S
    return waited_s


@dataclass(frozen=True, slots=True)
class Measurement:
    """Resource use of one call."""

    seconds: float  #: From the copy of the images to the complete answer.
    usage: CallUsage  #: Its time includes the work of the method before the call.
    tree: TreeUsage  #: Resource use of all processes after the call.
    cpu_s: float  #: Processor time of the call.
    cpu_between_s: float  #: Processor time since the previous call.
    #: Time in which the calling process or the method waited for a processor during the call. The larger of both times
    #: counts, because the processes may wait at the same time.
    waited_s: float

    @property
    def figures(self) -> dict[str, float]:
        """The figures for the statistics of the call."""
        return {
            "cpu_s": round(self.cpu_s, 2),
            "cpu_between_s": round(self.cpu_between_s, 2),
            "threads": self.tree.threads,
            "processes": self.tree.processes,
        }


class CallMonitor:
    """Measures the calls of one process, whose memory must not exceed a limit."""

    def __init__(self, tree: ProcessTree, file_bytes: Callable[[], int], memory_mb: int, *, keeps_rate: bool) -> None:
        """Measure a process tree and the memory of its files.

        `keeps_rate` states that pairs arrive at their rate, so that the method may work between its calls.
        """
        self._tree, self._file_bytes = tree, file_bytes
        self._memory_mb, self._keeps_rate = memory_mb, keeps_rate
        self.idle_bytes: int | None = None  #: Resident memory after warm-up; None if unknown.
        self._pid = 0  # of the method itself, without its children
        self._peak_bytes = 0  # largest sampled memory of the current call
        self._clock = CallClock()
        self._begun = TreeUsage()
        self._between_s = self._worked_s = 0.0
        self._waits_s = np.zeros(2)  # of the calling process and the method, before the call
        self._answered_s: float | None = None  # end of the last call, by the monotonic clock
        self._answered_cpu_s = 0.0  # processor time of all processes at that time

    def start(self, pid: int) -> None:
        """Begin after the warm-up of the method, which is this process."""
        self._pid = pid
        idle_bytes = reset_peak(pid)
        self.idle_bytes = None if idle_bytes is None else idle_bytes + self._file_bytes()
        self._tree.usage()
        self._answered_cpu_s = self._tree.cpu_s()

    def check_memory(self) -> TreeUsage:
        """Return the resource use of the processes and their files; MethodFailureError beyond the memory limit."""
        usage = self._tree.usage()
        usage = replace(usage, rss_bytes=usage.rss_bytes + self._file_bytes())
        self._peak_bytes = max(self._peak_bytes, usage.rss_bytes)
        if usage.rss_bytes > self._memory_mb * MB:
            text = f"has {usage.rss_bytes // MB} MB resident: at most {self._memory_mb} MB is allowed"
            raise MethodFailureError(FindingKind.OUT_OF_MEMORY, text, ended=True)
        return usage

    def begin_call(self) -> None:
        """Begin before the images are shared, because the method could already work on them."""
        self._begun = self._tree.usage()
        self._peak_bytes = 0
        reset_peak(self._pid)
        self._between_s = max(self._tree.cpu_s() - self._answered_cpu_s, 0.0)
        self._worked_s = self._worked_since_last_call()
        self._waits_s = waits_for_processor_s(self._pid)
        self._clock.begin()

    def end_call(self) -> Measurement:
        """Return the measurement of the call, after its answer and its files were read."""
        seconds = self._clock.end()
        waited_s = float(np.max(waits_for_processor_s(self._pid) - self._waits_s, initial=0.0))
        self._answered_s, self._answered_cpu_s = time.monotonic(), self._tree.cpu_s()
        now = self.check_memory()
        # the peak covers only the method itself; the sampled sum includes its child processes
        peak = peak_of(self._pid)
        peak = None if peak is None else max(peak, self._peak_bytes)
        above = None if peak is None or self.idle_bytes is None else max(peak - self.idle_bytes, 0)
        usage = CallUsage(seconds + self._worked_s, peak, above)
        return Measurement(seconds, usage, now, now.cpu_s - self._begun.cpu_s, self._between_s, waited_s)

    def _worked_since_last_call(self) -> float:
        """Return the time that the method worked since the last call, s.

        This time is at most the processor time of all processes, and at most the time that passed. Before the first
        call the method has no images.
        """
        if self._answered_s is None or self._keeps_rate or self._between_s <= BETWEEN_S:
            return 0.0
        return min(self._between_s, time.monotonic() - self._answered_s)


class CallFindings:
    """Findings that several calls show: a leak of memory, and misstated times."""

    def __init__(self) -> None:
        self._resident_bytes: deque[int] = deque(maxlen=LEAK_CALLS)
        self._measured_s = self._stated_s = self._waited_s = 0.0  # summed over the calls since the last finding
        self._calls = 0

    def add(self, measured: Measurement, stated_s: float) -> str:
        """Add a call, whose time the method stated; return the finding, which is empty without one."""
        self._resident_bytes.append(measured.tree.rss_bytes)
        self._measured_s += measured.seconds
        self._stated_s += stated_s
        self._waited_s += measured.waited_s
        self._calls += 1
        return self._leak() or self._misstatement()

    def _leak(self) -> str:
        finding = leak_in(self._resident_bytes)
        if finding:
            self._resident_bytes.clear()  # each growth is reported once
        return finding

    def _misstatement(self) -> str:
        if not is_misstated(self._measured_s, self._stated_s, self._calls, self._waited_s):
            return ""
        text = f"reports {self._stated_s:.3f} s for calls that took {self._measured_s:.3f} s from request to answer"
        self._measured_s = self._stated_s = self._waited_s = 0.0
        self._calls = 0
        return f"{FindingKind.MISSTATED}: {text}"
