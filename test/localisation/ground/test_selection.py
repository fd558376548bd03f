"""Own body, dirt and moving objects in the view: the pose follows the ground, or says that it may not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.loc_drive import drive, noisy, run
from helpers.made_scene import LOC_RIG, true_pose
from sfr_loc_map.bench.fault_benchmark import ErrorReport, stated_errors
from sfr_loc_map.evidence.localiser_runs import PairsInMemory
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig, MotionBounds
from sfr_loc_map.localisation.estimate import PoseEstimate, StateReason, TrackingState
from sfr_loc_map.localisation.localiser import Localiser

PAIRS = 14

DRIVE = drive(30)


def with_fault(fault: str) -> list[PoseEstimate]:
    """Return the estimates of a drive with a fault."""
    injector = FaultInjector([parse_fault(fault)], 1, len(DRIVE), LOC_RIG)
    return run(pair for _, pair in injector.pairs(DRIVE))


def worst_ratio(estimates: Sequence[PoseEstimate]) -> float:
    """Return the largest position error over its stated 3 sigma, where the state is tracking."""
    tracked = [(index, item) for index, item in enumerate(estimates) if item.state is TrackingState.TRACKING]
    return max(
        float(np.linalg.norm(item.T_ds_rb.translation - true_pose(index).translation))
        / (3.0 * np.sqrt(np.trace(item.covariance[:3, :3])))
        for index, item in tracked
    )


def later_truth(truth: Trajectory | None, begin_ns: int) -> Trajectory:
    """Return the ground truth from a stamp on."""
    assert truth is not None
    later = truth.stamps_ns >= begin_ns
    return Trajectory(truth.stamps_ns[later], truth.positions[later], truth.quats_xyzw[later])


def masked(estimates: Sequence[PoseEstimate]) -> list[float]:
    return [item.statistics.masked_share or 0.0 for item in estimates]


@pytest.mark.sample
def test_a_body_that_hides_most_of_the_first_image_is_no_silent_error(sample: PairsInMemory) -> None:
    """The pose of the second pair follows a few landmarks beside the body, and is wrong by 12 cm."""
    truth = sample.ground_truth
    assert truth is not None
    pairs = sample.kept[:5]
    by = Localiser(sample.rig, LocalisationConfig(), truth.pose(0))
    with_body = FaultInjector([parse_fault("body:amount=0.6")], 3, len(sample), sample.rig)
    estimates = run((pair for _, pair in with_body.pairs(pairs)), by)
    assert stated_errors(estimates, truth).error_report is ErrorReport.REPORTED


def test_the_own_body_is_found_by_the_first_motion_and_left_out() -> None:
    with_body = with_fault("body:amount=0.3")
    assert worst_ratio(with_body) < 1.0
    error = np.linalg.norm(with_body[-1].T_ds_rb.translation - true_pose(len(DRIVE) - 1).translation)
    assert error < 0.02
    assert np.median(masked(with_body)) == pytest.approx(0.3, abs=0.12)


def test_the_cells_of_the_own_body_are_excluded_with_its_landmarks() -> None:
    """Otherwise the next keyframes create landmarks on the body again."""
    with_body = with_fault("body:amount=0.5")
    assert worst_ratio(with_body) < 1.0
    assert max(masked(with_body)[:4]) == pytest.approx(0.5, abs=0.1)


def test_a_crossing_object_does_not_carry_the_pose_along() -> None:
    estimates = with_fault("object:amount=0.3,share=1,burst=20,start=8")
    assert worst_ratio(estimates) < 1.0
    assert max(masked(estimates)) > 0.0


@pytest.mark.parametrize("fault", ["dirt:amount=0.15", "shadow:amount=0.25"])
def test_dirt_and_own_shadow_do_not_hold_the_pose(fault: str) -> None:
    assert worst_ratio(with_fault(fault)) < 1.0


SEVERE = ("texture", "reflection", "body:amount=0.6", "ghost:share=0.3", "interlaced:share=0.3", "shear:share=0.3")

LATER = ("reflection:share=1,start=5", "ghost:amount=0.66,share=0.5,burst=4,start=5")


@pytest.mark.sample
@pytest.mark.parametrize("fault", [*SEVERE, "yaw:amount=0.3", "shift:amount=2", "ghost:share=1", *LATER])
def test_what_no_pose_explains_is_said(sample: PairsInMemory, fault: str) -> None:
    """Most of the image does not move with the ground, or is of another moment; the right camera looks elsewhere."""
    truth = sample.ground_truth
    assert truth is not None
    pairs = sample.kept[:PAIRS]
    by = Localiser(sample.rig, LocalisationConfig(), truth.pose(0))
    estimates = run((pair for _, pair in FaultInjector([parse_fault(fault)], 1, PAIRS, sample.rig).pairs(pairs)), by)
    known = [item for item in estimates if item.state is not TrackingState.LOST]
    assert stated_errors(estimates, truth).error_report is not ErrorReport.SILENT
    assert (
        stated_errors([replace(item, state=TrackingState.TRACKING) for item in known], truth).error_report
        is not ErrorReport.SILENT
    )
    states = Counter(item.state for item in estimates[1:])
    assert "body" in fault or states[TrackingState.DEGRADED] + states[TrackingState.LOST] > 0
    if fault in ("texture", "reflection"):
        assert states[TrackingState.TRACKING] == 0
    elif fault in SEVERE:
        assert states[TrackingState.TRACKING] > PAIRS // 4


@pytest.mark.sample
@pytest.mark.parametrize("weight", [0.3, 0.6])
def test_exposures_that_are_blended_for_several_pairs_are_reported(sample: PairsInMemory, weight: float) -> None:
    """The poses of such pairs may lag behind, and the step to the first good pair is then too long."""
    pairs = sample.kept[90:110]
    truth = later_truth(sample.ground_truth, pairs[0].stamp_ns)
    blended = list(pairs)
    for number in range(10, 17):
        sides = {
            side: np.rint((1.0 - weight) * getattr(pairs[number], side) + weight * getattr(pairs[number - 1], side))
            for side in ("left", "right")
        }
        blended[number] = replace(pairs[number], **{side: image.astype(np.uint8) for side, image in sides.items()})
    estimates = run(blended, Localiser(sample.rig, LocalisationConfig(), truth.pose(0)))
    assert {item.state for item in estimates[1:10]} == {TrackingState.TRACKING}
    assert {item.state for item in estimates[10:17]} == {TrackingState.DEGRADED}
    assert stated_errors(estimates, truth).error_report is ErrorReport.REPORTED


@pytest.mark.parametrize("fault", ["arm:share=1,start=5", "scratch", "reflection:amount=0.3"])
def test_arms_and_windows_do_not_carry_the_pose_along(fault: str) -> None:
    assert worst_ratio(with_fault(fault)) < 1.0


def test_a_fast_drive_on_a_bare_road_is_not_lost(shared_data: Path) -> None:
    loc = open_source(shared_data / "kitti-1").loc
    assert loc is not None
    rows = np.clip((np.arange(loc.rig.height) - 175) / 40.0, 0.0, 1.0)[:, None]  # how bare: all from the horizon down

    def bare(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.asarray(image * (1.0 - rows) + cv2.GaussianBlur(image, (0, 0), 5.0) * rows, np.uint8)

    localiser = Localiser(loc.rig)
    pairs = islice(loc.pairs(), 1, None, 3)  # 36 m/s
    states = [localiser.process(replace(pair, left=bare(pair.left), right=bare(pair.right))).state for pair in pairs]
    assert TrackingState.LOST not in states
    assert states.count(TrackingState.TRACKING) > 0.6 * len(states)


def beside_each_other(left_of: StereoPair, right_of: StereoPair, columns: int, stamp_ns: int, seed: int) -> StereoPair:
    """Return a pair whose left columns show one pair and whose other columns show another, with new noise."""
    rng = np.random.default_rng(seed)

    def joined(first: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return noisy(np.hstack((first[:, :columns], other[:, columns:])), 1, rng)

    return StereoPair(stamp_ns, joined(left_of.left, right_of.left), joined(left_of.right, right_of.right))


def test_an_object_that_begins_to_move_before_the_ground_is_identified_does_not_carry_a_rover_at_rest_along() -> None:
    at_rest = DRIVE[0]
    pairs = [beside_each_other(DRIVE[max(k - 3, 0)], at_rest, 40, DRIVE[k].stamp_ns, k) for k in range(16)]
    estimates = run(pairs)
    errors = [np.linalg.norm(item.T_ds_rb.translation - true_pose(0).translation) for item in estimates]
    assert max(errors) < 0.003
    assert {item.state for item in estimates[4:]} == {TrackingState.DEGRADED}


def test_a_rover_with_a_body_in_view_drives_off_before_the_ground_is_identified() -> None:
    pairs = [beside_each_other(DRIVE[0], DRIVE[max(k - 3, 0)], 40, DRIVE[k].stamp_ns, k) for k in range(10)]
    estimates = run(pairs)
    truth = [true_pose(max(k - 3, 0)) for k in range(10)]
    errors = [
        np.linalg.norm(item.T_ds_rb.translation - to.translation) for item, to in zip(estimates, truth, strict=True)
    ]
    assert max(errors) < 0.01


def test_a_lost_localiser_whose_map_contradicts_all_images_begins_a_window() -> None:
    """The left half is fixed to the camera. The ground jumps after the first pair, so that only the body is tracked."""
    config = LocalisationConfig(motion=MotionBounds(unseen_speed_m_s=1000.0, max_speed_m_s=1e4))  # lost after one pair
    at = [0, *range(16, 30)]
    pairs = [beside_each_other(DRIVE[0], DRIVE[at[k]], 80, DRIVE[k].stamp_ns, k) for k in range(len(at))]
    estimates = run(pairs, Localiser(LOC_RIG, config, true_pose(0)))
    lost, restarted = estimates[2:5], estimates[5:]
    assert {(item.state, item.reason) for item in lost} == {(TrackingState.LOST, StateReason.MOVING_REGIONS)}
    assert {(item.state, item.reason) for item in restarted} == {(TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)}
    assert min(item.covariance[0, 0] for item in restarted) > 9999.0
    motion = restarted[-1].T_ds_rb.translation - restarted[5].T_ds_rb.translation
    true_motion = true_pose(at[-1]).translation - true_pose(at[10]).translation
    np.testing.assert_allclose(motion, true_motion, atol=0.01)


def test_nothing_is_left_out_of_a_fault_free_drive_or_of_one_that_stands_still() -> None:
    rng, first = np.random.default_rng(0), DRIVE[0]
    still = [StereoPair(p.stamp_ns, noisy(first.left, 1, rng), noisy(first.right, 1, rng)) for p in DRIVE[:10]]
    driven, standing = run(DRIVE[:20]), run(still)
    assert not any(masked(driven) + masked(standing))
    assert {item.state for item in (*driven[1:], *standing[1:])} == {TrackingState.TRACKING}


@pytest.mark.sample
def test_a_pair_that_is_hardly_explained_teaches_nothing_about_the_ground(sample: PairsInMemory) -> None:
    """A scratched lens: the pose is lost among the scratches before the ground's motion is known."""
    pairs = sample.kept[48:72]
    truth = later_truth(sample.ground_truth, pairs[0].stamp_ns)
    by = Localiser(sample.rig, LocalisationConfig(), truth.pose(0))
    scratched = FaultInjector([parse_fault("scratch:amount=0.272")], 407223818, 100, sample.rig)
    estimates = run((pair for _, pair in scratched.pairs(pairs)), by)
    assert stated_errors(estimates, truth).error_report is not ErrorReport.SILENT
