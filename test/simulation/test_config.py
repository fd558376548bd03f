"""Every scenario of config/simulation is valid and gives what its name says."""

from pathlib import Path

import pytest

from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.inputs import Task
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.drive import Plan

FOLDER = Path(__file__).resolve().parents[2] / "config" / "simulation"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


def plan(name: str) -> Plan:
    return Plan.make(build(SimulationConfig, load_yaml(FOLDER / f"{name}.yaml"), origin=name))


@pytest.mark.parametrize("name", NAMES)
def test_scenario_makes_pairs(name: str) -> None:
    made = plan(name)
    assert made.count(Task.MAPPING) == (3 if name in ("mapping_panorama", "sample") else 0)
    assert made.count(Task.LOCALISATION) >= (0 if name == "mapping_panorama" else 75)
