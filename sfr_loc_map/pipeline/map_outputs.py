"""The files that `sfr map` writes: the cloud and what is derived from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.mapping.terrain.elevation import elevation_from_cloud, point_covariances
from sfr_loc_map.pipeline import map_products
from sfr_loc_map.pipeline.offline import MapRun


@dataclass(frozen=True, slots=True)
class MapOutputs:
    """Which files to write.

    Attributes:
        cloud: The cloud; all others lie beside it.
        fuse: Whether it is the fused cloud, or holds the points of every pair.
        dem_cell_m: Side of the cells of an elevation model, > 0, m; None for no model.
        colour: Whether to write a PLY coloured by height.
        covariance: Whether to write the covariance of each point.
    """

    cloud: Path
    fuse: bool = True
    dem_cell_m: float | None = None
    colour: bool = False
    covariance: bool = False

    def __post_init__(self) -> None:
        """Check the cell.

        Raises:
            ConfigError: If it has no size.
        """
        if self.dem_cell_m is not None and not self.dem_cell_m > 0.0:
            raise ConfigError(f"'--dem {self.dem_cell_m}': the side of a cell must be more than 0")

    @property
    def beside(self) -> dict[str, Path]:
        """Files beside the cloud, by their endings."""
        dem = self.dem_cell_m is not None
        wanted = {"dem.npz": dem, "dem.png": dem, "colour.ply": self.colour, "covariance.npz": self.covariance}
        return {ending: self.cloud.with_suffix(f".{ending}") for ending, want in wanted.items() if want}


def save_map(run: MapRun, focal_px: float, outputs: MapOutputs) -> PointCloud:
    """Write the files of a map and return its cloud.

    Raises:
        OutputError: If a file cannot be written.
    """
    cloud = run.fused.cloud if outputs.fuse else run.unfused
    save_cloud(outputs.cloud, cloud)
    beside = outputs.beside
    if not beside:
        return cloud
    T_lm_left = run.fused.T_lm_left if outputs.fuse else tuple(item.view.T_lm_left for item in run.maps)
    random_sigma = run.fused.random_sigma if outputs.fuse else run.unfused_random_sigma
    if outputs.dem_cell_m is not None:
        model = elevation_from_cloud(cloud, T_lm_left, outputs.dem_cell_m, random_sigma)
        map_products.save_elevation(beside["dem.npz"], model)
        map_products.save_elevation_figure(beside["dem.png"], model)
    if outputs.colour:
        map_products.save_coloured_ply(beside["colour.ply"], cloud)
    if outputs.covariance:
        covariances = point_covariances(cloud, T_lm_left, focal_px)
        map_products.save_covariances(beside["covariance.npz"], covariances, random_sigma)
    return cloud


def map_warnings(run: MapRun) -> list[str]:
    """Return what is suspicious about each pair and about their fusion, one line each."""
    pairs = [f"pair {number}: {line}" for number, item in enumerate(run.maps) for line in item.warnings]
    return [*pairs, *run.fused.warnings]
