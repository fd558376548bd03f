"""Settings of the simulation: each has an effect."""

from __future__ import annotations

import re
from pathlib import Path

import sfr_loc_map.simulation
from sfr_loc_map.config import flatten
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.shading import ShadingParameters
from sfr_loc_map.simulation.terrain import TerrainParameters


def test_each_setting_is_read() -> None:
    folder = Path(sfr_loc_map.simulation.__file__).parent
    text = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py") if path.name != "config.py")
    by_name = {*TerrainParameters._fields, *ShadingParameters._fields}  # taken from the settings of the same name
    settings = [name.rpartition(".")[2] for name in flatten(SimulationConfig())]
    unread = [name for name in settings if name not in by_name and not re.search(rf"\.{name}\b", text)]
    assert not unread
