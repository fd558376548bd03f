"""Parameters of the elevation and hazard grids."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param


@dataclass(frozen=True, slots=True)
class TerrainConfig:
    """Parameters of the elevation and hazard grids; the rover's are those of a medium rover of six wheels."""

    cell_m: float = param(0.1, unit="m", doc="Side of a cell of the elevation and hazard grids.", low=0.01, high=10.0)
    range_m: float = param(
        10.0,
        unit="m",
        doc="Points further than this from the mean of the cameras along x or y are left out of the grids.",
        low=0.5,
        high=1000.0,
    )
    min_points: int = param(3, unit="points", doc="A cell with fewer points has no height.", low=1, high=1000)
    footprint_radius_m: float = param(
        0.5,
        unit="m",
        doc="Radius of the rover's footprint: slope and roughness are those of the ground within it, and a step "
        "anywhere within it makes a hazard.",
        low=0.0,
        high=10.0,
    )
    step_radius_m: float = param(
        0.25, unit="m", doc="A step is a difference of heights within this distance.", low=0.0, high=10.0
    )
    max_slope_deg: float = param(20.0, unit="deg", doc="Slope from which on a cell is a hazard.", low=0.1, high=89.0)
    max_roughness_m: float = param(
        0.05, unit="m", doc="Roughness from which on a cell is a hazard.", low=0.001, high=10.0
    )
    max_step_m: float = param(
        0.18,
        unit="m",
        doc="Step from which on a cell is a hazard; about the radius of a wheel.",
        low=0.001,
        high=10.0,
    )
