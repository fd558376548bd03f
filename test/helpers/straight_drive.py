"""A straight drive at 10 Hz in steps of 0.1 m, and limits on it: what the tests of scores begin with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from sfr_loc_map.geometry.trajectory import Trajectory

PERIOD_NS = 100_000_000
COUNT = 300
POSITION = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.05}]}


def straight(count: int = COUNT, scale: float = 1.0) -> Trajectory:
    """Return the drive along x, its steps times a scale."""
    positions = np.column_stack((0.1 * scale * np.arange(count), np.zeros((count, 2))))
    return Trajectory(np.arange(count) * PERIOD_NS, positions, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))


def limits(folder: Path, content: object) -> Path:
    """Write a limits file."""
    path = folder / "limits.yaml"
    path.write_text(yaml.safe_dump(content))
    return path
