"""The files that `sfr map` writes: the cloud and what is derived from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.mapping.terrain.elevation import point_covariances
from sfr_loc_map.mapping.terrain.grid import TerrainGrid, elevation_grid
from sfr_loc_map.pipeline import map_products
from sfr_loc_map.pipeline.dem_products import PAGE, DemOutputs, save_dem
from sfr_loc_map.pipeline.load_kernels import load_kernels
from sfr_loc_map.pipeline.offline import MapRun


@dataclass(frozen=True, slots=True)
class MapOutputs:
    """Which files to write.

    Attributes:
        cloud: The cloud; all others lie beside it, or have names of their own.
        fuse: Whether it is the fused cloud, or holds the points of every pair.
        dem: Files of an elevation model; None for none.
        colour: Whether to write a PLY coloured by height.
        covariance: Whether to write the covariance of each point.
    """

    cloud: Path
    fuse: bool = True
    dem: DemOutputs | None = None
    colour: bool = False
    covariance: bool = False

    @property
    def coloured_ply(self) -> Path | None:
        """Place of the coloured cloud, None for none."""
        return self.cloud.with_suffix(".colour.ply") if self.colour else None

    @property
    def covariances(self) -> Path | None:
        """Place of the covariances, None for none."""
        return self.cloud.with_suffix(".covariance.npz") if self.covariance else None

    @property
    def more(self) -> list[Path]:
        """Files besides the cloud."""
        dem = self.dem.files if self.dem is not None else ()
        return [*dem, *(path for path in (self.coloured_ply, self.covariances) if path is not None)]


@dataclass(frozen=True, slots=True)
class SavedMap:
    """What was written.

    Attributes:
        cloud: The cloud.
        terrain: The grid of the elevation model, None without one.
    """

    cloud: PointCloud
    terrain: TerrainGrid | None


def save_map(run: MapRun, focal_px: float, outputs: MapOutputs) -> SavedMap:
    """Write the files of a map, all but pages, and return what is in them.

    Raises:
        MissingExtraError: If a format needs an extra that is not installed.
        OutputError: If a file cannot be written.
    """
    cloud = run.fused.cloud if outputs.fuse else run.unfused
    save_cloud(outputs.cloud, cloud)
    terrain: TerrainGrid | None = None
    if not outputs.more:
        return SavedMap(cloud, terrain)
    T_lm_left = run.fused.T_lm_left if outputs.fuse else tuple(item.view.T_lm_left for item in run.maps)
    random_sigma = run.fused.random_sigma if outputs.fuse else run.unfused_random_sigma
    if outputs.dem is not None:
        load_kernels("terrain")
        terrain = elevation_grid(cloud, outputs.dem.terrain, T_lm_left, random_sigma)
        for path in outputs.dem.files:
            if path.suffix != PAGE:
                save_dem(path, terrain)
    if outputs.coloured_ply is not None:
        map_products.save_coloured_ply(outputs.coloured_ply, cloud)
    if outputs.covariances is not None:
        covariances = point_covariances(cloud, T_lm_left, focal_px)
        map_products.save_covariances(outputs.covariances, covariances, random_sigma)
    return SavedMap(cloud, terrain)


def map_warnings(run: MapRun) -> list[str]:
    """Return what is suspicious about each pair and about their fusion, one line each."""
    pairs = [f"pair {number}: {line}" for number, item in enumerate(run.maps) for line in item.warnings]
    return [*pairs, *run.fused.warnings]
