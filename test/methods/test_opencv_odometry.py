"""The reference odometry with OpenCV."""

import numpy as np

from helpers.made_scene import LOC_RIG, loc_pair
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.suite_names import Task


def test_black_images_are_lost_and_no_finding() -> None:
    """OpenCV finds no corners in them."""
    image = np.zeros(loc_pair(0).left.shape, np.uint8)
    pairs = [StereoPair(number * 100_000_000, image, image) for number in range(3)]
    with IsolatedLocaliser(
        find_method("opencv", Task.LOCALISATION), LOC_RIG, Transform.identity(), hidden=()
    ) as method:
        made = [method.localise(pair) for pair in pairs]
    assert [call.finding for _, call in made] == ["", "", ""]
    assert [estimate.state.value for estimate, _ in made[1:]] == ["lost", "lost"]
