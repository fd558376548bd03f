"""The part of `sfr convert` that takes clouds: to other formats, or to their elevation model."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.cli.common import naming
from sfr_loc_map.cli.dem import write_dem_pages
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import check_outputs, check_suffix, say
from sfr_loc_map.errors import ConfigError, InputError

CLOUDS = (".ply", ".pcd", ".npz", ".las", ".laz")
"""Endings of files of points; the same as `io.cloud_file.SUFFIXES`, which takes long to import."""
MODELS = (".tif", ".tiff", ".png", ".html")
ARCHIVE = ".dem.npz"
"""Endings of files of an elevation model; an archive of points ends in .npz, too."""


def is_cloud(path: Path) -> bool:
    """Tell whether a name is that of a file of points."""
    return path.suffix in CLOUDS and not path.is_dir()


def convert_cloud(source: Path, destination: Path, cell_m: float | None, *, overwrite: bool) -> None:
    """Write a cloud in another format, or its elevation model.

    Args:
        source: The cloud.
        destination: Where to; the ending says what.
        cell_m: Side of the cells of an elevation model, None for the default.
        overwrite: Whether a file that exists may be replaced.

    Raises:
        InputError: If the cloud cannot be read.
        ConfigError: If a side is given where no elevation model is written, or is out of range.
        OutputError: If the file cannot be written.
    """
    is_model = destination.suffix in MODELS or destination.name.endswith(ARCHIVE)
    check_suffix(destination, (*CLOUDS, ARCHIVE, *MODELS) if not is_model else (destination.suffix,))
    check_outputs(destination, overwrite=overwrite, inputs=(source,))
    if is_model:
        _to_model(source, destination, cell_m)
    elif cell_m is not None:
        raise ConfigError(f"'--cell' is of an elevation model: '{destination}' will be a cloud")
    else:
        _to_cloud(source, destination)


def _to_cloud(source: Path, destination: Path) -> None:
    from sfr_loc_map.io.cloud_file import check_cloud_format, load_cloud, save_cloud

    check_cloud_format(destination)
    cloud = load_cloud(source).cloud
    if cloud is None:
        raise InputError(
            f"cloud '{source}' does not say the pixel and pair of each point (u, v, pair): clouds of other programs "
            "can be scored and become elevation models, they are not written again"
        )
    save_cloud(destination, cloud)
    say(f"{len(cloud)} points: {destination}", err=True)
    propose("sfr", "score", destination, "SRC", why="against the truth of the mapping pairs")


def _to_model(source: Path, destination: Path, cell_m: float | None) -> None:
    from sfr_loc_map.io import geotiff
    from sfr_loc_map.io.cloud_file import load_cloud
    from sfr_loc_map.mapping.terrain.config import TerrainConfig
    from sfr_loc_map.pipeline.dem_products import WRITERS, grid_of_file, save_dem, with_cell

    if destination.suffix in geotiff.SUFFIXES:
        geotiff.check_geotiff()
    terrain = TerrainConfig() if cell_m is None else with_cell(TerrainConfig(), cell_m)
    with naming(source):
        grid = grid_of_file(load_cloud(source), terrain)
    if destination.suffix in WRITERS:
        save_dem(destination, grid)
    write_dem_pages([destination], grid)
    rows, columns = grid.hazard.shape
    say(f"{columns} x {rows} cells of {grid.elevation.cell_m:g} m: {destination}", err=True)
    if destination.suffix in geotiff.SUFFIXES:
        propose("gdalinfo", destination, why="its bands; QGIS opens it")
    else:
        propose("sfr", "convert", source, destination.with_suffix(".html"), why="all layers as a page")
