"""The files of a map: cloud, elevation models, covariances.

All files of an elevation model contain the same grid as the topics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.point_covariance import point_covariances
from sfr_loc_map.mapping.terrain.shaded_relief import shaded_heights
from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid, terrain_grid
from sfr_loc_map.runs import geotiff
from sfr_loc_map.runs.mapper_run import MapRun
from sfr_loc_map.suffixes import check_suffix, suffix_of

DEM_SUFFIXES = (".npz", *geotiff.SUFFIXES, ".png")  #: Suffixes of files of an elevation model.


@dataclass(frozen=True, slots=True)
class MapOutputs:
    """The files to write."""

    cloud: Path
    fuse: bool  # whether the cloud is fused; otherwise it contains the points of every pair
    dem: Sequence[Path]  # files of an elevation model
    terrain: TerrainConfig  # parameters of the elevation model and its other layers
    covariance: bool  # whether to write the covariance of each point

    @property
    def covariances(self) -> Path | None:
        """File of the covariances, beside the cloud; None if not requested."""
        return self.cloud.with_suffix(".covariance.npz") if self.covariance else None

    @property
    def more(self) -> list[Path]:
        """Files besides the cloud."""
        return [*self.dem, *([] if self.covariances is None else [self.covariances])]


def save_map(
    run: MapRun,
    focal_px: float,
    outputs: MapOutputs,
    secondary_output: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> PointCloud:
    """Write the files of a map, and return the cloud.

    Each other file is written within a `secondary_output`, which may convert its errors.
    """
    cloud = run.fused.cloud if outputs.fuse else run.unfused
    save_cloud(outputs.cloud, cloud)
    if not outputs.more:
        return cloud
    poses_lm_left, random_sigma = run.fused.poses_lm_left, run.fused.random_sigma
    if not outputs.fuse:
        poses_lm_left = tuple(item.T_lm_left for item in run.maps)
        random_sigma = np.concatenate([item.random_sigma for item in run.maps])
    if outputs.dem:
        with secondary_output():
            load_kernels("terrain")
            grid = terrain_grid(cloud, outputs.terrain, poses_lm_left, random_sigma)
            for path in outputs.dem:
                with secondary_output():
                    save_dem(path, grid)
    if outputs.covariances is not None:
        with secondary_output(), atomic_path(outputs.covariances) as temporary:
            covariances = point_covariances(cloud, poses_lm_left, focal_px)
            np.savez_compressed(temporary, covariance_m2=covariances, random_sigma_m=random_sigma)
    return cloud


# ---- elevation models


def check_dems(files: Sequence[Path]) -> None:
    """Raise OutputError or MissingExtraError if elevation models with these names cannot be written."""
    for file in files:
        check_suffix(file, DEM_SUFFIXES)
    if any(suffix_of(file) in geotiff.SUFFIXES for file in files):
        geotiff.load_rasterio()


def save_dem(path: Path, grid: TerrainGrid) -> None:
    """Write a grid in the format that the ending of the name gives."""
    model, suffix = grid.elevation, suffix_of(path)
    if suffix in geotiff.SUFFIXES:
        bands = [
            geotiff.Band("height", "m", model.height_m),
            geotiff.Band("sigma", "m", model.sigma_m),
            geotiff.Band("count", "points", model.count.astype(np.float32)),
            geotiff.Band("slope", "rad", grid.slope_rad),
            geotiff.Band("roughness", "m", grid.roughness_m),
            geotiff.Band("step", "m", grid.step_m),
            geotiff.Band("hazard", "percent", np.where(grid.hazard < 0, np.nan, grid.hazard).astype(np.float32)),
        ]
        geotiff.save_geotiff(path, bands, model.origin_m, model.cell_m)
        return
    with atomic_path(path) as temporary:
        if suffix == ".npz":
            of_model = {name: getattr(model, name) for name in ("height_m", "sigma_m", "count", "origin_m", "cell_m")}
            others = {name: getattr(grid, name) for name in ("slope_rad", "roughness_m", "step_m", "hazard")}
            with temporary.open("wb") as stream:  # numpy appends .npz to any other name, such as x.NPZ
                np.savez_compressed(stream, **of_model, **others)
        elif not cv2.imwrite(str(temporary), shaded_heights(model)):
            raise OutputError(
                f"cannot write '{path}': OpenCV could not encode or write the image; check the free space, or choose a "
                "name that ends in .npz"
            )
