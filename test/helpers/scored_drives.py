"""Drives of 300 poses at 10 Hz in steps of 0.1 m, files of limits on them, and files of their calls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory

PERIOD_NS = 100_000_000
COUNT = 300
SHORT = 0.9991
"""Scale of an estimate that is 0.09 % short. Errors above 0.1 % would start the slow diagnosis of conventions."""
POSITION = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.05}]}
LOOSE = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}]}


def straight(count: int = COUNT, scale: float = 1.0) -> Trajectory:
    """Return the drive along x, its steps times a scale."""
    positions = np.column_stack((0.1 * scale * np.arange(count), np.zeros((count, 2))))
    return Trajectory(np.arange(count) * PERIOD_NS, positions, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))


def write_files(folder: Path) -> tuple[Path, Path]:
    """Write an estimate of the straight drive that is 0.09 % short, and its truth."""
    paths = folder / "estimate.csv", folder / "truth.csv"
    for path, scale in zip(paths, (SHORT, 1.0), strict=True):
        save_trajectory(path, straight(scale=scale))
    return paths


def wandering(sigma_m: float, seed: int = 1, count: int = COUNT) -> Trajectory:
    """Return a bend with steps of 0.1 m and a random walk of position and heading."""
    rng, heading = np.random.default_rng(seed), np.linspace(0.0, 2.0, count)
    steps = 0.1 * np.column_stack((np.cos(heading), np.sin(heading), 0.2 * np.sin(8.0 * heading)))
    positions = np.cumsum(steps + rng.normal(0.0, sigma_m, (count, 3)), axis=0)
    turned = 0.5 * (heading + np.cumsum(rng.normal(0.0, sigma_m, count)))
    quats = np.column_stack((np.zeros((count, 2)), np.sin(turned), np.cos(turned)))
    return Trajectory(np.arange(count) * PERIOD_NS, positions, quats)


def limits(folder: Path, content: object) -> Path:
    """Write a limits file."""
    path = folder / "limits.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def write_calls(path: Path, rows: range, lost: range = range(0), seconds: float = 0.01) -> Path:
    """Write the calls of the poses of some rows; the calls of `lost` rows are lost."""
    lines = [f"{row * PERIOD_NS},{seconds},{'lost' if row in lost else 'tracking'},1000" for row in rows]
    path.write_text("\n".join(["stamp_ns,processing_time_s,state,peak_rss_bytes", *lines]) + "\n")
    return path


def write_calls_of(path: Path, method: str, finding: str = "") -> Path:
    """Write a call of a method for each pose; call 5 has a finding."""
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind,finding"
    lines = [f"{row * PERIOD_NS},0.1,tracking,{method},1,python,{finding * (row == 5)}" for row in range(COUNT)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path
