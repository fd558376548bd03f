"""Pages of elevation models, for the commands that write them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.cli.output import write_text

if TYPE_CHECKING:
    from sfr_loc_map.mapping.terrain.grid import TerrainGrid


def write_dem_pages(files: Sequence[Path], grid: TerrainGrid) -> None:
    """Write those files of an elevation model that are pages.

    Raises:
        OutputError: If one cannot be written.
    """
    from sfr_loc_map.pipeline.dem_products import PAGE, dem_bands

    pages = [path for path in files if path.suffix == PAGE]
    if not pages:
        return
    from sfr_loc_map.report.dem_page import dem_page

    text = dem_page(dem_bands(grid), grid.elevation.origin_m, grid.elevation.cell_m)
    for path in pages:
        write_text(text, path)
