"""Messages of a small drive in random orders, whose live score must be that of the file."""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec.structs import replace as struct_replace

from helpers.random_drives import as_score
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.results import TrajectoryResult
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.scoring.live.live_score import LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore

CONFIG = TrajectoryScoreConfig(conditions=("distance=0.5",), spacing=3)
COUNT = 14
OF_CALLS = ("calls_", "judged calls", "judged memory")
OF_LIVE = ("judged live", "dropped", "restarts", "publisher_changes")
Drive = tuple[Estimates, Trajectory]


def small_drive(seed: int) -> Drive:
    """A drive with covariances, steps, lost and degraded poses; some have no truth, or one at stamps of its own."""
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.integers(50_000_000, 150_000_000, COUNT)) + 1_700_000_000_000_000_000
    positions = np.cumsum(rng.normal([0.1, 0, 0], 0.02, (COUNT, 3)), axis=0)
    half = 0.02 * np.cumsum(rng.normal(size=COUNT))
    quats = np.column_stack((0.01 + 0 * half, 0 * half, np.sin(half), np.cos(half)))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    roots = rng.normal(0, 0.01, (COUNT, 6, 6))
    covariance = np.cumsum(roots @ roots.transpose(0, 2, 1), axis=0)
    upper = (roots @ roots.transpose(0, 2, 1))[:, *UPPER]
    steps = np.column_stack((upper, rng.normal(0, 0.01, (COUNT, 6)), upper[::-1]))
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
        messages.append(("add_call", (CallRecord(stamp, 0.1, state, step=step),)))
    for k, stamp in enumerate(truth.stamps_ns.tolist()):
        messages.append(("add_truth", (stamp, truth.positions[k], truth.quats_xyzw[k])))
    return messages


def in_order(score: Score) -> Score:
    """The score without the calls, which are in their order, and without the counts of the order and of live runs."""
    assert score.association is not None
    association = struct_replace(score.association, estimate_unordered=0, truth_unordered=0)
    details = None if score.details is None else Details(trajectory=score.details.trajectory)
    kept = [row for row in score.figures if row.subject not in ("timing", "memory")]
    figures = tuple(row for row in kept if not f"{row.figure} {row.part}".startswith(OF_CALLS + OF_LIVE))
    made = Score(figures=figures, association=association, truth=score.truth, details=details)
    return struct_replace(made, incomplete=score.incomplete, verdict=score.verdict)


def without_path(score: Score) -> Score:
    """The score without the frames, which the report of a run that goes on leaves out."""
    assert score.details is not None
    assert score.details.trajectory is not None
    return struct_replace(score, details=Details(trajectory=struct_replace(score.details.trajectory, path=None)))


def of_file(scored: TrajectoryResult) -> Score:
    return judged_by(as_score(scored), None)


def check_orders(seed: int, orders: int) -> int:
    """Check that the score of each random order is that of the file; return the number of lost and degraded poses.

    In the first order a result is also asked for in the middle, which must change nothing. The score is compared to the
    last digit.
    """
    rng, drive = np.random.default_rng(seed), small_drive(seed)
    scored, messages = score_trajectory(*drive, CONFIG), messages_of(drive)
    offline = of_file(scored)
    assert scored.association.matched > 6
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    for number in range(orders):
        monitor.restart()
        asked = rng.integers(len(messages)) if number == 0 else -1
        for position, row in enumerate(rng.permutation(len(messages))):
            name, arguments = messages[row]
            getattr(monitor, name)(*arguments)
            if position == asked:
                monitor.result(LiveRun(details=False))
        if number == 0:
            assert in_order(monitor.result()) == offline, (seed, number)
        else:
            assert in_order(monitor.result(LiveRun(details=False))) == without_path(offline), (seed, number)
    return scored.association.lost + scored.association.degraded
