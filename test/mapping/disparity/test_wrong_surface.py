"""The network beside jumps belongs to the constants, the features and the pixels that it was trained with."""

import importlib.util
import json
from importlib.resources import files
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from helpers import ROOT
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import panorama_of
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.estimation import estimate_disparity
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range_of
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene
from sfr_loc_map.mapping.disparity.validity import jump_network, pixel_status


@pytest.fixture(scope="module")
def trainer() -> ModuleType:
    spec = importlib.util.spec_from_file_location("train", ROOT / "tools" / "train_jump_network.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def stored() -> Any:
    text = files("sfr_loc_map.mapping.disparity.validity").joinpath("jump_network.json").read_text(encoding="utf-8")
    return json.loads(text)


def test_the_network_was_trained_with_the_constants_of_the_code(trainer: ModuleType, stored: Any) -> None:
    assert trainer.feature_constants() == stored["constants"]


def test_the_network_was_trained_with_the_features_and_pixels_of_the_code(trainer: ModuleType, stored: Any) -> None:
    """Processors round differently, so that single pixels may differ."""
    found = trainer.reference_inputs()
    assert found["pixels"] == pytest.approx(stored["reference"]["pixels"], rel=2e-3)
    np.testing.assert_allclose(found["mean_inputs"], stored["reference"]["mean_inputs"], atol=5e-3)


def test_the_scenes_of_the_training_are_those_of_the_mapper(
    trainer: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes: list[DisparityScene] = []

    def recorded(scene: DisparityScene) -> np.ndarray:
        scenes.append(scene)
        return jump_network.wrong_surface_mask(scene)

    monkeypatch.setattr(pixel_status, "wrong_surface_mask", recorded)
    panorama = panorama_of(open_source(trainer.REFERENCE))
    pair = next(iter(panorama.pairs())).pair
    estimate_disparity(pair, panorama.rig, search_range_of(panorama.rig, MappingConfig()))
    for of_mapper, of_training in zip(scenes[0], trainer.scene_of(pair, panorama.rig), strict=True):
        np.testing.assert_array_equal(of_mapper, of_training)


def test_the_network_has_an_input_for_each_feature() -> None:
    network = jump_network.jump_network()
    count = len(jump_network.JumpFeatures._fields)
    assert network.low.shape == network.high.shape == (count,)
    assert network.hidden.shape == (len(network.output), count)
