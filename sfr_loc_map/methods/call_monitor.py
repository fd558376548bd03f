"""Time and memory of the calls of a method, measured from outside its process, and the findings about the method."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.host_clock import CallClock
from sfr_loc_map.memory_mark import peak_of, reset_peak
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind
from sfr_loc_map.metrics.formulas import memory_above_idle
from sfr_loc_map.process_tree import ProcessTree, TreeUsage, running_thread

MB = 1_000_000
LEAK_CALLS = 50  #: Number of calls over which a leak is detected.
LEAK_PARTS = 5  #: Number of equal parts of these calls.
LEAK_BYTES = 40 * MB
"""Minimum growth of a leak: the difference between the minima of the last and of the first part, so that a saw-tooth
does not hide the growth. The keyframe window of our localiser grows by 24 MB while it fills."""
LEAK_SHARE = 0.02
"""Fraction of the growth by which the minimum of each part must exceed that of the previous part. Loading libraries and
filling a window also need more than `LEAK_BYTES`, but the memory is constant afterwards."""
MISSTATED_S, MISSTATED_RATIO = 1.0, 0.5
"""Allowed difference between the sums of stated and measured times, in s and as a fraction. The measured time includes
copies of the images and the transfer of the result. Time in which a busy host delays both processes is subtracted."""
MISSTATED_CALL_S = 0.01
"""Allowed difference per call, s. A transfer takes 5 ms, which adds up to 1 s in 200 calls."""
BETWEEN_S = 0.002
"""Processor time between two calls that is not added to the second call, s. The process of an idle method needs less to
end a call."""


def leak_in(resident: Sequence[int]) -> CallFinding | None:
    """Return the finding of a leak, from the memory after each of the last calls; None without a leak."""
    if len(resident) < LEAK_CALLS:
        return None
    least = np.array(resident)[-LEAK_CALLS:].reshape(LEAK_PARTS, -1).min(axis=1)
    growth = int(least[-1] - least[0])
    if growth <= LEAK_BYTES or (np.diff(least) < LEAK_SHARE * growth).any():
        return None
    calls_of_growth = LEAK_CALLS - LEAK_CALLS // LEAK_PARTS  # from the first to the last part
    per_call_mb = growth / calls_of_growth / MB
    return CallFinding(FindingKind.LEAKING, f"memory grows by {per_call_mb:.1f} MB per call over {LEAK_CALLS} calls")


def is_misstated(measured_s: float, stated_s: float, calls: int, waited_s: float = 0.0) -> bool:
    """Return whether stated and measured times differ by more than copies and transfers explain.

    `waited_s` is the time in which the call waited for a processor. The stated time may include all, part or none of
    this wait.
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
class ProcessMemory:
    """Resident memory of the processes of a method and of the files that they can write, which has a limit."""

    tree: ProcessTree
    file_bytes: Callable[[], int]  #: Returns the memory of the files; OSError if a file cannot be examined.
    limit_mb: int

    def usage(self) -> TreeUsage:
        """Return the present resource use with the files; MethodFailureError beyond the limit."""
        usage = self.tree.usage()
        usage = replace(usage, rss_bytes=usage.rss_bytes + self.stored_bytes())
        self.check(usage.rss_bytes, "has")
        return usage

    def stored_bytes(self) -> int:
        """Return the memory of the files; MethodFailureError if it cannot be measured."""
        try:
            return self.file_bytes()
        except OSError as error:
            text = f"has a file that cannot be measured ({error.strerror}): its memory is unknown"
            raise MethodFailureError(FindingKind.OUT_OF_MEMORY, text) from error

    def resident_bytes(self, process: int) -> int | None:
        """Return the resident memory of one process with the files, None if unknown; reset its high-water mark."""
        resident = reset_peak(running_thread(process))
        return None if resident is None else resident + self.stored_bytes()

    def check(self, resident_bytes: int, verb: str) -> None:
        """Raise MethodFailureError if the limit is exceeded."""
        if resident_bytes > self.limit_mb * MB:
            text = f"{verb} {resident_bytes // MB} MB resident: at most {self.limit_mb} MB is allowed"
            raise MethodFailureError(FindingKind.OUT_OF_MEMORY, text)


@dataclass(frozen=True, slots=True)
class Measurement:
    """Resource use of one call."""

    answer_s: float  #: Time from the copy of the images to the complete answer, s.
    usage: CallUsage  #: Time (`answer_s` plus the work of the method before the call) and memory.
    tree: TreeUsage  #: Resource use of all processes after the call.
    cpu_s: float  #: Processor time of the call.
    cpu_between_s: float  #: Processor time since the previous call.
    #: Time of the call, s, in which the method did not work, because a process waited for a processor or because the
    #: calling process read processor clocks. Of the waiting times of the calling process and of the method, the larger
    #: is used, because both processes may wait at the same time.
    waited_s: float
    end_s: float  #: End of the call by the monotonic clock.
    total_cpu_s: float  #: Processor time of all processes until the end of the call.

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
    """Measures the calls of a process, one at a time; a monitor is made after the warm-up of the method."""

    def __init__(self, memory: ProcessMemory, pid: int, base_bytes: int | None, *, keeps_rate: bool) -> None:
        """Measure the process `pid`, which is the method itself without its children.

        `base_bytes` is the memory of this process before any code of the method was loaded, None if unknown. The memory
        "above the idle process" is above this memory, so that memory that the method takes when it is imported or
        created counts. `keeps_rate` states that no pair is sent earlier than at the rate of the pairs, so that the
        method may work between its calls.
        """
        self.memory = memory
        self.pid = pid
        self.clock = CallClock()
        self._keeps_rate = keeps_rate
        self.base_bytes = base_bytes
        memory.tree.usage()
        self._warm_cpu_s = memory.tree.cpu_s()  # processor time of the warm-up

    def begin_call(self, previous: Measurement | None) -> RunningCall:
        """Begin a call before its images are shared, because the method could already work on them.

        The processor clocks are read after the call has begun, and before it ends, because the method could work while
        the clocks of many processes are read.
        `previous` is the measurement of the previous call, None at the first call.
        """
        begin = self.memory.tree.usage()
        reset_peak(running_thread(self.pid))
        before_cpu_s = self._warm_cpu_s if previous is None else previous.total_cpu_s
        waits_s = waits_for_processor_s(self.pid)
        begin_s = time.monotonic()
        self.clock.begin()
        between_s = max(self.memory.tree.cpu_s() - before_cpu_s, 0.0)
        reading_s = time.monotonic() - begin_s
        charged_s = self._charged_s(between_s, previous, begin_s)
        return RunningCall(self, begin, between_s, charged_s, waits_s, reading_s)

    def _charged_s(self, between_s: float, previous: Measurement | None, begin_s: float) -> float:
        """Return the time that the method worked between the last call and `begin_s` (monotonic clock), s.

        This time is at most the processor time of all processes, and at most the time that passed. Before the first
        call the method has no images.
        """
        if previous is None or self._keeps_rate or between_s <= BETWEEN_S:
            return 0.0
        return min(between_s, begin_s - previous.end_s)


@dataclass(slots=True, eq=False)
class RunningCall:
    """A call that has begun and whose answer is not yet complete."""

    monitor: CallMonitor
    begin: TreeUsage
    between_s: float  #: Processor time since the previous call.
    charged_s: float  #: Work of the method since the previous call, which is added to this call.
    waits_s: FloatArray  #: Waiting times of the calling process and the method before the call.
    reading_s: float  #: Time of the call in which the calling process has read processor clocks.
    sampled_bytes: int = field(default=0, init=False)  #: Largest sampled memory of all processes.

    def check_memory(self) -> TreeUsage:
        """Return a sample of the resource use; MethodFailureError beyond the memory limit."""
        usage = self.monitor.memory.usage()
        self.sampled_bytes = max(self.sampled_bytes, usage.rss_bytes)
        return usage

    def end(self) -> Measurement:
        """Return the measurement, after the answer and its files were read.

        MethodFailureError if the peak was beyond the memory limit, also between two samples.
        """
        answer_s = self.monitor.clock.end()  # first after the answer: `end` compares this time with that of the kernel
        answered_s = time.monotonic()
        total_cpu_s = self.monitor.memory.tree.cpu_s()
        end_s = time.monotonic()
        answer_s += end_s - answered_s
        waited_s = float(np.max(waits_for_processor_s(self.monitor.pid) - self.waits_s, initial=0.0))
        waited_s += self.reading_s + end_s - answered_s
        now = self.check_memory()
        # the peak covers only the method itself; the sampled sum includes its child processes
        peak = peak_of(running_thread(self.monitor.pid))
        peak = None if peak is None else max(peak, self.sampled_bytes)
        if peak is not None:
            self.monitor.memory.check(peak, "had")
        base_bytes = self.monitor.base_bytes
        above_idle = None if peak is None or base_bytes is None else memory_above_idle(peak, base_bytes)
        return Measurement(
            answer_s=answer_s,
            usage=CallUsage(answer_s + self.charged_s, peak, above_idle),
            tree=now,
            cpu_s=now.cpu_s - self.begin.cpu_s,
            cpu_between_s=self.between_s,
            waited_s=waited_s,
            end_s=end_s,
            total_cpu_s=total_cpu_s,
        )


class CallFindings:
    """Findings that several calls show: a leak of memory, and misstated times."""

    def __init__(self) -> None:
        self._resident_bytes: deque[int] = deque(maxlen=LEAK_CALLS)
        self._measured_s = self._stated_s = self._waited_s = 0.0  # summed over the calls since the last finding
        self._calls = 0

    def add(self, measured: Measurement, stated_s: float) -> tuple[CallFinding, ...]:
        """Add a call, whose time the method stated; return the findings."""
        self._resident_bytes.append(measured.tree.rss_bytes)
        self._measured_s += measured.answer_s
        self._stated_s += stated_s
        self._waited_s += measured.waited_s
        self._calls += 1
        return tuple(finding for finding in (self._leak(), self._misstatement()) if finding is not None)

    def _leak(self) -> CallFinding | None:
        finding = leak_in(self._resident_bytes)
        if finding is not None:
            self._resident_bytes.clear()  # each growth is reported once
        return finding

    def _misstatement(self) -> CallFinding | None:
        if not is_misstated(self._measured_s, self._stated_s, self._calls, self._waited_s):
            return None
        text = f"reports {self._stated_s:.3f} s for calls that took {self._measured_s:.3f} s from request to answer"
        self._measured_s = self._stated_s = self._waited_s = 0.0
        self._calls = 0
        return CallFinding(FindingKind.MISSTATED, text)
