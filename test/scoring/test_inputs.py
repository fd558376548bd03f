"""The inputs of a score: the calls beside an estimate belong to it, whoever scores it."""

from pathlib import Path

from sfr_loc_map.scoring.inputs import ScoreInputs


def test_calls_beside_an_estimate_are_read_unless_others_are_named(tmp_path: Path) -> None:
    estimate, truth, other = (tmp_path / name for name in ("drive.csv", "truth.csv", "other.csv"))
    assert ScoreInputs.of(estimate, truth).stats == ()
    beside = tmp_path / "drive.stats.csv"
    beside.touch()
    assert ScoreInputs.of(estimate, truth).stats == (beside,)
    assert ScoreInputs.of(estimate, truth, [other]).stats == (other,)
