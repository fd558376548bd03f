"""The live score is that of the file, whatever the order of the messages; what the monitor keeps of the calls."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import LOST_VARIANCE
from sfr_loc_map.metrics.association import UPPER, Estimates
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.score import Details, Score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.monitor_score import MAX_STAGES, MAX_STATES, CallRing, MonitorScore


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


CONFIG = TrajectoryScoreConfig(conditions=("distance=1", "frames=9"), spacing=3)
COUNT = 24
Drive = tuple[Estimates, Trajectory]


def small_drive(seed: int) -> Drive:
    """A drive with covariances, steps, lost and degraded poses; some have no truth, or one at stamps of its own."""
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.integers(50_000_000, 150_000_000, COUNT)) + 1_700_000_000_000_000_000
    positions = np.cumsum(rng.normal([0.1, 0, 0], 0.02, (COUNT, 3)), axis=0)
    half = 0.02 * np.cumsum(rng.normal(size=COUNT))
    quats = np.column_stack((0 * half, 0 * half, np.sin(half), np.cos(half)))
    roots = rng.normal(0, 0.01, (COUNT, 6, 6))
    covariance = np.cumsum(roots @ roots.transpose(0, 2, 1), axis=0)
    steps = np.column_stack(((roots @ roots.transpose(0, 2, 1))[:, *UPPER], rng.normal(0, 0.01, (COUNT, 6))))
    steps[rng.random(COUNT) < 0.1] = np.nan
    lost, degraded = rng.random(COUNT) < 0.05, rng.random(COUNT) < 0.1
    covariance[lost], steps[lost] = LOST_VARIANCE * np.eye(6), np.nan
    estimate = Trajectory(stamps, positions + np.cumsum(rng.normal(0, 0.01, (COUNT, 3)), axis=0), quats)
    shift = rng.choice([0, 400, 37_000_000])  # equal, within the tolerance, at stamps of its own
    some = np.flatnonzero(rng.random(COUNT) < 0.9)
    truth = Trajectory(stamps[some] + shift, positions[some], quats[some])
    return Estimates.of(estimate, lost, degraded, covariance[:, *UPPER], steps), truth


def messages_of(drive: Drive) -> list[tuple[str, tuple[Any, ...]]]:
    """The calls of the monitor's collector, in the order of the stamps."""
    (estimates, truth), full = drive, np.empty((COUNT, 6, 6))
    assert estimates.covariance is not None
    assert estimates.steps is not None
    full[:, *UPPER] = full[:, *UPPER[::-1]] = estimates.covariance
    poses, messages = estimates.trajectory, []
    for k, stamp in enumerate(poses.stamps_ns.tolist()):
        messages.append(("add_estimate", (stamp, poses.positions[k], poses.quats_xyzw[k], full[k])))
        state = "degraded" if estimates.degraded[k] else "lost" if estimates.lost[k] else "tracking"
        step = estimates.steps[k] if np.isfinite(estimates.steps[k]).all() else None
        messages.append(("add_call", (CallRecord(stamp, 0.1, state, None, None, step=step),)))
    for k, stamp in enumerate(truth.stamps_ns.tolist()):
        messages.append(("add_truth", (stamp, truth.positions[k], truth.quats_xyzw[k])))
    return messages


def in_order(score: Score) -> Score:
    """The score without the counts of what came out of order, and without the calls, which are in theirs."""
    assert score.trajectory is not None
    association = score.trajectory.association
    counts = replace(association.counts, estimate_unordered=0, truth_unordered=0)
    trajectory = replace(score.trajectory, association=replace(association, counts=counts))
    details = None if score.details is None else Details(trajectory=score.details.trajectory)
    return Score(trajectory=trajectory, details=details, verdicts=())


def test_two_thousand_orders_of_messages_give_the_score_of_the_file() -> None:
    """Equal, not nearly so."""
    rng, flags = np.random.default_rng(7), 0
    for seed in range(20):
        drive = small_drive(seed)
        scored, messages = score_trajectory(*drive, CONFIG), messages_of(drive)
        offline = Score(trajectory=scored.score, details=Details(trajectory=scored.details), verdicts=())
        assert scored.score.matched > 12
        flags += scored.score.lost + scored.score.degraded
        monitor = MonitorScore(ScoreConfig(CONFIG), None)
        for number in range(100):
            monitor.restart()
            asked = rng.integers(len(messages)) if number % 10 == 0 else -1
            for position, row in enumerate(rng.permutation(len(messages))):
                name, arguments = messages[row]
                getattr(monitor, name)(*arguments)
                if position == asked:
                    monitor.result(details=False)  # changes nothing
            if number % 10 == 0:
                assert in_order(monitor.result()) == offline, (seed, number)
            else:
                assert in_order(monitor.result(details=False)) == replace(offline, details=None), (seed, number)
    assert flags > 20


def test_of_poses_with_one_stamp_the_last_that_came_counts_as_in_a_file() -> None:
    estimates, truth = small_drive(3)
    rng, poses = np.random.default_rng(1), estimates.trajectory
    rows = rng.integers(0, COUNT, 3 * COUNT)
    moved = poses.positions[rows] + rng.normal(0, 0.01, (len(rows), 3))
    given = Trajectory(poses.stamps_ns[rows], moved, poses.quats_xyzw[rows])
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    for stamp, position, quat in zip(given.stamps_ns.tolist(), moved, given.quats_xyzw, strict=True):
        monitor.add_estimate(stamp, position, quat, None)
    for stamp, position, quat in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
        monitor.add_truth(stamp, position, quat)
    live = monitor.result().trajectory
    assert live == score_trajectory(Estimates.of(given), truth, CONFIG).score
    assert live.association.counts.estimate_duplicates > COUNT


def test_before_poses_have_their_truth_there_are_no_figures() -> None:
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    monitor.add_estimate(5, [0.0, 0, 0], [0.0, 0, 0, 1], None)
    assert monitor.result().trajectory is None
    monitor.add_truth(10**12, [0.0, 0, 0], [0.0, 0, 0, 1])
    got = monitor.result().trajectory
    assert got is not None
    assert (got.first.count, got.matched, got.estimate_poses, got.first.position_m.mean) == (0, 0, 1, None)


def test_poses_that_are_none_are_refused() -> None:
    with pytest.raises(GeometryError, match=r"pose 0 \(stamp 1\) is none"):
        MonitorScore(ScoreConfig(CONFIG), None).add_truth(1, [0.0, float("nan"), 0], [0.0, 0, 0, 1])
