"""The localiser with images that are black, swapped, duplicate, missing, or rotated against the calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from loc_drive import BLACK, LOST, black, drive, errors, localiser, run
from made_scene import HEIGHT, LOC_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, stereo_pair, true_pose

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, TrackingResult
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.parallel import in_background

DRIVE = drive(25)


@pytest.mark.parametrize("count", [1, 5])
def test_black_images_are_lost_at_the_last_pose_and_recovered(count: int) -> None:
    by = localiser()
    last = run(DRIVE[:10], by)[-1]
    for index in range(10, 10 + count):
        estimate = by.process(black(index))
        assert estimate.state is TrackingState.LOST
        assert estimate.stamp_ns == black(index).stamp_ns
        np.testing.assert_array_equal(estimate.covariance, LOST)
        assert estimate.T_ds_rb.matrix.tobytes() == last.T_ds_rb.matrix.tobytes()
    after = range(10 + count, 13 + count)
    found = run((DRIVE[index] for index in after), by)
    assert found[-1].state is TrackingState.TRACKING
    metres, degrees = errors(found[-1], true_pose(after[-1]))
    assert metres < 0.005  # the wall is recognised: what was driven blindly does not count
    assert degrees < 0.1


def test_one_black_image_of_two_is_lost() -> None:
    by = localiser()
    last = run(DRIVE[:5], by)[-1]
    estimate = by.process(replace(DRIVE[5], right=BLACK))
    if estimate.state is TrackingState.LOST:
        assert estimate.T_ds_rb.matrix.tobytes() == last.T_ds_rb.matrix.tobytes()
    else:
        assert errors(estimate, true_pose(5))[0] < 0.01


def test_recovered_where_nothing_is_recognised_with_a_growing_covariance() -> None:
    by = localiser()
    before = run(DRIVE[:10], by)[-1]
    by.process(black(10))
    # Turned by half a radian to the left: another part of the wall.
    away = [
        stereo_pair(
            START_NS + (11 + step) * PERIOD_NS,
            Transform.from_quat([0.2, 1.5 + 0.015 * step, 0.8], [0, 0, 0.05, 1.0]) @ T_RB_LOCSB,
            LOC_RIG,
        )
        for step in range(6)
    ]
    found = run(away, by)
    first = next(i for i, e in enumerate(found) if e.state is TrackingState.DEGRADED)
    assert first < 3
    for estimate in found[:first]:
        assert estimate.T_ds_rb.matrix.tobytes() == before.T_ds_rb.matrix.tobytes()
    np.testing.assert_allclose(found[first].T_ds_rb.matrix, before.T_ds_rb.matrix, atol=1e-12)
    assert (np.diag(found[first].covariance)[:3] > 100 * np.diag(before.covariance)[:3]).all()
    assert np.linalg.norm(found[-1].T_ds_rb.translation - before.T_ds_rb.translation) < 0.2


@pytest.mark.parametrize("dark", [black, lambda index: replace(DRIVE[index], right=BLACK)])
def test_what_moved_before_the_first_image_is_in_the_covariance(dark: Callable[[int], StereoPair]) -> None:
    """The start pose holds at the first pair, which shows nothing; the rover is elsewhere when it sees."""
    by = localiser()
    for index in range(4):
        estimate = by.process(dark(index))
        assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.UNTEXTURED_IMAGES)
        np.testing.assert_array_equal(estimate.covariance, LOST)
        np.testing.assert_allclose(estimate.T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)
    found = run(DRIVE[4:], by)
    assert (found[0].state, found[0].reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    np.testing.assert_allclose(found[0].T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)
    assert errors(found[-1], true_pose(len(DRIVE) - 1))[0] > 0.05
    for index, estimate in enumerate(found, 4):
        assert errors(estimate, true_pose(index))[0] < 2.0 * np.sqrt(np.trace(estimate.covariance[:3, :3]))


def test_a_gap_at_the_start_makes_the_first_window_degraded_and_no_later_one() -> None:
    by = Localiser(LOC_RIG, LocalisationConfig(window_keyframes=2), true_pose(0))
    states = [estimate.state.value for estimate in run([black(0), *drive(40)[1:]], by)]
    degraded = states.count("degraded")
    assert 3 < degraded < 35
    assert states == ["lost"] + ["degraded"] * degraded + ["tracking"] * (39 - degraded)


def test_a_duplicate_pair_says_that_the_rover_may_have_gone_on() -> None:
    estimates = run([DRIVE[0], DRIVE[1], DRIVE[2], replace(DRIVE[2], stamp_ns=DRIVE[3].stamp_ns), DRIVE[4]])
    again, step = estimates[3], np.linalg.norm(true_pose(2).translation - true_pose(1).translation)
    assert (again.state, again.reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)
    assert estimates[4].state is TrackingState.TRACKING
    assert again.statistics.repeated == 1
    np.testing.assert_array_equal(again.T_ds_rb.matrix, estimates[2].T_ds_rb.matrix)
    assert np.sqrt(again.covariance[0, 0]) > 0.9 * step > 5 * np.sqrt(estimates[2].covariance[0, 0])
    assert errors(estimates[4], true_pose(4))[0] < 0.003


def test_swapped_images_are_lost_and_not_half_trusted() -> None:
    swapped = StereoPair(DRIVE[3].stamp_ns, DRIVE[3].right, DRIVE[3].left)
    estimates = run([*DRIVE[:3], swapped, *DRIVE[4:6]])
    assert [e.state for e in estimates[3:]] == [TrackingState.LOST, TrackingState.TRACKING, TrackingState.TRACKING]
    assert errors(estimates[5], true_pose(5))[0] < 0.003


def test_recovered_after_a_gap() -> None:
    estimates = run([*DRIVE[:3], black(3), black(4), DRIVE[20], DRIVE[21]])
    assert [e.state.value for e in estimates[3:]] == ["lost", "lost", "tracking", "tracking"]
    assert errors(estimates[-1], true_pose(21))[0] < 0.01


def test_a_yaw_that_is_not_known_yet_is_within_what_is_stated() -> None:
    """Right images 0.5 px off along the columns: the path is wrong from the first step on."""
    shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]])
    size = (LOC_RIG.width, LOC_RIG.height)
    moved = [StereoPair(pair.stamp_ns, pair.left, cv2.warpAffine(pair.right, shift, size)) for pair in DRIVE[:12]]
    found = [(errors(estimate, true_pose(k))[0], estimate.covariance) for k, estimate in enumerate(run(moved))]
    assert found[-1][0] > 0.01
    for metres, covariance in found[1:]:
        assert metres < 2.0 * np.sqrt(np.trace(covariance[:3, :3]))


def test_a_pair_that_stays_is_ever_less_certain_until_another_comes() -> None:
    again = [replace(DRIVE[3], stamp_ns=DRIVE[3].stamp_ns + k * PERIOD_NS) for k in range(1, 4)]
    estimates = run([*DRIVE[:4], *again, DRIVE[7]])
    sigma = [np.sqrt(np.trace(estimate.covariance[:3, :3])) for estimate in estimates[3:7]]
    assert (np.diff(sigma) > 0.01).all()
    assert np.sqrt(np.trace(estimates[7].covariance[:3, :3])) < sigma[1]
    assert errors(estimates[7], true_pose(7))[0] < 0.003


def test_swapped_images_begin_no_new_window() -> None:
    swapped = [StereoPair(pair.stamp_ns, pair.right, pair.left) for pair in DRIVE[3:5]]
    estimates = run([*DRIVE[:3], *swapped, DRIVE[5]])
    assert [estimate.state.value for estimate in estimates[3:]] == ["lost", "lost", "tracking"]
    np.testing.assert_array_equal(estimates[4].T_ds_rb.matrix, estimates[2].T_ds_rb.matrix)


@pytest.mark.slow
def test_a_window_that_cannot_begin_leaves_the_reference_of_relocalisation() -> None:
    by, random = localiser(), np.random.default_rng(0)
    run(DRIVE[:6], by)
    reference = by._relocaliser._last
    for index in range(6, 11):  # texture enough to begin, and no match between left and right
        left, right = random.integers(0, 255, (2, *BLACK.shape)).astype(np.uint8)
        estimate = by.process(StereoPair(START_NS + index * PERIOD_NS, left, right))
        assert estimate.state is TrackingState.LOST
    assert estimate.statistics.features is not None  # tried to begin
    assert by._relocaliser._last is reference
    assert errors(by.process(DRIVE[11]), true_pose(11))[0] < 0.005


def test_a_right_image_that_is_the_left_one_is_refused() -> None:
    same = replace(DRIVE[3], right=DRIVE[3].left)
    started = run([replace(DRIVE[0], right=DRIVE[0].left), DRIVE[1]])
    assert [e.state.value for e in started] == ["lost", "degraded"]
    estimates = run([*DRIVE[:3], same, *DRIVE[4:6]])
    assert (estimates[3].state, estimates[3].reason) == (TrackingState.LOST, StateReason.NO_STEREO)
    assert errors(estimates[5], true_pose(5))[0] < 0.003


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_frozen_camera_is_not_used(side: str) -> None:
    frozen = [replace(DRIVE[k], **{side: getattr(DRIVE[5], side)}) for k in range(6, 9)]
    estimates = run([*DRIVE[:6], *frozen, *DRIVE[9:12]])
    for index, estimate in enumerate(estimates):
        if 6 <= index < 9:
            assert estimate.reason is StateReason.REPEATED_IMAGES
        else:
            assert estimate.reason is None
        assert estimate.state is TrackingState.LOST or errors(estimate, true_pose(index))[0] < 0.01


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_torn_image_is_read_where_it_is_new(share: float) -> None:
    row = round((1.0 - share) * HEIGHT)
    left, right = (
        np.concatenate((getattr(DRIVE[6], side)[:row], getattr(DRIVE[5], side)[row:])) for side in ("left", "right")
    )
    estimates = run([*DRIVE[:6], replace(DRIVE[6], left=left, right=right), *DRIVE[7:9]])
    assert (estimates[6].state, estimates[6].reason) == (TrackingState.DEGRADED, StateReason.TORN_IMAGES)
    assert errors(estimates[6], true_pose(6))[0] < 0.004
    assert [estimate.state for estimate in estimates[7:]] == [TrackingState.TRACKING] * 2


def test_what_stays_the_same_for_longer_is_no_torn_image() -> None:
    """Something fixed to the camera covers the lower rows."""
    body = np.random.default_rng(0).integers(0, 255, (HEIGHT // 5, DRIVE[0].left.shape[1]), np.uint8)
    covered = []
    for pair in DRIVE[:8]:
        left, right = (np.concatenate((image[: -len(body)], body)) for image in (pair.left, pair.right))
        covered.append(StereoPair(pair.stamp_ns, left, right))
    reasons = [estimate.reason for estimate in run(covered)]
    assert StateReason.TORN_IMAGES not in reasons[2:]


@pytest.mark.parametrize("jump_m", [20.0, float("nan")])
def test_an_absurd_pose_is_lost_and_not_kept(monkeypatch: pytest.MonkeyPatch, jump_m: float) -> None:
    by = localiser()
    before = run(DRIVE[:6], by)[-1]
    refine = by._tracker.refine

    def leap(*arguments: object) -> TrackingResult:
        result = refine(*arguments)  # type: ignore[arg-type]
        return replace(result, pose=result.pose._replace(position=result.pose.position + jump_m))

    with monkeypatch.context() as patch:
        patch.setattr(by._tracker, "refine", leap)
        estimate = by.process(DRIVE[6])
    assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.IMPLAUSIBLE_MOTION)
    np.testing.assert_array_equal(estimate.T_ds_rb.matrix, before.T_ds_rb.matrix)
    assert errors(by.process(DRIVE[7]), true_pose(7))[0] < 0.004


def test_a_window_that_is_absurd_is_left() -> None:
    by = localiser()
    run(DRIVE[:6], by)
    result = by.last_result
    assert result is not None
    by._finish_keyframe()
    by._backend.add_keyframe(StereoFrame.of(DRIVE[5]), result)
    by._backend.wait()
    by._backend._window.pose_covariance[:] = np.nan
    by._backend._pending = in_background(lambda: 0.1)
    estimate = by.process(DRIVE[6])
    assert (estimate.state, estimate.reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    assert np.isfinite(estimate.covariance).all()
    assert errors(estimate, true_pose(6))[0] < 2.0 * np.sqrt(np.trace(estimate.covariance[:3, :3]))


@pytest.mark.parametrize("fault", ["swapped", "identical"])
def test_images_that_were_shown_by_the_wrong_camera_are_not_new(fault: str) -> None:
    """A pair is lost, as its images are mixed up; the next one shows them again, in their places."""
    pair = DRIVE[6]
    right = pair.right if fault == "swapped" else pair.left
    mixed = StereoPair(pair.stamp_ns, right, pair.left)
    estimates = run([*DRIVE[:6], mixed, replace(pair, stamp_ns=DRIVE[7].stamp_ns), *DRIVE[8:10]])
    assert estimates[6].state is TrackingState.LOST
    assert estimates[7].state is not TrackingState.TRACKING
    assert [estimate.state for estimate in estimates[8:]] == [TrackingState.TRACKING] * 2


def test_a_lost_pair_that_is_repeated_is_still_lost() -> None:
    """Its images are of before, whatever they show on a second look."""
    by = localiser()
    run(DRIVE[:6], by)
    left, right = np.random.default_rng(0).integers(0, 255, (2, *BLACK.shape)).astype(np.uint8)
    away = StereoPair(DRIVE[7].stamp_ns, left, right)
    lost = by.process(away)
    again = by.process(replace(away, stamp_ns=DRIVE[8].stamp_ns))
    assert (again.state, again.reason) == (lost.state, lost.reason)
    assert lost.state is TrackingState.LOST
    assert again.statistics.repeated == 1


def test_a_pair_after_a_torn_one_is_doubted_while_its_parts_disagree() -> None:
    """The lower half of each image is that of the exposure before: only in the first one was that shown."""
    row, torn = HEIGHT // 2, []
    for index in range(6, 9):
        now, before = DRIVE[index], DRIVE[index - 1]
        sides = (np.concatenate((getattr(now, s)[:row], getattr(before, s)[row:])) for s in ("left", "right"))
        torn.append(StereoPair(now.stamp_ns, *sides))
    estimates = run([*DRIVE[:6], *torn, *DRIVE[9:12]])
    for index, estimate in enumerate(estimates):
        stated = 5.0 * 3.0 * np.sqrt(np.trace(estimate.covariance[:3, :3]))
        assert estimate.state is not TrackingState.TRACKING or errors(estimate, true_pose(index))[0] < stated
    assert {estimate.state for estimate in estimates[10:]} == {TrackingState.TRACKING}
