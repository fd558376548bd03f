"""Whether a pair shows enough corners to begin a window after lost tracking."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.loc_drive import drive
from helpers.made_scene import LOC_RIG, WIDTH
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker
from sfr_loc_map.localisation.keyframes import max_corners
from sfr_loc_map.localisation.relocalisation import Relocaliser

MAX_FEATURES = 100


def relocaliser_of(rig: StereoRig, config: LocalisationConfig) -> Relocaliser:
    """Return the relocaliser of a rig."""
    return Relocaliser(Tracker(config.min_tracked, rig.camera), config, rig.camera, max_corners(rig, config))


@pytest.mark.parametrize("map_per_limit", [1, 2, 3, 10])
def test_a_map_of_any_size_can_begin_a_window_with_a_textured_pair(map_per_limit: int) -> None:
    """No more than about `max_features` corners are found, however many landmarks the map has. Half of them suffice."""
    relocaliser = relocaliser_of(LOC_RIG, LocalisationConfig(max_features=MAX_FEATURES))
    pair = drive(1)[0]
    landmark_count = map_per_limit * MAX_FEATURES
    assert relocaliser.is_good_image(StereoFrame.of(pair), landmark_count)
    left = pair.left.copy()
    left[:, 3 * WIDTH // 4 :] = 128
    assert relocaliser.is_good_image(StereoFrame.of(StereoPair(0, left, pair.right)), landmark_count)
    left[:, WIDTH // 4 :] = 128
    assert not relocaliser.is_good_image(StereoFrame.of(StereoPair(0, left, pair.right)), landmark_count)


@pytest.mark.parametrize(("textured", "is_good"), [(0.4, False), (0.6, True)])
def test_a_window_of_a_large_image_begins_with_half_the_corners(textured: float, is_good: bool) -> None:
    """A keyframe of a large image has twice as many landmarks, and a good image must show half of them."""
    side = 1024
    rig = StereoRig(side, side, 800.0, 800.0, 512.0, 512.0, 0.1, LOC_RIG.T_rb_sb)
    config = LocalisationConfig(max_features=200)
    image = np.full((side, side), 128, np.uint8)
    rows = round(textured * side)
    image[:rows] = np.random.default_rng(0).integers(0, 255, (rows, side))
    frame = StereoFrame.of(StereoPair(0, image, image))
    assert relocaliser_of(rig, config).is_good_image(frame, max_corners(rig, config)) is is_good
