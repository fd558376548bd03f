"""Own body, dirt and moving objects in the view: the pose follows the ground, or says that it may not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from loc_drive import drive, noisy, run
from made_scene import LOC_RIG, true_pose

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.simulation.faults import parse_fault
from sfr_loc_map.simulation.perturber import Perturber

DRIVE = drive(30)


def with_fault(fault: str) -> list[PoseEstimate]:
    """Return the estimates of a drive with a fault."""
    perturber = Perturber([parse_fault(fault)], 1, len(DRIVE), LOC_RIG)
    return run(pair for _, pair in perturber.pairs(DRIVE))


def worst_ratio(estimates: Sequence[PoseEstimate]) -> float:
    """Return the largest position error over its stated 3 sigma, where the state is tracking."""
    tracked = [(index, item) for index, item in enumerate(estimates) if item.state is TrackingState.TRACKING]
    return max(
        float(np.linalg.norm(item.T_ds_rb.translation - true_pose(index).translation))
        / (3.0 * np.sqrt(np.trace(item.covariance[:3, :3])))
        for index, item in tracked
    )


def masked(estimates: Sequence[PoseEstimate]) -> list[float]:
    return [item.statistics.masked_share or 0.0 for item in estimates]


def test_the_own_body_is_found_by_the_first_motion_and_left_out() -> None:
    with_body = with_fault("body:amount=0.3")
    assert worst_ratio(with_body) < 1.0
    error = np.linalg.norm(with_body[-1].T_ds_rb.translation - true_pose(len(DRIVE) - 1).translation)
    assert error < 0.02
    assert np.median(masked(with_body)) == pytest.approx(0.3, abs=0.12)


def test_a_crossing_object_does_not_carry_the_pose_along() -> None:
    estimates = with_fault("object:amount=0.3,share=1,burst=20,start=8")
    assert worst_ratio(estimates) < 1.0
    assert max(masked(estimates)) > 0.0


@pytest.mark.parametrize("fault", ["dirt:amount=0.15", "shadow:amount=0.25"])
def test_dirt_and_own_shadow_do_not_hold_the_pose(fault: str) -> None:
    assert worst_ratio(with_fault(fault)) < 1.0


def test_nothing_is_left_out_of_a_fault_free_drive_or_of_one_that_stands_still() -> None:
    rng, first = np.random.default_rng(0), DRIVE[0]
    still = [StereoPair(p.stamp_ns, noisy(first.left, 1, rng), noisy(first.right, 1, rng)) for p in DRIVE[:10]]
    driven, standing = run(DRIVE[:20]), run(still)
    assert not any(masked(driven) + masked(standing))
    assert {item.state for item in (*driven[1:], *standing[1:])} == {TrackingState.TRACKING}
