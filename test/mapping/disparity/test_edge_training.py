"""The program that trains the network: on evidence whose answer is known."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.edge_evidence import FIGURES
from sfr_loc_map.mapping.disparity.edge_network import Network, log_odds

PROGRAM = Path(__file__).parents[3] / "tools" / "train_edge_network.py"


@pytest.fixture(scope="module")
def program() -> ModuleType:
    spec = importlib.util.spec_from_file_location("train_edge_network", PROGRAM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_learns_what_no_linear_function_can_tell(program: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels are wrong where one figure is far from 0, on either side."""
    monkeypatch.setattr(program, "BATCH", 64)
    random = np.random.default_rng(0)
    evidence = random.normal(size=(8000, FIGURES))
    error_px = np.where(np.abs(evidence[:, 0]) > 0.7, 1.5, 0.1)
    weights = program.train(evidence, error_px, random)
    network = Network(*(np.asarray(weights[name], np.float32) for name in Network._fields))
    odds = log_odds(network, random.normal(size=(0, FIGURES)).astype(np.float32))
    assert odds.shape == (0,)
    unseen = random.normal(size=(2000, FIGURES)).astype(np.float32)
    assert ((log_odds(network, unseen) > 0.0) == (np.abs(unseen[:, 0]) > 0.7)).mean() > 0.93
