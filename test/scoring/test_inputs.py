"""The inputs of a score: the calls beside an estimate belong to it, whoever scores it."""

from pathlib import Path

import pytest

from helpers.scored_drives import straight
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.score_run import score_run


def test_calls_beside_an_estimate_are_read_unless_others_are_named(tmp_path: Path) -> None:
    estimate, truth, other = (tmp_path / name for name in ("drive.csv", "truth.csv", "other.csv"))
    assert ScoreInputs.of(estimate, truth).stats == ()
    beside = tmp_path / "drive.stats.csv"
    beside.touch()
    assert ScoreInputs.of(estimate, truth).stats == (beside,)
    assert ScoreInputs.of(estimate, truth, [other]).stats == (other,)


def test_an_estimate_that_is_replaced_while_it_is_scored_is_refused(tmp_path: Path) -> None:
    """The provenance would otherwise have the hash of a file that nobody scored."""
    estimate, other, truth = (tmp_path / name for name in ("estimate.csv", "other.csv", "truth.csv"))
    link = tmp_path / "link.csv"
    for path, scale in ((estimate, 0.999), (other, 0.9), (truth, 1.0)):
        save_trajectory(path, straight(scale=scale))
    link.symlink_to(estimate)
    run = load_run(ScoreInputs.of(link, truth))
    assert score_run(run, ScoreConfig()).provenance is not None
    link.unlink()
    link.symlink_to(other)
    with pytest.raises(InputError, match="changed or replaced while it was scored"):
        score_run(run, ScoreConfig())
