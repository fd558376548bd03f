"""The worked example of docs/metrics.md."""

import numpy as np
import pytest

from helpers.random_drives import as_score
from helpers.scored_drives import straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory


@pytest.mark.parametrize(("certain", "state"), [(False, "pass"), (True, "not enough data")])
def test_the_worked_example_has_its_numbers(certain: bool, state: str) -> None:
    """An estimate that is 1 % short over 15 m and 0.2 % short over the other 15 m."""
    truth = straight(301)
    steps = np.diff(truth.positions, axis=0)
    steps[:150] *= 0.99
    steps[150:] *= 0.998
    positions = np.vstack((truth.positions[:1], np.cumsum(steps, axis=0)))
    estimate = Trajectory(truth.stamps_ns, positions, truth.quats_xyzw)
    entry = {"condition": "distance=5", "position_mean_plus_3sigma_m": 0.1, "certain": certain}
    scored = score_trajectory(Estimates.of(estimate), truth, TrajectoryScoreConfig())
    score = judged_by(as_score(scored), parse_limits({"trajectory": [entry]}, "limits"))
    row = score.judged_row("position")
    assert row is not None
    assert (row.n, row.independent) == (26, pytest.approx(5.2))
    assert (row.mean, row.sigma) == (pytest.approx(0.03), pytest.approx(0.0191, abs=5e-5))
    assert row.mean_plus_3sigma == pytest.approx(0.0873, abs=5e-5)
    assert row.interval == pytest.approx((0.058, 0.138), abs=1e-3)
    assert score.number("truth_error", condition=None) == 0.0
    assert (score.number("judged", part="drive"), score.incomplete) == (1.0, None)
    assert [item.state for item in score.verdicts] == [state]
    assert score.on_limits[0].certain is False
