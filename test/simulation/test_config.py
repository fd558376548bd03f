"""Every scenario of config/simulation is valid and gives what its name says; wrong settings are refused."""

from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.errors import ConfigError
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


@pytest.mark.slow
def test_long_drive_is_longer_than_100_m() -> None:
    positions = plan("long_drive").trajectory().positions
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() > 100.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"terain.relief_m": 1.0}, "unknown key 'terain.relief_m'.*terrain.relief_m"),
        ({"terrain.relief_m": -1.0}, "must lie in"),
        ({"drive.segments": "straight 3"}, "tuple is needed"),
        ({"light.sun_elevation_deg": 0.0}, "must lie in"),
        ({"seed": 1.5}, "int is needed"),
    ],
)
def test_wrong_settings_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(SimulationConfig, values)
