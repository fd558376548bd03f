"""Drives whose errors follow a known covariance: it is found honest, and a wrong one is not."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory.association import Estimates
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

STEP = np.array([0.1, 0.0, 0.0])
SIGMAS = np.array([2e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-3])
UPPER = np.triu_indices(6)


def skew(v: Any) -> Any:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def odometry(frames: int, seed: int, *, offset: bool = False) -> tuple[Trajectory, Trajectory, Any]:
    """Truth, estimate and accumulated covariance of steps with errors in RB, propagated step by step."""
    rng = np.random.default_rng(seed)
    world = Rotation.random(random_state=seed) if offset else Rotation.identity()
    true, estimated = Rotation.identity(), world
    p_true, p_est = np.zeros(3), np.zeros(3)
    covariance = np.zeros((6, 6))
    rows: list[Any] = []
    for k in range(frames):
        rows.append((p_true, true.as_quat(), p_est, estimated.as_quat(), covariance[UPPER]))
        turn = Rotation.from_rotvec([0.0, 0.0, 0.05 * np.sin(k / 30)])
        noise = rng.normal(0, 1, 6) * SIGMAS
        moved = estimated.apply(STEP + noise[:3])
        p_true, true = p_true + true.apply(STEP), true * turn
        carried = np.eye(6)
        carried[:3, 3:] = -skew(moved)
        turned = np.zeros((6, 6))
        turned[:3, :3] = estimated.as_matrix()
        turned[3:, 3:] = (estimated * turn).as_matrix()
        covariance = carried @ covariance @ carried.T + turned @ np.diag(SIGMAS**2) @ turned.T
        p_est, estimated = p_est + moved, estimated * turn * Rotation.from_rotvec(noise[3:])
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    stamps = np.arange(frames) * 100_000_000
    return Trajectory(stamps, *columns[:2]), Trajectory(stamps, *columns[2:4]), columns[4]


def nees(truth: Trajectory, estimate: Trajectory, covariance: Any) -> Any:
    config = TrajectoryScoreConfig(conditions=("distance=2",))
    return score_trajectory(Estimates.of(estimate, covariance=covariance), truth, config).score.first.nees


@pytest.mark.slow
@pytest.mark.parametrize("offset", [False, True])
def test_an_honest_covariance_is_consistent(offset: bool) -> None:
    got = nees(*odometry(8000, 8, offset=offset))
    assert got.count > 350
    assert got.not_usable == 0
    for part, degrees in (("pose", 6), ("position", 3), ("attitude", 3)):
        assert getattr(got, part).consistent is True, part
        assert getattr(got, part).expected == degrees
        assert getattr(got, part).interval95[0] < degrees < getattr(got, part).interval95[1]


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "low"), [(0.25, 3.0), (4.0, 0.2)])
def test_a_covariance_that_is_too_small_or_too_large_is_found_out(factor: float, low: float) -> None:
    truth, estimate, covariance = odometry(3000, 4)
    got = nees(truth, estimate, covariance * factor).pose
    assert got.consistent is False
    assert got.mean == pytest.approx(6 / factor, rel=0.25)
    assert got.mean > low


def test_a_covariance_that_does_not_grow_cannot_be_tested() -> None:
    truth, estimate, covariance = odometry(300, 5)
    got = nees(truth, estimate, np.tile(covariance[-1], (300, 1)))
    assert (got.count, got.pose.mean) == (0, None)
    assert got.not_usable > 0


def test_lost_and_unknown_covariances_are_left_out() -> None:
    truth, estimate, covariance = odometry(300, 6)
    assert nees(truth, estimate, None) is None
    assert nees(truth, estimate, np.full((300, 21), np.nan)) is None
    lost = covariance.copy()
    lost[100:200] = (LOST_VARIANCE * np.eye(6))[UPPER]
    assert 0 < nees(truth, estimate, lost).count < nees(truth, estimate, covariance).count
