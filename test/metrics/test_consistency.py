"""Drives whose errors follow a known covariance: it is found honest, and a wrong one is not; composed steps."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import propagated_covariance, propagation
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.consistency import relative_covariance, sums_of_steps
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

STEP = np.array([0.1, 0.0, 0.0])
SIGMAS = np.array([2e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-3])


def odometry(frames: int, seed: int, *, offset: bool = False) -> tuple[Trajectory, Trajectory, Any]:
    """Truth, estimate and accumulated covariance of steps with errors in RB, propagated step by step."""
    rng = np.random.default_rng(seed)
    world = Rotation.random(random_state=seed) if offset else Rotation.identity()
    true, estimated, p_true, p_est, covariance = Rotation.identity(), world, np.zeros(3), np.zeros(3), np.zeros((6, 6))
    rows: list[Any] = []
    for k in range(frames):
        rows.append((p_true, true.as_quat(), p_est, estimated.as_quat(), covariance[UPPER]))
        turn = Rotation.from_rotvec([0.0, 0.0, 0.05 * np.sin(k / 30)])
        noise = rng.normal(0, 1, 6) * SIGMAS
        moved = estimated.apply(STEP + noise[:3])
        p_true, true = p_true + true.apply(STEP), true * turn
        x, y, z = moved
        carried = np.eye(6)
        carried[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        turned = block_diag(estimated.as_matrix(), (estimated * turn).as_matrix())
        covariance = carried @ covariance @ carried.T + turned @ np.diag(SIGMAS**2) @ turned.T
        p_est, estimated = p_est + moved, estimated * turn * Rotation.from_rotvec(noise[3:])
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    stamps = np.arange(frames) * 100_000_000
    return Trajectory(stamps, *columns[:2]), Trajectory(stamps, *columns[2:4]), columns[4]


def nees(truth: Trajectory, estimate: Trajectory, covariance: Any) -> Score:
    config = TrajectoryScoreConfig(conditions=("distance=2",))
    return Score(figures=score_trajectory(Estimates.of(estimate, covariance=covariance), truth, config).figures)


@pytest.mark.slow
def test_an_honest_covariance_is_consistent_and_a_wrong_one_is_found_out() -> None:
    truth, estimate, covariance = odometry(2500, 8, offset=True)
    got = nees(truth, estimate, covariance)
    assert got.number("nees_not_usable") == 0
    for part, degrees in (("pose", 6), ("position", 3), ("attitude", 3)):
        row = got.figure("nees", part=part)
        assert row.n > 100
        assert row.low95 < row.mean < row.high95
        assert row.low95 < row.value == degrees < row.high95
    for factor in (0.25, 4.0):
        wrong = nees(truth, estimate, covariance * factor).figure("nees", part="pose")
        assert not wrong.low95 < wrong.mean < wrong.high95
        assert wrong.mean == pytest.approx(6 / factor, rel=0.25)


def test_no_two_displacements_of_the_consistency_share_a_step() -> None:
    assert nees(*odometry(300, 6)).figure("nees", part="pose").n == 14, "29.9 m hold 14 displacements of 2 m"


def test_lost_unknown_and_shrinking_covariances_are_left_out() -> None:
    truth, estimate, covariance = odometry(300, 6)
    assert not nees(truth, estimate, None).rows("nees")
    assert not nees(truth, estimate, np.full((300, 21), np.nan)).rows("nees")
    lost = covariance.copy()
    lost[100:200] = (LOST_VARIANCE * np.eye(6))[UPPER]
    assert (
        0
        < nees(truth, estimate, lost).figure("nees", part="pose").n
        < nees(truth, estimate, covariance).figure("nees", part="pose").n
    )
    constant = nees(truth, estimate, np.tile(covariance[-1], (300, 1)))
    assert (constant.figure("nees", part="pose").n, constant.figure("nees", part="pose").mean) == (0, None)
    assert constant.number("nees_not_usable") > 0


COUNT = 30
RNG = np.random.default_rng(7)
POSITIONS = np.cumsum(RNG.normal(0.0, 0.3, (COUNT, 3)), axis=0)
QUATS = Rotation.from_quat(RNG.normal(0.0, 1.0, (COUNT, 4))).as_quat()
ROOTS = RNG.normal(0.0, 0.01, (COUNT, 6, 6))
SYSTEMATIC = RNG.normal(0.0, 0.01, (COUNT, 6))
COVARIANCES = ROOTS @ ROOTS.transpose(0, 2, 1)
NOISE = RNG.normal(0.0, 0.01, (COUNT, 6, 6))
NOISE = NOISE @ NOISE.transpose(0, 2, 1)
STEPS = np.column_stack((COVARIANCES[:, *UPPER], SYSTEMATIC, NOISE[:, *UPPER]))


def test_steps_are_composed_as_one_after_the_other() -> None:
    composed, systematic = np.zeros((6, 6)), np.zeros((6, 6))
    for k in range(5, 21):
        move = POSITIONS[k] - POSITIONS[k - 1] if k > 5 else np.zeros(3)
        in_ds = np.kron(np.eye(2), matrix_from_quat(QUATS[k - 1]))
        composed = propagated_covariance(composed, move) + in_ds @ COVARIANCES[k] @ in_ds.T
        systematic = propagation(move) @ systematic + in_ds @ np.diag(SYSTEMATIC[k])
    for k in (4, 20):  # the noise of the poses at both ends
        in_ds = np.kron(np.eye(2), matrix_from_quat(QUATS[k]))
        composed += propagated_covariance(in_ds @ NOISE[k] @ in_ds.T, POSITIONS[20] - POSITIONS[k])
    steps = STEPS.copy()
    steps[25] = np.nan
    estimates = Estimates.of(Trajectory(np.arange(COUNT), POSITIONS, QUATS), steps=steps)
    sums = sums_of_steps(estimates, steps, np.arange(COUNT))
    assert relative_covariance(sums[24], sums[26], POSITIONS[26]) is None, "a step is not known"
    found = relative_covariance(sums[4], sums[20], POSITIONS[20])
    assert found is not None
    np.testing.assert_allclose(found, composed + systematic @ systematic.T, rtol=1e-9, atol=1e-12)
