"""The files that `sfr map` writes: cloud, elevation models, covariances.

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
from sfr_loc_map.errors import ConfigError, OutputError
from sfr_loc_map.geometry.arrays import ColourImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.clouds import geotiff
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.point_covariance import point_covariances
from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid, terrain_grid
from sfr_loc_map.runs.offline import MapRun

SUFFIXES = (".npz", *geotiff.SUFFIXES, ".png")  # suffixes of files of an elevation model
HEIGHT_QUANTILES = (0.01, 0.99)
"""Quantiles of the heights at the ends of the colour range; heights beyond are clipped."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35
BRIDGED_SHARE = 0.1  # minimum weighted fraction of neighbours with a height for a gap to be filled in the image
VOID = (32, 32, 32)


@dataclass(frozen=True, slots=True)
class MapOutputs:
    """The files to write."""

    cloud: Path  # the file of covariances is written beside it
    fuse: bool  # whether the cloud is fused; otherwise it contains the points of every pair
    dem: Sequence[Path]  # files of an elevation model
    terrain: TerrainConfig  # parameters of the elevation model and its other layers
    covariance: bool  # whether to write the covariance of each point

    @property
    def more(self) -> list[Path]:
        """Files besides the cloud; the file of covariances, if requested, is the last one."""
        return [*self.dem, *([self.cloud.with_suffix(".covariance.npz")] * self.covariance)]


def save_map(
    run: MapRun,
    focal_px: float,
    outputs: MapOutputs,
    secondary_output: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> PointCloud:
    """Write the files of a map, and return the cloud; each other file is written in a context of `secondary_output`."""
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
    if outputs.covariance:
        with secondary_output(), atomic_path(outputs.more[-1]) as temporary:
            covariances = point_covariances(cloud, poses_lm_left, focal_px)
            np.savez_compressed(temporary, covariance_m2=covariances, random_sigma_m=random_sigma)
    return cloud


# ---- elevation models


def check_dems(files: Sequence[Path]) -> None:
    """Raise ConfigError or MissingExtraError if elevation models with these names cannot be written."""
    for file in files:
        if file.suffix not in SUFFIXES:
            raise ConfigError(f"'--dem {file}': the name must end in {', '.join(SUFFIXES)}")
    if any(file.suffix in geotiff.SUFFIXES for file in files):
        geotiff.load_rasterio()


def save_dem(path: Path, grid: TerrainGrid) -> None:
    """Write a grid in the format that the ending of the name gives."""
    model, suffix = grid.elevation, path.suffix
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
            np.savez_compressed(temporary, **of_model, **others)
        elif not cv2.imwrite(str(temporary), shaded_heights(model)):
            raise OutputError(f"cannot write '{path}': the image could not be encoded")


# ---- the image of an elevation model


def shaded_heights(model: ElevationModel) -> ColourImage:
    """Return heights as colours, shaded by their slopes, with one pixel per cell and y of LM upwards.

    Gaps of one or two cells are filled for display.
    """
    weight = np.isfinite(model.height_m).astype(np.float32)
    weighted = np.where(weight > 0, model.height_m, 0.0)
    total, near_share = (cv2.GaussianBlur(image, (0, 0), 1.0) for image in (weighted, weight))
    near = np.asarray(total / np.maximum(near_share, 1e-6), np.float32)
    near[near_share < BRIDGED_SHARE] = np.nan
    heights = np.where(weight > 0, model.height_m, near)
    known = np.isfinite(heights)
    low, high = np.quantile(heights[known], HEIGHT_QUANTILES) if known.any() else (0.0, 1.0)
    filled = np.where(known, heights, np.float32(np.nanmedian(model.height_m) if known.any() else 0.0))
    slope_y, slope_x = np.gradient(filled.astype(np.float64), model.cell_m) if min(filled.shape) > 1 else (0.0, 0.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    shade = np.asarray(AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, 1.3))
    level = np.rint(255.0 * np.clip((filled - low) / max(high - low, 1e-6), 0.0, 1.0)).astype(np.uint8)
    image = np.where(known[..., None], cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS) * shade[..., None], VOID)
    return np.clip(image, 0.0, 255.0).astype(np.uint8)[::-1]
