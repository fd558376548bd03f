"""Findings that several calls of a method show: a leak and misstated times."""

import math
import os
import time

from sfr_loc_map.methods.call_monitor import LEAK_CALLS, MB, CallMonitor, ProcessMemory, is_misstated, leak_in
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.process_tree import ProcessTree


def test_a_growth_over_all_calls_is_a_leak_and_a_saw_tooth_is_none() -> None:
    tooth = [90 * MB * (number % 4) for number in range(LEAK_CALLS)]
    assert not leak_in(tooth)
    leak = leak_in([level + 2 * number * MB for number, level in enumerate(tooth)])
    assert leak is not None
    assert leak.kind is FindingKind.LEAKING


def test_a_window_that_fills_and_then_stays_flat_is_no_leak() -> None:
    """The memory of our own localiser without a warm-up: libraries and a window of 30 keyframes, then 0.1 MB."""
    filling = [165 * MB + min(number, 30) * 1_300_000 + number // 40 * MB // 10 for number in range(210)]
    windows = range(LEAK_CALLS, len(filling) + 1)
    assert not any(leak_in(filling[last - LEAK_CALLS : last]) for last in windows)
    leaking = [level + 2 * MB * max(number - 40, 0) for number, level in enumerate(filling)]
    assert any(leak_in(leaking[last - LEAK_CALLS : last]) for last in windows)


def test_a_transfer_of_the_result_is_no_misstatement() -> None:
    assert not is_misstated(measured_s=0.9, stated_s=0.1, calls=20)  # one delayed call
    assert not is_misstated(measured_s=26.0, stated_s=16.0, calls=20)  # less than half of the calls
    assert not is_misstated(measured_s=2.0, stated_s=0.008, calls=400)  # a fast method in a long drive
    assert is_misstated(measured_s=1.6, stated_s=0.16, calls=20)
    assert not is_misstated(measured_s=1.6, stated_s=0.16, calls=20, waited_s=1.2)  # of a busy host
    assert is_misstated(measured_s=9.6, stated_s=0.16, calls=20, waited_s=8.0)  # 1.6 s of work on the same host
    assert is_misstated(measured_s=0.10, stated_s=3.00, calls=20)


def test_a_stated_time_that_is_not_a_number_is_a_misstatement() -> None:
    assert is_misstated(measured_s=0.1, stated_s=math.nan, calls=1)


class _SlowlyRead(ProcessTree):
    """A tree whose processes work while their clocks are read: a long loop over many processes."""

    worked_s = 0.0

    def cpu_s(self) -> float:
        read_s = self.worked_s
        time.sleep(0.03)
        self.worked_s += 0.03
        return read_s


def test_work_while_processor_clocks_are_read_is_part_of_the_calls() -> None:
    tree = _SlowlyRead(os.getpid())
    monitor = CallMonitor(ProcessMemory(tree, lambda: 0, 10**6), os.getpid(), None, keeps_rate=False)
    worked_s = tree.worked_s
    first = monitor.begin_call(None).end()
    second = monitor.begin_call(first).end()
    worked_s = tree.worked_s - worked_s
    before_first_s = after_last_s = 0.03  # samples of memory before the first and after the last call
    assert first.usage.processing_time_s + second.usage.processing_time_s > worked_s - before_first_s - after_last_s
    assert first.waited_s >= 0.06  # which is not a misstatement of the method
