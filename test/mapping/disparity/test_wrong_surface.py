"""The network beside jumps belongs to the constants that its features are made with."""

import json
from importlib.resources import files

from sfr_loc_map.mapping.disparity import matching_cost, surfaces, wrong_surface


def test_the_network_was_trained_with_the_constants_of_the_code() -> None:
    """After a change of one of them: tools/train_jump_network.py."""
    stored = files("sfr_loc_map.mapping.disparity").joinpath("jump_network.json").read_text(encoding="utf-8")
    trained = json.loads(stored)["constants"]
    present = vars(matching_cost) | vars(surfaces) | vars(wrong_surface)
    assert len(trained) == 14
    assert {name: round(float(present[name]), 4) for name in trained} == trained


def test_the_network_has_an_input_for_each_feature() -> None:
    network = wrong_surface.jump_network()
    count = len(wrong_surface.JumpFeatures._fields)
    assert network.low.shape == network.high.shape == (count,)
    assert network.hidden.shape == (len(network.output), count)
