"""Grids as GeoTIFF: one Float32 band per layer, with names and units, in a local frame without georeference.

The first row of the file has the largest y, as GIS programs expect. Unknown values are NaN, which is the nodata value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import MissingExtraError

SUFFIXES = (".tif", ".tiff")
_LOCAL_CRS = 'LOCAL_CS["lm",LOCAL_DATUM["lm",0],UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A layer of a grid: values `(R, C)`, rows along y, columns along x, NaN if unknown."""

    name: str
    unit: str
    values: NDArray[np.float32]


def save_geotiff(path: Path, bands: Sequence[Band], origin_m: tuple[float, float], cell_m: float) -> None:
    """Write layers of equal shape; `origin_m`: the outer corner of cell (0, 0), which has the smallest x and y."""
    rasterio = load_rasterio()
    rows, columns = bands[0].values.shape
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": len(bands),
        "width": columns,
        "height": rows,
        "nodata": float("nan"),
        "crs": rasterio.crs.CRS.from_wkt(_LOCAL_CRS),
        "transform": rasterio.Affine(cell_m, 0.0, origin_m[0], 0.0, -cell_m, origin_m[1] + rows * cell_m),
        "compress": "deflate",
        "predictor": 3,  # the predictor for floating-point numbers
        "BIGTIFF": "IF_SAFER",
    }
    with rasterio.io.MemoryFile() as memory:
        with memory.open(**profile) as file:
            file.descriptions = [band.name for band in bands]
            file.units = [band.unit for band in bands]
            file.write(np.stack([band.values[::-1] for band in bands]).astype(np.float32, copy=False))
        content = memory.read()
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def load_rasterio() -> Any:  # noqa: ANN401 - a module without types
    """Return the module rasterio; raise MissingExtraError if it is not installed."""
    try:
        import rasterio  # type: ignore[import-untyped]
        import rasterio.crs  # type: ignore[import-untyped]
        import rasterio.io  # type: ignore[import-untyped]
    except ImportError as error:
        raise MissingExtraError(f"GeoTIFF requires rasterio ({error}): pip install 'sfr_loc_map[dem]'") from error
    return rasterio
