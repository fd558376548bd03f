"""The score of a small drive."""

import pytest

from helpers.made_suites import straight
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.score_run import score_files


@pytest.fixture(scope="session")
def score(tmp_path_factory: pytest.TempPathFactory) -> Score:
    folder = tmp_path_factory.mktemp("drive")
    save_trajectory(folder / "truth.csv", straight(60, 0.0, 0))
    save_trajectory(folder / "estimate.csv", straight(60, 0.001, 1))
    config = ScoreConfig(trajectory=TrajectoryScoreConfig(conditions=("distance=1",), spacing=5))
    return score_files(ScoreInputs.of(folder / "estimate.csv", folder / "truth.csv"), config)
