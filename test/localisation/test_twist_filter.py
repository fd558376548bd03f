"""A filter of wheel speed and gyro gains by the published twist: its covariance is honest for the filter's interval."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from sfr_loc_map.evidence.localiser_runs import PairsInMemory
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.rotation import matrix_from_quat, matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.message_stamps import NS_PER_S

PAIRS = 40
GYRO_RAD_S, BIAS_RAD_S = 2e-4, 1e-3  #: Noise of a gyro in each interval, and its constant error.
SLIP, WHEEL_M_S = 0.03, 0.01  #: The wheels turn faster than the rover drives, with noise.


class Filtered(NamedTuple):
    error_m: float  # distance to the truth at the end
    nis: float  # mean normalised innovation squared per degree of freedom; NaN without a twist


def filtered(estimates: list, positions: np.ndarray, rotations: np.ndarray, *, with_twist: bool) -> Filtered:
    """Run a Kalman filter of velocity in RB and gyro bias; integrate its path from the true start.

    Wheels measure the velocity, the gyro the rates; the twist of the localiser measures both where it is known. The
    velocity is a random walk of the size that the true one has.
    """
    rng = np.random.default_rng(3)
    velocities, rates, seconds = [], [], []
    for (before, now), R, p in zip(pairwise(estimates), pairwise(rotations), pairwise(positions), strict=True):
        seconds.append((now.stamp_ns - before.stamp_ns) / NS_PER_S)
        velocities.append(R[0].T @ (p[1] - p[0]) / seconds[-1])
        rates.append(rotvec_from_matrix(R[0].T @ R[1]) / seconds[-1])
    walk = np.mean(np.square(np.diff(velocities, axis=0)), axis=0) + 1e-8
    state, P = np.concatenate((velocities[0], np.zeros(3))), np.diag([0.1**2] * 3 + [5e-3**2] * 3)
    position, rotation, squares = positions[0].copy(), rotations[0].copy(), []
    for estimate, velocity, rate, dt in zip(estimates[1:], velocities, rates, seconds, strict=True):
        gyro = rate + BIAS_RAD_S + rng.normal(0.0, GYRO_RAD_S, 3)
        wheels = velocity * (1.0 + SLIP) + rng.normal(0.0, WHEEL_M_S, 3)
        P = P + np.diag([*walk, *[1e-12] * 3])
        measured = [(wheels, np.eye(3, 6), np.eye(3) * (WHEEL_M_S**2 + (SLIP * np.linalg.norm(velocity)) ** 2))]
        step = estimate.step
        if with_twist and step is not None:  # the gyro's bias is what its rates exceed the twist's by
            R = step.motion_covariance / dt**2
            R[3:, 3:] += np.eye(3) * GYRO_RAD_S**2
            z = step.motion / dt
            measured.append(
                (np.concatenate((z[:3], gyro - z[3:])), np.eye(6), R * np.outer(*[[1, 1, 1, -1, -1, -1]] * 2))
            )
        for z, H, R in measured:
            S = H @ P @ H.T + R
            innovation = z - H @ state
            if len(z) == 6:
                squares.append(float(innovation @ np.linalg.solve(S, innovation)) / 6)
            gain = np.linalg.solve(S, H @ P).T
            state, P = state + gain @ innovation, P - gain @ S @ gain.T
        position += rotation @ (state[:3] * dt)
        rotation = rotation @ matrix_from_rotvec((gyro - state[3:]) * dt)
    error = float(np.linalg.norm(position - positions[-1]))
    return Filtered(error, float(np.mean(squares)) if squares else float("nan"))


@pytest.mark.sample
@pytest.mark.slow
@pytest.mark.parametrize("fault", [None, "black:burst=12,share=0.15"])
def test_a_filter_gains_by_the_twist(sample: PairsInMemory, fault: str | None) -> None:
    sample = PairsInMemory(sample.rig, sample.kept[:PAIRS], sample.ground_truth)
    faulty = sample if fault is None else FaultyLoc(sample, [parse_fault(fault)], 5)
    localiser = Localiser(sample.rig, LocalisationConfig())
    estimates = [localiser.process(pair) for pair in faulty.pairs()]
    truth = sample.ground_truth
    assert truth is not None
    rows = np.searchsorted(truth.stamps_ns, [estimate.stamp_ns for estimate in estimates])
    rotations = np.array([matrix_from_quat(quat) for quat in truth.quats_xyzw[rows]])
    alone = filtered(estimates, truth.positions[rows], rotations, with_twist=False)
    fused = filtered(estimates, truth.positions[rows], rotations, with_twist=True)
    assert fused.error_m < 0.5 * alone.error_m
    assert 0.5 < fused.nis < 2.0
