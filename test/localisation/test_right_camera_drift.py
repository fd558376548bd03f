"""The localiser with a right camera that turns while the rover drives."""

import numpy as np
import pytest
from loc_drive import drive, run
from made_scene import LOC_RIG, PERIOD_NS, START_NS, true_pose

from sfr_loc_map.bench.honesty import error_and_sigma
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.simulation.faults import parse_fault
from sfr_loc_map.simulation.perturber import Perturber


def test_right_camera_that_turns_is_followed_and_reported() -> None:
    """Its yaw changes by a degree: without following it the attitude is off by more than ten times its 3 sigma."""
    fault = parse_fault("drift:amount=2.5")
    pairs = [pair for _, pair in Perturber([fault], 0, 40, LOC_RIG).pairs(drive(40))]
    estimates = run(pairs)
    truth = Trajectory.from_poses((START_NS + k * PERIOD_NS, true_pose(k)) for k in range(40))
    error, sigma = error_and_sigma(estimates, truth)
    assert (error / (3 * sigma)).max() < 2.0
    assert estimates[-1].state is TrackingState.DEGRADED
    assert estimates[-1].reason is StateReason.CALIBRATION_DRIFT
    turned_px = LOC_RIG.fx * np.tan(np.radians(2.5 * 39 / 100))
    assert estimates[-1].statistics.disparity_offset_px == pytest.approx(-turned_px, abs=0.35)
