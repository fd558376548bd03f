"""Random drives for tests."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.results import TrajectoryResult
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

Poses = tuple[Any, Any, Any]


def drive(seed: int, count: int = 160, *, turns: bool = False, stand: bool = False, noise: float = 0.01) -> Any:
    """True poses and noisy estimates `(stamps, positions, quats)` of a random drive."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.05, 0.5, count)
    if stand:
        first = rng.integers(0, count)
        steps[first : first + rng.integers(2, count // 2)] = 0.0
    rates = rng.normal(0, 0.6 if turns else 0.05, (count, 3)) * [0.3, 0.3, 1.0]
    attitude, position = Rotation.random(random_state=seed) if turns else Rotation.identity(), np.zeros(3)
    positions, quats = [], []
    for step, rate in zip(steps, rates, strict=True):
        attitude = attitude * Rotation.from_rotvec(rate)
        position = position + attitude.apply([step, 0, 0])
        positions.append(position)
        quats.append(attitude.as_quat())
    stamps = np.cumsum(rng.integers(50_000_000, 150_000_000, count)) + 1_700_000_000_000_000_000
    positions, quats = np.array(positions), np.array(quats)
    wander = np.cumsum(rng.normal(0, noise, (count, 3)), axis=0)
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(0, noise, (count, 3)), axis=0))
    offset = Rotation.random(random_state=seed + 1)
    estimate = (
        stamps,
        offset.apply(positions + wander) + rng.normal(0, 5, 3),
        (offset * turned * Rotation.from_quat(quats)).as_quat(),
    )
    return (stamps, positions, quats), estimate


def rows(poses: Poses, which: Any) -> Any:
    return tuple(part[which] for part in poses)


def corrupted(poses: Poses, seed: int, *, keep: float = 0.9, duplicates: int = 3, shuffle: bool = True) -> Any:
    """The same poses with some lost, some given twice (with other values) and out of order."""
    rng = np.random.default_rng(seed)
    which = np.flatnonzero(rng.random(len(poses[0])) < keep)
    twice = rng.choice(which, duplicates)
    stamps, positions, quats = rows(poses, np.concatenate((which, twice)))
    positions = positions + np.where(np.arange(len(stamps)) < len(which), 0.0, 0.1)[:, None]
    order = rng.permutation(len(stamps)) if shuffle else np.argsort(stamps, kind="stable")
    return stamps[order], positions[order], quats[order] * rng.choice([-1.0, 1.0, 1.004], len(order))[:, None]


def trajectory(poses: Poses) -> Any:
    return Trajectory(poses[0].astype(np.int64), poses[1].astype(np.float64), poses[2].astype(np.float64))


def score_of(estimate: Poses, truth: Poses, config: TrajectoryScoreConfig | None = None) -> Score:
    """A score of a trajectory, by default over 5 m and 3 s."""
    config = config or TrajectoryScoreConfig(conditions=("distance=5", "time=3"))
    kept = [("position", condition) for condition in config.conditions]
    scored = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), config, kept_errors=kept)
    return as_score(scored)


def as_score(scored: TrajectoryResult) -> Score:
    """A score of a trajectory alone."""
    return Score(
        figures=scored.figures,
        association=scored.association,
        truth=scored.truth,
        errors=scored.errors,
        details=Details(trajectory=scored.details),
    )
