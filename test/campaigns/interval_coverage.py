"""Coverage of the 95 % interval of mean + 3 sigma: `python -m campaigns interval-coverage [RUNS]`.

The odometry of the drives drifts by a known law: every step adds an error of position and attitude. The true value is
computed from many independent drives. The results are in measurements/metrics_the_95_interval.md.
"""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.results import TrajectoryResult
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.trajectory_score import score_trajectory

STEP_M = 0.1
FIGURES = ("position", "attitude", "heading")
LAWS = {"white steps": (0.0, 0.0), "biased steps": (0.002, 0.0), "steps with memory": (0.0, 0.9)}
"""Bias of a step, m, and correlation with the previous step."""


def run(rng: np.random.Generator, frames: int, spacing: int, law: str, curved: bool) -> TrajectoryResult:
    """Return the score of one drive."""
    bias, memory = LAWS[law]
    yaw = np.sin(np.arange(frames) / 40.0) if curved else np.zeros(frames)
    true = Rotation.from_rotvec(np.column_stack((0 * yaw, 0 * yaw, yaw)))
    moves = true.apply(np.tile([STEP_M, 0.0, 0.0], (frames, 1)))
    noise = rng.normal(0, 1.0, (frames, 6)) * [2e-3, 1e-3, 1e-3, 2e-4, 2e-4, 4e-4]
    for k in range(1, frames):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    turned = Rotation.from_rotvec(np.cumsum(noise[:, 3:], axis=0))
    estimated = np.cumsum(turned.apply(moves * (1 + bias / STEP_M) + noise[:, :3]), axis=0)
    stamps = np.arange(frames) * 100_000_000
    truth = Trajectory(stamps, np.cumsum(moves, axis=0), true.as_quat())
    estimates = Estimates.of(Trajectory(stamps, estimated, (turned * true).as_quat()))
    return score_trajectory(estimates, truth, TrajectoryScoreConfig(spacing=spacing))


def coverage(runs: int, length_m: float, spacing: int, law: str, curved: bool, seed: int = 0) -> dict[str, float]:
    """Return the fraction of runs whose interval contains the true value, by figure; NaN without intervals."""
    rng, frames, errors = np.random.default_rng(seed), round(length_m / STEP_M) + 1, []
    for _ in range(max(300, 120_000 // frames)):
        details = run(rng, frames, 10, law, curved).details
        assert details is not None
        found = details.sub_trajectories[0]
        columns = (found.x_m, found.y_m, found.z_m, found.attitude_deg, found.heading_deg)
        errors.append(np.column_stack([np.array(values, np.float64) for values in columns]))
    pooled = np.concatenate(errors)
    mean, sigma = pooled.mean(axis=0), pooled.std(axis=0)
    values = (np.linalg.norm(mean[:3]) + 3 * np.linalg.norm(sigma[:3]), *(np.abs(mean[3:]) + 3 * sigma[3:]))
    target, held = dict(zip(FIGURES, map(float, values), strict=True)), {name: [] for name in FIGURES}
    for _ in range(runs):
        scored = run(rng, frames, spacing, law, curved)
        got = Score(figures=scored.figures, association=scored.association)
        for name in FIGURES:
            row = got.figure(name)
            interval = None if row is None else row.interval
            if interval is not None:
                held[name].append(interval[0] <= target[name] <= interval[1])
    return {name: float(np.mean(values)) if values else float("nan") for name, values in held.items()}


def main(arguments: list[str]) -> int:
    """Print the coverage for path lengths, spacings and laws, with `RUNS` drives each (300)."""
    runs = int(arguments[0]) if arguments else 300
    for seed, case in enumerate(itertools.product((15.0, 30.0, 60.0, 200.0), (1, 10), LAWS, (False, True)), 1):
        print(*case, coverage(runs, *case, seed), flush=True)
    return 0
