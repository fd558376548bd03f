"""Coverage of the 95 % interval of mean + 3 sigma: `python -m campaigns interval-coverage [RUNS]`.

The odometry of the drives drifts by a known law: every step adds an error of position and attitude. The true value is
computed from many independent drives. The results are in measurements/metrics_the_95_interval.md.
"""

import itertools

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.formulas import Poses, pose_reading
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

STEP_M, SPAN = 0.1, 50  #: Length of a step, and steps of a sub-trajectory of 5 m.
FIGURES = ("position", "attitude", "heading")
LAWS = {"white steps": (0.0, 0.0), "biased steps": (0.002, 0.0), "steps with memory": (0.0, 0.9)}
"""Bias of a step, m, and correlation with the previous step."""


def drive(rng: np.random.Generator, frames: int, law: str, curved: bool) -> tuple[Trajectory, Trajectory]:
    """Return the estimate and the truth of one drive."""
    bias, memory = LAWS[law]
    yaw = np.sin(np.arange(frames) / 40.0) if curved else np.zeros(frames)
    true = Rotation.from_rotvec(np.column_stack((0 * yaw, 0 * yaw, yaw)))
    moves = true.apply(np.tile([STEP_M, 0.0, 0.0], (frames, 1)))
    noise = rng.normal(0, 1.0, (frames, 6)) * [2e-3, 1e-3, 1e-3, 2e-4, 2e-4, 4e-4]
    share = [np.sqrt(1 - memory**2)]
    noise[1:] = lfilter(share, [1.0, -memory], noise[1:], axis=0, zi=memory * noise[:1])[0]
    turned = Rotation.from_rotvec(np.cumsum(noise[:, 3:], axis=0))
    estimated = np.cumsum(turned.apply(moves * (1 + bias / STEP_M) + noise[:, :3]), axis=0)
    stamps = np.arange(frames) * 100_000_000
    estimate = Trajectory(stamps, estimated, (turned * true).as_quat())
    return estimate, Trajectory(stamps, np.cumsum(moves, axis=0), true.as_quat())


def true_figures(rng: np.random.Generator, frames: int, law: str, curved: bool) -> dict[str, float]:
    """Return mean + 3 sigma over 5 m of at least 300 drives and 120 000 frames, by figure."""
    errors = []
    starts = np.arange(0, frames - SPAN, 10)
    for _ in range(max(300, 120_000 // frames)):
        estimate, truth = drive(rng, frames, law, curved)
        poses = Poses(truth.positions, truth.quats_xyzw, estimate.positions, estimate.quats_xyzw)
        errors.append(np.column_stack(pose_reading(poses, starts, starts + SPAN)))
    pooled = np.concatenate(errors)
    mean, sigma = pooled.mean(axis=0), pooled.std(axis=0)
    values = (np.linalg.norm(mean[:3]) + 3 * np.linalg.norm(sigma[:3]), *(np.abs(mean[3:]) + 3 * sigma[3:]))
    return dict(zip(FIGURES, map(float, values), strict=True))


def coverage(runs: int, length_m: float, spacing: int, law: str, curved: bool, seed: int = 0) -> dict[str, float]:
    """Return the fraction of runs whose interval contains the true value, by figure; NaN without intervals."""
    rng, frames = np.random.default_rng(seed), round(length_m / STEP_M) + 1
    target, held = true_figures(rng, frames, law, curved), {name: [] for name in FIGURES}
    for _ in range(runs):
        estimate, truth = drive(rng, frames, law, curved)
        scored = score_trajectory(Estimates.of(estimate), truth, TrajectoryScoreConfig(spacing=spacing))
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
