"""What the monitor keeps of the calls."""

from dataclasses import replace

import numpy as np
import pytest

from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.call_ring import MAX_STAGES, MAX_STATES, CallRing
from sfr_loc_map.pipeline.online.monitor_score import MonitorScore


def record(number: int, state: str = "tracking", peak: int | None = None) -> CallRecord:
    return CallRecord(number, 0.1 * number, state, peak, None if peak is None else peak // 2)


@pytest.mark.parametrize("given", [0, 1, 4, 5, 6, 13])
def test_the_last_calls_come_back_in_their_order(given: int) -> None:
    ring = CallRing(5)
    for number in range(given):
        ring.add(record(number, "lost" if number % 3 == 0 else "tracking", peak=number if number % 2 else None))
    kept = list(range(max(given - 5, 0), given))
    calls = ring.calls()
    assert len(ring) == len(kept)
    assert calls.stamps_ns.tolist() == kept
    assert calls.seconds.tolist() == [0.1 * number for number in kept]
    assert calls.states == ["lost" if number % 3 == 0 else "tracking" for number in kept]
    assert np.array_equal(calls.peak_bytes, [number if number % 2 else np.nan for number in kept], equal_nan=True)
    assert np.array_equal(calls.above_idle_bytes, [n // 2 if n % 2 else np.nan for n in kept], equal_nan=True)
    ring.clear()
    assert len(ring) == len(ring.calls().states) == 0


def test_stages_come_back_with_their_calls_and_have_an_end() -> None:
    ring = CallRing(4)
    for number in range(6):
        figures = {"stage_align_s": 0.5 * number, "features": 7.0} if number % 2 else {}
        ring.add(CallRecord(number, 1.0, "tracking", None, None, figures))
    stages = ring.calls().stage_s
    assert stages.keys() == {"align"}
    assert np.array_equal(stages["align"], [np.nan, 1.5, np.nan, 2.5], equal_nan=True)
    for number in range(50):
        ring.add(CallRecord(number, 1.0, "tracking", None, None, {f"stage_{number}_s": 1.0}))
    assert len(ring.calls().stage_s) == MAX_STAGES


def test_invented_states_have_an_end() -> None:
    ring = CallRing(1000)
    for number in range(500):
        ring.add(record(number, f"word {number}"))
    words = ring.calls().states
    assert words[:3] == ["word 0", "word 1", "word 2"]
    assert len(set(words)) == MAX_STATES


def test_without_details_the_score_is_the_same_but_for_them() -> None:
    score = MonitorScore(ScoreConfig(TrajectoryScoreConfig(conditions=("frames=5",), spacing=1)), None)
    random = np.random.default_rng(4)
    for number in range(200):
        stamp_ns, place = 1_000_000_000 * number, (0.1 * number, 0.0, 0.0)
        noisy = tuple(place + 0.01 * random.normal(size=3))
        score.add_truth(stamp_ns, place, (0.0, 0.0, 0.0, 1.0))
        score.add_estimate(stamp_ns, noisy, (0.0, 0.0, 0.0, 1.0), np.eye(6))
        score.add_call(record(stamp_ns))
    whole = score.result()
    assert whole.details is not None
    assert None not in (whole.details.trajectory, whole.details.calls)
    assert score.result(details=False) == replace(whole, details=None)
    assert whole.trajectory is not None
    assert whole.trajectory.first.position_m.mean is not None
    assert whole.trajectory.first.position_m.mean > 0.0
