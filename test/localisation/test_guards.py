"""Guards: the table of findings, and stale images (frozen, with new noise, partially transferred)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.loc_drive import drive, errors, localiser, noisy, run
from helpers.made_scene import HEIGHT, true_pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.guards import check_images, check_order
from sfr_loc_map.localisation.stale_images import compare

DRIVE = drive(16)


def torn(new: StereoPair, old: StereoPair, row: int) -> StereoPair:
    """Return a pair whose rows from one on are those of another pair."""
    sides = (np.concatenate((getattr(new, s)[:row], getattr(old, s)[row:])) for s in ("left", "right"))
    return StereoPair(new.stamp_ns, *sides)


@pytest.mark.parametrize(
    ("landmarks", "if_swapped", "is_swapped"),
    [(0, 25, True), (0, 24, False), (15, 2276, True), (117, 905, True), (100, 120, False), (200, 0, False)],
)
def test_images_are_swapped_if_an_exchange_gives_enough_and_many_more_landmarks(
    landmarks: int, if_swapped: int, *, is_swapped: bool
) -> None:
    findings = check_order(landmarks, lambda: if_swapped, min_tracked=25, max_corners=2400)
    assert (Finding.SWAPPED in findings) == is_swapped


def test_the_order_of_the_images_is_not_tested_if_a_window_has_many_landmarks() -> None:
    def count_if_swapped() -> int:
        raise AssertionError("the measurement takes the time of a keyframe")

    assert not check_order(240, count_if_swapped, min_tracked=25, max_corners=2400)


def test_frozen_pair_with_new_noise_is_degraded_with_a_covariance_that_contains_the_motion() -> None:
    random = np.random.default_rng(1)
    pairs = [StereoPair(p.stamp_ns, noisy(p.left, 1.5, random), noisy(p.right, 1.5, random)) for p in DRIVE[:12]]
    old = pairs[5]
    for k in range(6, 10):
        pairs[k] = StereoPair(pairs[k].stamp_ns, noisy(old.left, 8.0, random), noisy(old.right, 8.0, random))
    estimates = run(pairs, localiser())
    for k in range(6, 10):
        assert (estimates[k].state, estimates[k].reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)
        assert errors(estimates[k], true_pose(k))[0] < 3 * np.sqrt(np.trace(estimates[k].covariance[:3, :3]))
    assert [estimate.state for estimate in estimates[10:]] == [TrackingState.TRACKING] * 2
    assert errors(estimates[-1], true_pose(11))[0] < 0.005


def test_a_frozen_pair_that_is_also_swapped_does_not_hide_that_later_pairs_are_frozen() -> None:
    random = np.random.default_rng(1)
    pairs = [StereoPair(p.stamp_ns, noisy(p.left, 1.5, random), noisy(p.right, 1.5, random)) for p in DRIVE[:10]]
    old = pairs[5]
    for k in range(6, 10):
        sides = (old.right, old.left) if k in (6, 9) else (old.left, old.right)
        pairs[k] = StereoPair(pairs[k].stamp_ns, *(noisy(side, 3.0, random) for side in sides))
    for estimate in run(pairs, localiser())[6:]:
        assert (estimate.state, estimate.reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)


@pytest.mark.parametrize(("side", "level"), [("left", 0.0), ("right", 0.0), ("left", 0.15), ("right", 0.15)])
def test_one_frozen_camera_is_not_used(side: str, level: float) -> None:
    random = np.random.default_rng(1)
    frozen = [replace(DRIVE[k], **{side: noisy(getattr(DRIVE[5], side), level, random)}) for k in range(6, 9)]
    estimates = run([*DRIVE[:6], *frozen, *DRIVE[9:12]])
    for index, estimate in enumerate(estimates):
        assert (estimate.state is TrackingState.TRACKING) == (index != 0 and not 6 <= index < 9)
        assert estimate.state is TrackingState.LOST or errors(estimate, true_pose(index))[0] < 0.01
        if 6 <= index < 9:  # even if tracking is lost because the frozen image is blanked
            assert estimate.reason is StateReason.REPEATED_IMAGES


def test_lost_tracking_is_reported_with_the_frozen_camera_and_not_with_the_image_that_was_blanked() -> None:
    """The right image contains noise alone, so that the pose is lost without the left image."""
    noise = np.random.default_rng(1).integers(0, 255, DRIVE[6].right.shape, np.uint8)
    estimate = run([*DRIVE[:6], replace(DRIVE[6], left=DRIVE[5].left, right=noise)])[-1]
    assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.REPEATED_IMAGES)
    black = replace(DRIVE[6], left=DRIVE[5].left, right=np.zeros_like(noise))
    estimate = run([*DRIVE[:6], black])[-1]
    assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.UNTEXTURED_IMAGES)


def test_no_window_begins_with_images_of_two_moments() -> None:
    """The left image of the second pair is that of the first one, so that depths would be wrong."""
    one_sided = replace(DRIVE[0], right=np.zeros_like(DRIVE[0].right))
    estimates = run([one_sided, replace(DRIVE[4], left=DRIVE[0].left), DRIVE[5]])
    assert [(estimate.state, estimate.reason) for estimate in estimates] == [
        (TrackingState.LOST, StateReason.UNTEXTURED_IMAGES),
        (TrackingState.LOST, StateReason.REPEATED_IMAGES),
        (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION),
    ]


def test_two_frozen_images_are_a_repeated_pair_although_their_sky_changed() -> None:
    """The sky has no texture, so that only its brightness changes between the two pairs."""

    def with_sky(pair: StereoPair, stamp_ns: int, level: int) -> StereoPair:
        sides = [np.concatenate((np.full_like(s[:30], level), s[30:])) for s in (pair.left, pair.right)]
        return StereoPair(stamp_ns, *sides)

    pairs = [with_sky(pair, pair.stamp_ns, 200) for pair in DRIVE[:8]]
    pairs[6:] = [with_sky(DRIVE[5], DRIVE[number].stamp_ns, 203) for number in (6, 7)]
    for estimate in run(pairs)[6:]:
        assert (estimate.state, estimate.reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)


def test_a_frozen_image_does_not_hide_the_stale_rows_of_the_other_one() -> None:
    new = torn(DRIVE[6], DRIVE[5], HEIGHT // 2)
    memory = compare(DRIVE[5], None).memory
    pair = replace(new, left=DRIVE[5].left)
    images = compare(pair, memory)
    assert check_images(pair, images, has_map=True) == {Finding.FROZEN_IMAGE, Finding.STALE_ROWS}
    assert not images.pair.left.any()
    assert not images.pair.right[HEIGHT // 2 :].any()
    assert images.pair.right[: HEIGHT // 2].any()
    assert images.blanked_rows[HEIGHT // 2 :].all()


@pytest.mark.parametrize("is_fixed", [False, True])
@pytest.mark.parametrize("side", ["left", "right"])
def test_rows_that_repeat_after_a_frozen_image_are_blanked_unless_they_repeated_before(
    side: str, is_fixed: bool
) -> None:
    half = HEIGHT // 2
    last = torn(DRIVE[5], DRIVE[4], half) if is_fixed else DRIVE[5]
    frozen = replace(DRIVE[6], **{side: getattr(last, side)})
    memory = None
    for pair in (DRIVE[4], last, frozen, torn(DRIVE[7], last, half)):
        images = compare(pair, memory)
        memory = images.memory
    assert getattr(images.pair, side)[half:].any() == is_fixed
    assert getattr(images.pair, side)[:half].any()


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_torn_image_is_read_where_it_is_new(share: float) -> None:
    broken = torn(DRIVE[6], DRIVE[5], round((1.0 - share) * HEIGHT))
    estimates = run([*DRIVE[:6], broken, *DRIVE[7:9]])
    assert (estimates[6].state, estimates[6].reason) == (TrackingState.DEGRADED, StateReason.TORN_IMAGES)
    assert errors(estimates[6], true_pose(6))[0] < 0.004
    assert [estimate.state for estimate in estimates[7:]] == [TrackingState.TRACKING] * 2


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_tear_that_was_never_shown_is_told_and_leaves_the_map_as_it_was(share: float) -> None:
    random, pairs, old = np.random.default_rng(0), DRIVE[:12], DRIVE[7]  # what was shown of the old one had other noise
    other = StereoPair(0, noisy(old.left, 1.0, random), noisy(old.right, 1.0, random))
    pairs[8] = torn(DRIVE[8], other, round(HEIGHT * (1.0 - share)))
    estimates = run(pairs)
    assert (estimates[8].state, estimates[8].reason) == (TrackingState.DEGRADED, StateReason.TORN_IMAGES)
    assert errors(estimates[8], true_pose(8))[0] < 3.0 * np.sqrt(np.trace(estimates[8].covariance[:3, :3]))
    for index in (9, 10, 11):
        assert estimates[index].state is TrackingState.TRACKING
        assert errors(estimates[index], true_pose(index))[0] < 0.003
        assert estimates[index].statistics.masked_share == 0.0
    for late_or_after in (estimates[8].step, estimates[9].step):
        assert late_or_after is not None
        assert late_or_after.covariance[0, 0] > 0.05**2
