"""Time and memory of calls: measured one by one, by hand, told apart by kind, under the name of their clock."""

import numpy as np
import pytest

from sfr_loc_map.metrics import calls as module
from sfr_loc_map.metrics.calls import (
    HOST_CLOCK,
    METHOD_UNAVAILABLE,
    CallMeter,
    Calls,
    call_score,
    score_calls,
    score_target,
)
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import MemoryScore, PeakMemory

SIZE = 200 * 1024 * 1024


@pytest.mark.clause("4.2.2")
def test_a_known_allocation_is_measured_and_that_of_an_earlier_call_is_not() -> None:
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip(METHOD_UNAVAILABLE)
    with meter.measure() as call:
        np.ones(SIZE, np.uint8)
    assert call.above_idle_bytes == pytest.approx(SIZE, rel=0.01)
    assert (call.peak_rss_bytes or 0) > SIZE
    with meter.measure() as call:
        pass
    assert (call.above_idle_bytes or 0) < 0.05 * SIZE


@pytest.mark.clause("4.2.1", "4.2.2")
def test_a_clock_can_be_plugged_in_an_error_passes_and_memory_may_be_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> None:
        raise OSError("no such file")

    monkeypatch.setattr(module, "_reset_peak", refused)
    ticks = iter([1_000, 2_500_001_000])
    meter = CallMeter(lambda: next(ticks), "test clock")
    with pytest.raises(ValueError, match="inside"), meter.measure() as call:
        raise ValueError("inside")
    assert call.processing_time_s == pytest.approx(2.5)
    assert (meter.clock, meter.method) == ("test clock", METHOD_UNAVAILABLE)
    assert (call.peak_rss_bytes, call.above_idle_bytes) == (None, None)


def calls(
    states: list[str], seconds: list[float] | np.ndarray, peak: list[float] | None = None, **stages: list[float]
) -> Calls:
    """Calls; memory is not measured unless it is given."""
    peaks = np.full(len(states), np.nan) if peak is None else np.array(peak)
    named = {name: np.array(values) for name, values in stages.items()}
    return Calls(np.arange(len(states)), np.array(seconds), states, peaks, peaks / 10.0, named)


@pytest.mark.clause("4.2.1")
def test_figures_by_hand() -> None:
    got = call_score(np.array([5.0, 1.0, 2.0, 3.0, np.nan]), HOST_CLOCK)
    assert (got.count, got.mean, got.clock) == (4, 2.75, "host monotonic")
    assert got.sigma == pytest.approx(np.sqrt(8.75 / 3))
    assert got.mean_plus_3sigma == pytest.approx(2.75 + 3 * np.sqrt(8.75 / 3))
    assert (got.p50, got.max, got.first, got.max_after_first) == (2.5, 5.0, 5.0, 3.0)
    assert call_score(np.empty(0), HOST_CLOCK).mean is None


@pytest.mark.clause("4.2.1", "4.3.1", "4.2.2", "4.3.2")
def test_localisation_mapping_and_fusion_are_told_apart() -> None:
    states = ["initialising", "tracking", "mapped", "mapped", "fused"]
    got = score_calls(calls(states, [1.0, 2.0, 3.0, 4.0, 5.0], [10.0, 30.0, 20.0, np.nan, 5.0]))
    timing, memory = dict(got.timing.kinds()), got.memory
    assert (timing[CallKind.LOCALISATION].mean, timing[CallKind.MAPPING].max) == (1.5, 4.0)
    assert timing[CallKind.FUSION].count == 1
    assert memory.localisation == PeakMemory(peak_bytes=30, above_idle_bytes=3)
    assert memory.mapping == PeakMemory(peak_bytes=20, above_idle_bytes=2)
    unknown = score_calls(calls(["tracking", "lost"], [1.0, 1.0])).memory
    assert unknown.localisation == PeakMemory(peak_bytes=None, above_idle_bytes=None)
    assert (unknown.mapping, unknown.method) == (None, METHOD_UNAVAILABLE)


@pytest.mark.clause("4.2.1", "4.2.2")
def test_a_target_stands_under_its_own_name() -> None:
    unmeasured = score_target(calls([""], [1.0]), "GR740")
    assert unmeasured.timing.localisation is not None
    assert unmeasured.timing.localisation.clock == "GR740"
    assert unmeasured.memory == MemoryScore()
    assert score_target(calls([""], [1.0], [7.0]), "GR740").memory.method == "as measured on GR740"
