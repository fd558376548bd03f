"""Files that the commands score: a straight drive, a drive over hills, and sources with images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.judge import LONG, SKY_ROWS, STEP_M, Judge
from helpers.made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, loc_pair, nav_pair, true_cloud
from helpers.scored_drives import write_files
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.layouts.folder import FolderWriter


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate that is 0.09 % short, and its truth."""
    return write_files(tmp_path)


@pytest.fixture
def judge(sfr: Sfr, tmp_path: Path) -> Judge:
    """A drive of 60 m and its estimate; `judge(limits=...)` scores files of them."""
    return Judge(sfr, tmp_path)


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 12 pairs, and two mapping pairs whose upper rows see the sky."""
    path = tmp_path_factory.mktemp("sky") / "source"
    with FolderWriter(path, loc=True, nav=True) as writer:
        writer.write_loc_rig(LOC_RIG)
        writer.write_nav_rig(NAV_RIG)
        for index in range(12):
            writer.write_truth(loc_pair(index).stamp_ns, np.array([0.02 * index, 0.0, 0.0]), np.array([0, 0, 0, 1.0]))
            writer.write_loc_pair(loc_pair(index))
        for pair in (nav_pair(0), nav_pair(1)):
            assert pair.truth is not None
            pair.truth[:SKY_ROWS] = np.nan
            writer.write_nav_pair(pair)
    return path


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """Each pixel of two mapping pairs on its true point, those of the sky too."""
    save_cloud(tmp_path / "cloud.ply", PointCloud.concatenate([true_cloud(0), true_cloud(1)]))
    return tmp_path / "cloud.ply"


@pytest.fixture(scope="session")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 101 images whose ground truth ends after half of them, and one with the truth of all."""
    folder, first = tmp_path_factory.mktemp("images"), loc_pair(0)
    for name, known in (("half", LONG // 2), ("all", LONG)):
        with FolderWriter(folder / name, loc=True, nav=False) as writer:
            writer.write_loc_rig(LOC_RIG)
            for index in range(LONG):
                pair = replace(first, stamp_ns=START_NS + index * PERIOD_NS)
                if index < known:
                    writer.write_truth(pair.stamp_ns, np.array([STEP_M * index, 0.0, 0.0]), np.array([0, 0, 0, 1.0]))
                writer.write_loc_pair(pair)
    return folder


@pytest.fixture
def localised() -> Trajectory:
    """An estimate of each image of the long drive that errs by millimetres."""
    stamps = START_NS + PERIOD_NS * np.arange(LONG, dtype=np.int64)
    noise = np.cumsum(np.random.default_rng(2).normal(0.0, 0.0003, (LONG, 3)), axis=0)
    positions = noise + np.outer(STEP_M * np.arange(LONG), [1.0, 0.0, 0.0])
    return Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (LONG, 1)))
