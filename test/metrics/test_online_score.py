"""A live run gives the bits of the file."""

import json
from typing import Any

import numpy as np
import pytest
from random_drives import Poses, drive, rows, spoilt, trajectory

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.records.score_details import Details
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.metrics.trajectory.association import Estimates
from sfr_loc_map.metrics.trajectory.online_score import LiveTrajectoryScore
from sfr_loc_map.metrics.trajectory.trajectory_score import ScoredTrajectory, score_trajectory

CONFIG = TrajectoryScoreConfig(conditions=("distance=5", "time=7", "frames=31", "distance=1e9"), spacing=3)


def as_json(scored: ScoredTrajectory) -> str:
    details = Details(trajectory=scored.details)
    return to_json(Score(trajectory=scored.score, details=details, verdicts=()))


def offline(estimate: Poses, truth: Poses) -> str:
    return as_json(score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), CONFIG))


def live(events: list[tuple[str, Any]], ask_every: int = 0) -> str:
    score = LiveTrajectoryScore(CONFIG)
    for number, (kind, (stamp, position, quat)) in enumerate(events):
        add = score.add_estimate if kind == "estimate" else score.add_truth
        add(int(stamp), position, quat)
        if ask_every and number % ask_every == 0:
            score.result()
    return as_json(score.result())


def stream(estimate: Poses, truth: Poses, *, truth_late_ns: int = 0, jitter_ns: int = 0, seed: int = 0) -> Any:
    """Both in the order they come: the truth late, everything with jitter."""
    rng = np.random.default_rng(seed)
    events = [("estimate", (s, p, q), s) for s, p, q in zip(*estimate, strict=True)]
    events += [("truth", (s, p, q), s + truth_late_ns) for s, p, q in zip(*truth, strict=True)]
    order = np.argsort([e[2] + rng.integers(0, jitter_ns + 1) for e in events], kind="stable")
    return [events[k][:2] for k in order]


def in_order_of(events: list[tuple[str, Any]], kind: str) -> Poses:
    """The poses of one kind in the order they came, as a recording has them."""
    poses = [pose for name, pose in events if name == kind]
    return tuple(np.array(part) for part in zip(*poses, strict=True))  # type: ignore[return-value]


@pytest.mark.parametrize("late", [0, 3_000_000_000])
@pytest.mark.parametrize("seed", range(6))
def test_live_equals_offline_bit_by_bit(seed: int, late: int) -> None:
    truth, estimate = drive(seed, 700, turns=seed % 2 == 0, stand=seed % 3 == 0)
    if seed % 2:
        estimate = spoilt(estimate, seed, duplicates=0, shuffle=False)
    if seed == 4:
        truth = rows(truth, slice(None, None, 3))
    events = stream(estimate, truth, truth_late_ns=late, jitter_ns=1_000_000_000 if seed % 3 == 1 else 0, seed=seed)
    assert live(events, ask_every=97) == offline(in_order_of(events, "estimate"), in_order_of(events, "truth"))


@pytest.mark.parametrize("shift", [37_000_000, 400])
def test_live_equals_offline_with_truth_at_another_rate(shift: int) -> None:
    truth, estimate = drive(11, 600)
    truth = (truth[0] + shift, truth[1], truth[2])
    events = stream(estimate, truth)
    got = live(events, ask_every=50)
    assert got == offline(estimate, truth)
    association = json.loads(got)["trajectory"]["association"]
    assert association["interpolated" if shift > 1000 else "near"] > 500


def test_live_equals_offline_with_duplicates() -> None:
    truth, estimate = drive(12, 500)
    events = stream(spoilt(estimate, 1, duplicates=20, shuffle=False), spoilt(truth, 2, duplicates=20, shuffle=False))
    assert live(events) == offline(in_order_of(events, "estimate"), in_order_of(events, "truth"))


def test_what_comes_after_its_time_was_scored_is_left_out_and_counted() -> None:
    truth, estimate = drive(13, 400)
    events = stream(estimate, truth)
    events.append(("estimate", tuple(part[5] for part in estimate)))
    association = json.loads(live(events))["trajectory"]["association"]
    assert (association["late"], association["estimate_poses"]) == (1, 401)


def test_before_anything_came_there_are_no_figures() -> None:
    score = LiveTrajectoryScore(CONFIG)
    score.add_estimate(5, [0.0, 0, 0], [0.0, 0, 0, 1])
    got = score.result().score
    assert (got.first.count, got.matched, got.estimate_poses) == (0, 0, 1)
    assert got.first.position_m.mean is None


def test_estimates_without_truth_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sfr_loc_map.metrics.trajectory.online_score.MAX_WAITING_POSES", 500)
    score = LiveTrajectoryScore(CONFIG)
    for k in range(3000):
        score.add_estimate(k, [0.0, 0, 0], [0.0, 0, 0, 1])
    assert len(score._estimates.stamps) <= 501
    assert score.result().score.estimate_poses == 3000


def test_poses_that_are_none_are_refused() -> None:
    score = LiveTrajectoryScore(CONFIG)
    with pytest.raises(GeometryError, match=r"pose 0 \(stamp 1\) is none"):
        score.add_truth(1, [0.0, float("nan"), 0], [0.0, 0, 0, 1])


def test_live_equals_offline_with_covariances_and_lost_stretches() -> None:
    truth, estimate = drive(14, 600)
    rng = np.random.default_rng(14)
    step = rng.normal(0, 0.01, (600, 6, 6))
    covariance = np.cumsum(step @ step.transpose(0, 2, 1), axis=0)
    lost = np.zeros(600, bool)
    lost[200:260] = True
    covariance[lost] = 9999.0 * np.eye(6)
    score = LiveTrajectoryScore(CONFIG)
    for k in range(600):
        score.add_estimate(int(estimate[0][k]), estimate[1][k], estimate[2][k], covariance[k], bool(lost[k]))
        score.add_truth(int(truth[0][k]), truth[1][k], truth[2][k])
    upper = covariance[:, *np.triu_indices(6)]
    whole = score_trajectory(Estimates.of(trajectory(estimate), lost, covariance=upper), trajectory(truth), CONFIG)
    assert as_json(score.result()) == as_json(whole)
    assert whole.score.lost == 60
    assert whole.score.first.nees is not None
    assert whole.details is not None
    assert len(whole.details.path.sigma_x_m) == 600


@pytest.mark.parametrize("ahead", [True, False])
def test_live_equals_offline_with_degraded_poses(*, ahead: bool) -> None:
    truth, estimate = drive(15, 400)
    degraded = np.random.default_rng(15).random(400) < 0.1
    score = LiveTrajectoryScore(CONFIG)
    for k in range(400):
        if degraded[k] and ahead:
            score.note_call(int(estimate[0][k]), None, degraded=True)
        score.add_estimate(int(estimate[0][k]), estimate[1][k], estimate[2][k])
        score.add_truth(int(truth[0][k]), truth[1][k], truth[2][k])
        if degraded[k] and not ahead:
            score.note_call(int(estimate[0][k]), None, degraded=True)
    offline_score = score_trajectory(Estimates.of(trajectory(estimate), None, degraded), trajectory(truth), CONFIG)
    assert score.result().score == offline_score.score
    assert offline_score.score.degraded == np.count_nonzero(degraded)


def test_live_equals_offline_with_the_covariances_of_steps() -> None:
    truth, estimate = drive(16, 600)
    rng = np.random.default_rng(16)
    roots = rng.normal(0, 0.01, (600, 6, 6))
    steps = np.column_stack(((roots @ roots.transpose(0, 2, 1))[:, *np.triu_indices(6)], rng.normal(0, 0.01, (600, 6))))
    steps[[100, 430]] = np.nan  # calls that were not received
    covariance, lost = np.broadcast_to(np.eye(6), (600, 6, 6)).copy(), np.zeros(600, bool)
    lost[200:210] = True
    covariance[lost] = 9999.0 * np.eye(6)
    score = LiveTrajectoryScore(CONFIG)
    for k in range(600):
        stamp = int(estimate[0][k])
        if np.isfinite(steps[k]).all() and not lost[k]:
            score.note_call(stamp, steps[k], degraded=False)
        score.add_estimate(stamp, estimate[1][k], estimate[2][k], covariance[k], bool(lost[k]))
        score.add_truth(int(truth[0][k]), truth[1][k], truth[2][k])
        if k % 97 == 0:
            score.result()
    upper = covariance[:, *np.triu_indices(6)]
    estimates = Estimates.of(trajectory(estimate), lost, covariance=upper, steps=steps)
    whole = score_trajectory(estimates, trajectory(truth), CONFIG)
    assert as_json(score.result()) == as_json(whole)
    nees = whole.score.first.nees
    assert nees is not None
    assert nees.from_steps > 0
    assert nees.not_usable > 0  # where a step is not known the covariance would have to grow, and does not
