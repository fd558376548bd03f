"""Visualisation of the tracks: what is drawn where, in which colour."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_scene import HEIGHT, LOC_RIG, WIDTH, loc_pair, true_pose

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.frontend.tracking import TrackingResult
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import NOT_FOUND, OUTLIER, STATES, STRIP, draw_tracks

BLACK = np.zeros((HEIGHT, WIDTH), np.uint8)


@pytest.fixture(scope="module")
def seen() -> tuple[TrackingResult, PoseEstimate]:
    localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    assert localiser.last_result is None
    for index in range(2):
        estimate = localiser.process(loc_pair(index))
    assert localiser.last_result is not None
    return localiser.last_result, estimate


def shown(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return np.argwhere((image[2 : HEIGHT - 2, 2 : WIDTH - 2] == colour).all(axis=2)) + 2


def test_nothing_looked_for_leaves_the_image_in_its_frame(seen: tuple[TrackingResult, PoseEstimate]) -> None:
    left = loc_pair(0).left
    image = draw_tracks(left, None, seen[1])
    assert image.shape == (HEIGHT + STRIP, WIDTH, 3)
    np.testing.assert_array_equal(image[2 : HEIGHT - 2, 2 : WIDTH - 2, 1], left[2:-2, 2:-2] // 4 * 3)


@pytest.mark.parametrize("state", list(TrackingState))
def test_frame_and_caption_have_the_colour_of_the_state(
    seen: tuple[TrackingResult, PoseEstimate], state: TrackingState
) -> None:
    image = draw_tracks(BLACK, None, replace(seen[1], state=state))
    assert tuple(image[0, 0]) == STATES[state]
    assert image[HEIGHT:].max(axis=(0, 1)).tolist() == list(STATES[state])


def test_landmarks_are_drawn_where_they_are_seen(seen: tuple[TrackingResult, PoseEstimate]) -> None:
    tracked, estimate = seen
    image = draw_tracks(BLACK, tracked, estimate)
    places = np.rint(tracked.observations[tracked.inliers, :2]).astype(int)
    assert len(places) > 30
    assert (image[places[:, 1], places[:, 0]].max(axis=1) > 150).all()


def test_outliers_and_missing_ones_have_their_own_colours(seen: tuple[TrackingResult, PoseEstimate]) -> None:
    tracked, estimate = seen
    chi2, observations = np.full(len(tracked.inliers), np.nan), np.full_like(tracked.observations, np.nan)
    first = int(np.flatnonzero(tracked.inliers)[0])
    chi2[first], observations[first] = 50.0, tracked.observations[first]
    image = draw_tracks(BLACK, replace(tracked, chi2_per_dof=chi2, observations=observations), estimate)
    rows = shown(image, OUTLIER)
    assert len(rows)
    assert np.abs(rows[:, ::-1] - observations[first, :2]).max() < 6
    assert len(shown(image, NOT_FOUND)) > 30


def test_a_lost_pair_shows_what_was_tried() -> None:
    localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    localiser.process(loc_pair(0))
    estimate = localiser.process(StereoPair(loc_pair(1).stamp_ns, BLACK, BLACK))
    assert estimate.state is TrackingState.LOST
    assert localiser.last_result is not None
    assert len(shown(draw_tracks(BLACK, localiser.last_result, estimate), NOT_FOUND)) > 30
