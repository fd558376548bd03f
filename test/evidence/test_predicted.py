"""The predicted error of a straight drive, whose parts are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.evidence.check_tables import PREDICTED_TABLE
from sfr_loc_map.evidence.localiser_runs import ComparedRun
from sfr_loc_map.evidence.predicted import PredictedSource, predicted_rows
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import STEP_SIZE, UPPER
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.consistency import relative_covariance, sums_of_steps

COUNT, STEP_M, OVER = 60, 0.1, 20
STEP_SIGMA_M, NOISE_M, ALONG_M, TURN_RAD = 2e-3, 3e-3, 5e-4, 1e-4
CONDITION = Condition.parse(f"frames={OVER}")


def straight_run() -> ComparedRun:
    """Return a drive along x whose steps state each of the sources."""
    positions = STEP_M * np.arange(COUNT)[:, None] * [1.0, 0.0, 0.0]
    poses = Trajectory(np.arange(1, COUNT + 1) * 100_000_000, positions, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))
    steps = np.zeros((COUNT, STEP_SIZE))
    steps[:, :21] = np.diag([STEP_SIGMA_M**2] * 3 + [0.0] * 3)[UPPER]
    steps[:, 21] = ALONG_M
    steps[:, 26] = TURN_RAD
    steps[:, 27:] = np.diag([NOISE_M**2] * 3 + [0.0] * 3)[UPPER]
    return ComparedRun("straight", Estimates.of(poses, steps=steps))


def test_each_source_has_its_part_in_closed_form_and_the_parts_add_up() -> None:
    score = Score(figures=tuple(predicted_rows(straight_run(), CONDITION)))
    found = {source: score.number("predicted", "value", part=source.value) for source in PredictedSource}
    assert found[PredictedSource.STEPS] == pytest.approx(STEP_SIGMA_M * np.sqrt(3 * OVER))
    assert found[PredictedSource.NOISE] == pytest.approx(NOISE_M * np.sqrt(3 * 2))
    assert found[PredictedSource.DISPARITY] == pytest.approx(ALONG_M * OVER)
    # a turn at the end of step k moves the end by the distance that is left
    assert found[PredictedSource.LENS] == pytest.approx(TURN_RAD * STEP_M * sum(range(OVER)))
    squares = [found[source] ** 2 for source in PredictedSource if source is not PredictedSource.ALL]
    assert found[PredictedSource.ALL] == pytest.approx(np.sqrt(sum(squares)))
    shares = [score.number("predicted_share", "value", part=source.value) for source in PredictedSource]
    assert shares == pytest.approx([*(np.array(squares) / sum(squares)), 1.0])
    attitude = score.number("predicted_attitude", "value", part=PredictedSource.LENS.value)
    assert attitude == pytest.approx(np.degrees(TURN_RAD * OVER))


def test_the_sum_is_the_covariance_of_the_sub_trajectories() -> None:
    """Any steps along any path: the sum is that of `metrics.trajectory.consistency`, which the NEES of a score uses."""
    rng = np.random.default_rng(4)
    poses = Trajectory(
        np.arange(1, COUNT + 1) * 100_000_000,
        np.cumsum(rng.normal(0.1, 0.05, (COUNT, 3)), axis=0),
        Rotation.random(COUNT, random_state=3).as_quat(),
    )
    steps = rng.normal(0.0, 1e-3, (COUNT, STEP_SIZE))
    for triangle in (slice(0, 21), slice(27, 48)):
        factors = rng.normal(0.0, 1e-3, (COUNT, 6, 6))
        steps[:, triangle] = (factors @ np.swapaxes(factors, 1, 2))[:, UPPER[0], UPPER[1]]
    estimates = Estimates.of(poses, steps=steps)
    score = Score(figures=tuple(predicted_rows(ComparedRun("any", estimates), Condition.parse(f"frames={COUNT - 1}"))))
    sums = sums_of_steps(estimates, steps, np.array([0, COUNT - 1]))
    expected = relative_covariance(sums[0], sums[COUNT - 1], poses.positions[-1])
    assert expected is not None
    whole = PredictedSource.ALL.value
    assert score.number("predicted", "value", part=whole) == pytest.approx(np.sqrt(np.trace(expected[:3, :3])))
    attitude_deg = np.degrees(np.sqrt(np.trace(expected[3:, 3:])))
    assert score.number("predicted_attitude", "value", part=whole) == pytest.approx(attitude_deg)


def test_the_table_shows_each_source_once_for_a_condition() -> None:
    conditions = (CONDITION, Condition.parse("frames=10"))
    figures = [row for condition in conditions for row in predicted_rows(straight_run(), condition)]
    table = PREDICTED_TABLE.of(figures)
    assert len(table.rows) == len(PredictedSource) * len(conditions)
    shares = [row[2].value for row in table.rows if row[1].text == "20 frames"]
    assert sum(shares) == pytest.approx(2.0), "all sources are one more row"


def test_poses_without_steps_have_no_prediction() -> None:
    run = ComparedRun("other", Estimates.of(straight_run().estimates.trajectory))
    assert list(predicted_rows(run, CONDITION)) == []


def test_sub_trajectories_with_a_degraded_or_lost_pose_are_skipped() -> None:
    """A pose of unseen motion in the middle: sub-trajectories that contain the pose state metres."""
    estimates = straight_run().estimates
    usual = Score(figures=tuple(predicted_rows(straight_run(), CONDITION)))
    is_bad = np.arange(COUNT) == 30
    assert estimates.steps is not None
    steps = estimates.steps.copy()
    steps[30, 0] = 100.0
    for state in ("lost", "degraded"):
        run = ComparedRun(state, Estimates.of(estimates.trajectory, steps=steps, **{state: is_bad}))
        found = Score(figures=tuple(predicted_rows(run, CONDITION)))
        whole = {"part": PredictedSource.ALL.value}
        assert found.number("predicted", "value", **whole) == pytest.approx(usual.number("predicted", "value", **whole))
        assert found.number("predicted", "n", **whole) < usual.number("predicted", "n", **whole)
