"""An elevation model as files: NumPy archive, GeoTIFF, figure. One grid, that of the topics, is in all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.config import build, flatten
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io import geotiff
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud
from sfr_loc_map.mapping.terrain.config import TerrainConfig
from sfr_loc_map.mapping.terrain.grid import TerrainGrid, elevation_grid
from sfr_loc_map.pipeline.dem_figure import save_elevation_figure

PAGE = ".html"
"""Ending of a page of figures, which the command line writes."""
BESIDE = ("dem.npz", "dem.png")
"""Endings of the files beside the cloud that a cell's side alone asks for."""


@dataclass(frozen=True, slots=True)
class DemOutputs:
    """Which files of an elevation model to write.

    Attributes:
        files: Their places; the ending says the format.
        terrain: Size of the cells, and what the other layers need.
    """

    files: tuple[Path, ...]
    terrain: TerrainConfig


def dem_outputs(words: Sequence[str], cloud: Path, terrain: TerrainConfig) -> DemOutputs | None:
    """Return what the values of `--dem` ask for, None without any.

    Args:
        words: Each is the side of a cell in metres (`C.dem.npz` and `C.dem.png`) or a file.
        cloud: The cloud; what has no name of its own lies beside it.
        terrain: Parameters of the grid; a given side replaces theirs.

    Raises:
        ConfigError: If one is neither, two sides are given, or the side is out of range.
        MissingExtraError: If a file needs an extra that is not installed.
    """
    files: list[Path] = []
    sides = []
    for word in words:
        path = Path(word)
        if path.suffix in (*WRITERS, PAGE):
            files.append(path)
        else:
            sides.append(_side(word))
            files += [cloud.with_suffix(f".{ending}") for ending in BESIDE]
    if len(sides) > 1:
        raise ConfigError(f"'--dem' has {len(sides)} sides of a cell: give one, and the names of files")
    if any(file.suffix in geotiff.SUFFIXES for file in files):
        geotiff.check_geotiff()
    return DemOutputs(tuple(files), with_cell(terrain, sides[0]) if sides else terrain) if files else None


def with_cell(terrain: TerrainConfig, cell_m: float) -> TerrainConfig:
    """Return parameters with another side of a cell.

    Raises:
        ConfigError: If it is out of range.
    """
    return build(TerrainConfig, {**flatten(terrain), "cell_m": cell_m}, origin="side of a cell")


def grid_of_file(loaded: LoadedCloud, terrain: TerrainConfig) -> TerrainGrid:
    """Return the grid of a cloud that was read.

    A file does not say where the cameras were: all its points count, and the sigma of heights is overstated. Where it
    has no sigma, all points weigh the same and heights have none.

    Raises:
        InputError: If it has no points.
        MappingError: If there would be too many cells.
    """
    cloud = loaded.cloud
    if not len(loaded.xyz):
        raise InputError("the cloud has no points: an elevation model needs some")
    if cloud is not None and np.isfinite(cloud.sigma).all() and (cloud.sigma > 0).all():
        return elevation_grid(cloud, terrain)
    ones, zeros = np.ones(len(loaded.xyz), np.float32), np.zeros(len(loaded.xyz), np.uint16)
    points = PointCloud(loaded.xyz.astype(np.float32), ones, ones, zeros, zeros, zeros.astype(np.uint8))
    grid = elevation_grid(points, terrain)
    unknown = np.full_like(grid.elevation.sigma_m, np.nan)
    return replace(grid, elevation=replace(grid.elevation, sigma_m=unknown))


def save_dem(path: Path, grid: TerrainGrid) -> None:
    """Write a grid; the format is that of the name's ending (`WRITERS`).

    Raises:
        MissingExtraError: If the format needs an extra that is not installed.
        OutputError: If the file cannot be written.
    """
    WRITERS[path.suffix](path, grid)


def save_npz(path: Path, grid: TerrainGrid) -> None:
    """Write a grid as NPZ.

    Its arrays: `height_m`, `sigma_m`, `count`, `slope_rad`, `roughness_m`, `step_m`, `hazard` (rows along y, columns
    along x of LM), `origin_m` (x and y of the outer corner of cell (0, 0)), `cell_m`.

    Raises:
        OutputError: If the file cannot be written.
    """
    model = grid.elevation
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            height_m=model.height_m,
            sigma_m=model.sigma_m,
            count=model.count,
            slope_rad=grid.slope_rad,
            roughness_m=grid.roughness_m,
            step_m=grid.step_m,
            hazard=grid.hazard,
            origin_m=np.array(model.origin_m),
            cell_m=np.array(model.cell_m),
        )


def dem_bands(grid: TerrainGrid) -> list[geotiff.Band]:
    """Return the layers of a grid by name and unit, float32, NaN where not known (hazard, too)."""
    model = grid.elevation
    hazard = np.where(grid.hazard < 0, np.float32(np.nan), grid.hazard.astype(np.float32))
    return [
        geotiff.Band("height", "m", model.height_m),
        geotiff.Band("sigma", "m", model.sigma_m),
        geotiff.Band("count", "points", model.count.astype(np.float32)),
        geotiff.Band("slope", "rad", grid.slope_rad),
        geotiff.Band("roughness", "m", grid.roughness_m),
        geotiff.Band("step", "m", grid.step_m),
        geotiff.Band("hazard", "percent", hazard),
    ]


def _save_tif(path: Path, grid: TerrainGrid) -> None:
    geotiff.save_geotiff(path, dem_bands(grid), grid.elevation.origin_m, grid.elevation.cell_m)


def _side(word: str) -> float:
    try:
        side = float(word)
    except ValueError as error:
        names = ", ".join(f"*{suffix}" for suffix in (*WRITERS, PAGE))
        raise ConfigError(f"'--dem {word}': give the side of a cell in metres, or a file {names}") from error
    if not side > 0.0:
        raise ConfigError(f"'--dem {side}': the side of a cell must be more than 0")
    return side


WRITERS: dict[str, Callable[[Path, TerrainGrid], None]] = {
    ".npz": save_npz,
    **dict.fromkeys(geotiff.SUFFIXES, _save_tif),
    ".png": lambda path, grid: save_elevation_figure(path, grid.elevation),
}
"""What writes a grid, by the ending of the file."""
