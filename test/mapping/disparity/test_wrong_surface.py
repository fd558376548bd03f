"""The network beside jumps belongs to the constants, the features and the pixels that it was trained with."""

import importlib.util
import json
from importlib.resources import files
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from helpers import ROOT
from sfr_loc_map.mapping.disparity import jump_network


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
    text = files("sfr_loc_map.mapping.disparity").joinpath("jump_network.json").read_text(encoding="utf-8")
    return json.loads(text)


def test_the_network_was_trained_with_the_constants_of_the_code(trainer: ModuleType, stored: Any) -> None:
    assert trainer.feature_constants() == stored["constants"]


def test_the_network_was_trained_with_the_features_and_pixels_of_the_code(trainer: ModuleType, stored: Any) -> None:
    """Processors round differently, so that single pixels may differ."""
    found = trainer.reference_inputs()
    assert found["pixels"] == pytest.approx(stored["reference"]["pixels"], rel=2e-3)
    np.testing.assert_allclose(found["mean_inputs"], stored["reference"]["mean_inputs"], atol=5e-3)


def test_the_network_has_an_input_for_each_feature() -> None:
    network = jump_network.jump_network()
    count = len(jump_network.JumpFeatures._fields)
    assert network.low.shape == network.high.shape == (count,)
    assert network.hidden.shape == (len(network.output), count)
