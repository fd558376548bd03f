"""Whether a pair shows enough corners to begin a window after lost tracking."""

from __future__ import annotations

import pytest

from helpers.loc_drive import drive
from helpers.made_scene import LOC_RIG, WIDTH, true_pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.tracking import StereoFrame
from sfr_loc_map.localisation.localiser import Localiser

MAX_FEATURES = 100


@pytest.mark.parametrize("map_per_limit", [1, 2, 3, 10])
def test_a_map_of_any_size_can_begin_a_window_with_a_textured_pair(map_per_limit: int) -> None:
    """No more than about `max_features` corners are found, however many landmarks the map has."""
    relocaliser = Localiser(LOC_RIG, LocalisationConfig(max_features=MAX_FEATURES), true_pose(0))._relocaliser
    pair = drive(1)[0]
    landmark_count = map_per_limit * MAX_FEATURES
    assert relocaliser.is_good_image(StereoFrame.of(pair), landmark_count)
    left = pair.left.copy()
    left[:, WIDTH // 4 :] = 128
    assert not relocaliser.is_good_image(StereoFrame.of(StereoPair(0, left, pair.right)), landmark_count)
