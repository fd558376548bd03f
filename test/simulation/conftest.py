"""The configuration of a small world for the tests of the simulation."""

from collections.abc import Callable

import pytest

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.simulation.config import SimulationConfig

SMALL = {
    "terrain.coarseness": 4.0,
    "seed": 5,
    "rocks.smallest_m": 0.06,
    "terrain.hills_m": 0.4,
    "loc.width": 96,
    "loc.height": 80,
    "loc.focal_px": 75.0,
    "nav.width": 200,
    "nav.height": 160,
    "nav.focal_px": 150.0,
    "panorama.pan_deg": [10.0, -20.0],
    "panorama.tilt_deg": [25.0, 25.0],
    "drive.segments": ["straight 0.4", "turn 5", "stop 0.5"],
    "drive.vibration_deg": 0.05,
}


Maker = Callable[..., SimulationConfig]


def small_config(**changes: object) -> SimulationConfig:
    """Make a small configuration; `__` in a name stands for a dot."""
    values = dict(SMALL)
    values.update({name.replace("__", "."): value for name, value in changes.items()})
    return build(SimulationConfig, values)


@pytest.fixture(scope="session")
def config() -> Maker:
    """What makes small configurations."""
    return small_config
