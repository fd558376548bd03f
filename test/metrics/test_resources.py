import time

import numpy as np
import pytest

from sfr_loc_map.metrics import calls
from sfr_loc_map.metrics.calls import METHOD_UNAVAILABLE, CallMeter

SIZE = 200 * 1024 * 1024


@pytest.mark.clause("4.2.2")
def test_known_allocation_is_measured_within_five_percent() -> None:
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip(METHOD_UNAVAILABLE)
    with meter.measure() as call:
        block = np.ones(SIZE, np.uint8)
        del block
    assert call.above_idle_bytes == pytest.approx(SIZE, rel=0.05)
    assert call.peak_rss_bytes > SIZE


@pytest.mark.clause("4.2.2")
def test_peak_of_an_earlier_call_does_not_count() -> None:
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip(METHOD_UNAVAILABLE)
    with meter.measure():
        block = np.ones(SIZE, np.uint8)
        del block
    with meter.measure() as call:
        pass
    assert call.above_idle_bytes < 0.05 * SIZE


def test_overhead_is_under_two_milliseconds() -> None:
    meter, times = CallMeter(), []
    for _ in range(50):
        begin = time.perf_counter()
        with meter.measure():
            pass
        times.append(time.perf_counter() - begin)
    assert np.median(times) < 0.002


@pytest.mark.clause("4.2.1")
def test_clock_can_be_plugged_in_and_an_error_passes() -> None:
    ticks = iter([1_000, 2_500_001_000])
    meter = CallMeter(lambda: next(ticks), "test clock")
    with pytest.raises(ValueError, match="inside"), meter.measure() as call:
        raise ValueError("inside")
    assert call.processing_time_s == pytest.approx(2.5)
    assert meter.clock == "test clock"


@pytest.mark.clause("4.2.2")
def test_without_the_kernels_mark_memory_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise OSError("no such file")

    monkeypatch.setattr(calls, "_reset_peak", refuse)
    meter = CallMeter()
    with meter.measure() as call:
        pass
    assert meter.method == METHOD_UNAVAILABLE
    assert call.peak_rss_bytes is None
    assert call.above_idle_bytes is None
    assert call.processing_time_s >= 0
