"""Torn images whose old part was never shown: the landmarks on the two sides of the tear follow two motions."""

from __future__ import annotations

import numpy as np
import pytest
from loc_drive import drive, errors, noisy, run
from made_scene import HEIGHT, true_pose

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.localisation.frontend.motion_segmentation import Unexplained
from sfr_loc_map.localisation.torn_images import (
    MAX_DOUBTED_PAIRS,
    MAX_TEARS,
    TearWatch,
    Wholeness,
    has_tear,
)

ROWS = np.linspace(0.5, 99.5, 200)


def seen(agree: np.ndarray, rows: np.ndarray = ROWS) -> Unexplained:
    """Return landmarks in view at these rows, which agree with a pose or do not."""
    yes = np.ones(len(rows), np.bool_)
    return Unexplained(np.column_stack((rows, rows)), yes, ~agree, ~yes)


@pytest.mark.parametrize("share", [0.3, 0.4, 0.7])
def test_a_tear_that_was_never_shown_is_told_and_leaves_the_map_as_it_was(share: float) -> None:
    random, row = np.random.default_rng(0), round(HEIGHT * (1.0 - share))
    pairs = drive(12)
    new, old = pairs[8], pairs[7]  # what was shown of the old one had other noise
    torn = (
        np.concatenate((getattr(new, side)[:row], noisy(getattr(old, side)[row:], 1.0, random)))
        for side in ("left", "right")
    )
    pairs[8] = StereoPair(new.stamp_ns, *torn)
    estimates = run(pairs)
    assert (estimates[8].state, estimates[8].reason) == (TrackingState.DEGRADED, StateReason.TORN_IMAGES)
    assert errors(estimates[8], true_pose(8))[0] < 3.0 * np.sqrt(np.trace(estimates[8].covariance[:3, :3]))
    for index in (9, 10, 11):
        assert estimates[index].state is TrackingState.TRACKING
        assert errors(estimates[index], true_pose(index))[0] < 0.003
        assert estimates[index].statistics.masked_share == 0.0
    late, after = (estimates[index].step for index in (8, 9))
    assert late is not None
    assert after is not None
    assert min(late.covariance[0, 0], after.covariance[0, 0]) > 0.05**2


def test_a_row_that_separates_two_motions_is_a_tear_and_scattered_outliers_are_none() -> None:
    random = np.random.default_rng(0)
    assert has_tear(seen(ROWS > 30.0))
    assert has_tear(seen(ROWS < 60.0))
    assert has_tear(seen((ROWS > 30.0) & (random.random(200) > 0.1)))
    assert not has_tear(seen(random.random(200) > 0.3))
    assert not has_tear(seen(ROWS > 10.0))  # too few to tell
    assert not has_tear(seen(np.abs(ROWS - 50.0) > 25.0))
    assert not has_tear(seen(np.zeros(0, np.bool_), np.zeros(0)))


def test_two_motions_that_stay_are_a_moving_region() -> None:
    watch, torn, whole = TearWatch(), seen(ROWS > 30.0), seen(ROWS > 0.0)
    assert [watch.is_torn([torn, torn]) for _ in range(MAX_TEARS + 2)] == [True] * MAX_TEARS + [False] * 2
    assert not watch.is_torn([torn, whole])  # one motion explains both sides: the other was not found right
    assert watch.is_torn([torn, torn])


def test_pairs_after_a_tear_are_doubted_until_both_of_its_sides_agree() -> None:
    watch, stale = TearWatch(), np.arange(100) >= 40
    assert watch.judge(seen(ROWS > 50.0)) is Wholeness.WHOLE  # none was torn
    watch.tear(stale)
    assert watch.judge(seen(ROWS > 40.0)) is Wholeness.TORN
    assert watch.judge(seen(ROWS[100:] > 0.0, ROWS[100:])) is Wholeness.UNPROVEN  # nothing is seen of the new part
    assert watch.judge(seen(ROWS > 15.0)) is Wholeness.WHOLE
    assert watch.judge(seen(ROWS > 40.0)) is Wholeness.WHOLE


def test_what_is_never_proven_is_not_doubted_for_ever() -> None:
    watch, below = TearWatch(), seen(ROWS[100:] > 0.0, ROWS[100:])
    watch.tear(np.arange(100) >= 40)
    judged = [watch.judge(below) for _ in range(MAX_DOUBTED_PAIRS + 1)]
    assert judged == [Wholeness.UNPROVEN] * MAX_DOUBTED_PAIRS + [Wholeness.WHOLE]
