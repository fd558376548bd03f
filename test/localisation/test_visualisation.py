"""Landmarks are drawn where they are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from loc_drive import BLACK, drive, localiser
from made_scene import HEIGHT, WIDTH

from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.localisation.visualisation import NOT_FOUND, OUTLIER, STATES, STRIP, draw_tracks


def shown(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return np.argwhere((image[2 : HEIGHT - 2, 2 : WIDTH - 2] == colour).all(axis=2)) + 2


def test_landmarks_and_state_are_drawn() -> None:
    by, pairs = localiser(), drive(2)
    assert by.last_result is None
    estimate = [by.process(pair) for pair in pairs][-1]
    tracked = by.last_result
    assert tracked is not None
    for state in TrackingState:
        image = draw_tracks(BLACK, None, replace(estimate, state=state))
        assert image.shape == (HEIGHT + STRIP, WIDTH, 3)
        assert tuple(image[0, 0]) == STATES[state]
        assert image[HEIGHT:].max(axis=(0, 1)).tolist() == list(STATES[state])
    image = draw_tracks(pairs[1].left, None, estimate)
    np.testing.assert_array_equal(image[2 : HEIGHT - 2, 2 : WIDTH - 2, 1], pairs[1].left[2:-2, 2:-2] // 4 * 3)
    image = draw_tracks(BLACK, tracked, estimate)
    places = np.rint(tracked.observations[tracked.inliers, :2]).astype(int)
    assert len(places) > 30
    assert (image[places[:, 1], places[:, 0]].max(axis=1) > 150).all()
    # one outlier, all others not found
    chi2, observations = np.full(len(tracked.inliers), np.nan), np.full_like(tracked.observations, np.nan)
    first = int(np.flatnonzero(tracked.inliers)[0])
    chi2[first], observations[first] = 50.0, tracked.observations[first]
    image = draw_tracks(BLACK, replace(tracked, chi2_per_dof=chi2, observations=observations), estimate)
    assert np.abs(shown(image, OUTLIER)[:, ::-1] - observations[first, :2]).max() < 6
    assert len(shown(image, NOT_FOUND)) > 30
