"""A frozen image with new noise is told from a scene that stands still, moves, or changes its brightness."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from loc_drive import drive, errors, localiser, noisy, run
from made_scene import true_pose

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.localisation.frozen_images import is_frozen

SCENE = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 120, (256, 256)), (0, 0), 2.0) + 120.0
SCENE = np.clip(np.rint(SCENE), 0, 255).astype(np.uint8)
NOISE = (0.5, 1.0, 3.0, 8.0)


@pytest.mark.parametrize("level", NOISE)
def test_new_noise_on_an_old_image_is_frozen_and_two_exposures_are_not(level: float) -> None:
    random = np.random.default_rng(0)
    exposed = [noisy(SCENE, level, random) for _ in range(6)]
    assert not any(is_frozen(first, second) for first, second in pairwise(exposed))
    old = noisy(SCENE, 2.0, random)
    assert all(is_frozen(old, noisy(old, level, random)) for _ in range(5))


@pytest.mark.parametrize("level", [0.12, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4])
def test_noise_that_changes_few_pixels_is_frozen_and_two_exposures_with_it_are_not(level: float) -> None:
    random = np.random.default_rng(0)
    fine = np.clip(SCENE + random.normal(0, 3.0, SCENE.shape), 0, 255)  # between the grey levels
    old = np.rint(fine).astype(np.uint8)
    assert is_frozen(old, noisy(old, level, random))
    assert not is_frozen(noisy(fine, level, random), noisy(fine, level, random))


def test_one_pixel_makes_no_new_exposure() -> None:
    changed = SCENE.copy()
    changed[101, 57] += 1
    assert is_frozen(SCENE, changed)


def test_what_moves_or_is_equal_or_dark_is_not_frozen() -> None:
    random = np.random.default_rng(0)
    pairs = drive(6)
    assert not any(is_frozen(a.left, b.left) for a, b in pairwise(pairs))
    assert not is_frozen(SCENE, SCENE)
    dark = np.zeros_like(SCENE)
    assert not is_frozen(dark, noisy(dark, 2.0, random))


def test_frozen_pair_with_new_noise_is_degraded_with_a_covariance_that_contains_the_motion() -> None:
    random, pairs = np.random.default_rng(1), drive(12)
    pairs = [StereoPair(p.stamp_ns, noisy(p.left, 1.5, random), noisy(p.right, 1.5, random)) for p in pairs]
    old = pairs[5]
    for k in range(6, 10):
        pairs[k] = StereoPair(pairs[k].stamp_ns, noisy(old.left, 8.0, random), noisy(old.right, 8.0, random))
    estimates = run(pairs, localiser())
    for k in range(6, 10):
        assert (estimates[k].state, estimates[k].reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)
        assert errors(estimates[k], true_pose(k))[0] < 3 * np.sqrt(np.trace(estimates[k].covariance[:3, :3]))
    assert [estimate.state for estimate in estimates[10:]] == [TrackingState.TRACKING] * 2
    assert errors(estimates[-1], true_pose(11))[0] < 0.005


@pytest.mark.parametrize("sides", [("left",), ("right",), ("left", "right")])
def test_a_camera_that_repeats_all_but_a_few_pixels_is_not_tracked(sides: tuple[str, ...]) -> None:
    random, pairs = np.random.default_rng(1), drive(12)
    for k in (6, 7):
        old = {side: noisy(getattr(pairs[5], side), 0.15, random) for side in sides}
        pairs[k] = replace(pairs[k], **old)
    estimates = run(pairs, localiser())
    for k in (6, 7):
        assert estimates[k].state is not TrackingState.TRACKING
        assert estimates[k].reason is StateReason.REPEATED_IMAGES or estimates[k].state is TrackingState.LOST
    assert estimates[11].state is TrackingState.TRACKING
    assert errors(estimates[11], true_pose(11))[0] < 0.005


def test_rover_that_stands_still_is_tracked() -> None:
    random, still = np.random.default_rng(1), drive(4)
    pairs = [*still, *(StereoPair(still[3].stamp_ns + k, still[3].left, still[3].right) for k in range(1, 6))]
    pairs = [StereoPair(p.stamp_ns, noisy(p.left, 1.5, random), noisy(p.right, 1.5, random)) for p in pairs]
    assert [estimate.state for estimate in run(pairs, localiser())][1:] == [TrackingState.TRACKING] * 8
