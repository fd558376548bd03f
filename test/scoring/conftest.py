from __future__ import annotations

from pathlib import Path

import pytest

from helpers.straight_drive import straight
from sfr_loc_map.io.tables.trajectory_file import save_trajectory


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate that is 0.1 % short, and its truth."""
    paths = tmp_path / "estimate.csv", tmp_path / "truth.csv"
    for path, scale in zip(paths, (0.999, 1.0), strict=True):
        save_trajectory(path, straight(scale=scale))
    return paths
