"""The files that `sfr map` and `sfr convert` write of a map: cloud, elevation models, coloured cloud, covariances.

One grid, that of the topics, is in all files of an elevation model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.config import build, flatten
from sfr_loc_map.errors import ConfigError, InputError, OutputError
from sfr_loc_map.geometry.arrays import ColourImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io import geotiff
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud, save_cloud
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.elevation import ElevationModel, point_covariances
from sfr_loc_map.mapping.terrain.grid import TerrainGrid, elevation_grid
from sfr_loc_map.pipeline.kernels import load_kernels
from sfr_loc_map.pipeline.offline import MapRun

SUFFIXES = (".npz", *geotiff.SUFFIXES, ".png", ".html")  # of files of an elevation model
BESIDE = ("dem.npz", "dem.png")  # endings of the files beside the cloud that a cell's side alone asks for
COLOURED_TYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("sigma", "<f4")]
)
HEIGHT_QUANTILES = (0.01, 0.99)
"""Heights between these fill the range of colours; what is beyond takes the colour at the end."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35
BRIDGED_SHARE = 0.1  # of weighted neighbours that must have a height for a gap to be bridged in the image
RIM_SHARE = 0.01
VOID = (32, 32, 32)
LONGER_SIDE = 800  # pixels of the plotted area
LEFT, TOP, RIGHT, BOTTOM = 80, 40, 150, 70  # margins around it, pixels
BAR_WIDTH = 22
TICKS = 6  # about so many an axis
INK, PAPER = (40, 40, 40), (255, 255, 255)
FONT, FONT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.45


@dataclass(frozen=True, slots=True)
class MapOutputs:
    """Which files to write."""

    cloud: Path  # all others lie beside it, or have names of their own
    fuse: bool  # whether it is the fused cloud, or holds the points of every pair
    dem: tuple[Path, ...]  # files of an elevation model
    terrain: TerrainConfig  # size of its cells, and what its other layers need
    colour: bool  # a PLY coloured by height
    covariance: bool  # of each point

    @property
    def coloured_ply(self) -> Path:
        """Place of the coloured cloud."""
        return self.cloud.with_suffix(".colour.ply")

    @property
    def covariances(self) -> Path:
        """Place of the covariances."""
        return self.cloud.with_suffix(".covariance.npz")

    @property
    def more(self) -> list[Path]:
        """Files besides the cloud."""
        return [*self.dem, *([self.coloured_ply] * self.colour), *([self.covariances] * self.covariance)]


def save_map(run: MapRun, focal_px: float, outputs: MapOutputs) -> PointCloud:
    """Write the files of a map, and return the cloud."""
    cloud = run.fused.cloud if outputs.fuse else run.unfused
    save_cloud(outputs.cloud, cloud)
    if not outputs.more:
        return cloud
    T_lm_left = run.fused.T_lm_left if outputs.fuse else tuple(item.view.T_lm_left for item in run.maps)
    random_sigma = run.fused.random_sigma if outputs.fuse else run.unfused_random_sigma
    if outputs.dem:
        load_kernels("terrain")
        grid = elevation_grid(cloud, outputs.terrain, T_lm_left, random_sigma)
        for path in outputs.dem:
            save_dem(path, grid)
    if outputs.colour:
        save_coloured_ply(outputs.coloured_ply, cloud)
    if outputs.covariance:
        with atomic_path(outputs.covariances) as temporary:
            covariances = point_covariances(cloud, T_lm_left, focal_px)
            np.savez_compressed(temporary, covariance_m2=covariances, random_sigma_m=random_sigma)
    return cloud


def save_coloured_ply(path: Path, cloud: PointCloud) -> None:
    """Write a PLY with x, y, z, red, green, blue and sigma: colour by height, brightness of the image."""
    colours = height_colours(cloud.xyz[:, 2], height_range(cloud.xyz[:, 2])) if len(cloud) else np.zeros((0, 3))
    bright = max(float(np.quantile(cloud.intensity, 0.95)), 1.0) if len(cloud) else 1.0
    lit = np.clip(colours * np.clip(cloud.intensity / bright, 0.2, 1.2)[:, None], 0.0, 255.0).astype(np.uint8)
    records = np.empty(len(cloud), COLOURED_TYPE)
    records["x"], records["y"], records["z"] = cloud.xyz.T
    records["blue"], records["green"], records["red"] = lit.T
    records["sigma"] = cloud.sigma
    kinds = {"f4": "float", "u1": "uchar"}
    properties = [f"property {kinds[COLOURED_TYPE[name].str[1:]]} {name}" for name in COLOURED_TYPE.names or ()]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}", *properties, "end_header"]
    with atomic_path(path) as temporary:
        temporary.write_bytes(("\n".join(head) + "\n").encode() + records.tobytes())


# ---- elevation models


def dem_outputs(words: Sequence[str], cloud: Path, terrain: TerrainConfig) -> tuple[tuple[Path, ...], TerrainConfig]:
    """Return the files that the values of `--dem` ask for, and the parameters of their grid.

    Each value is a file, or the side of a cell in metres: that of the grid, whose files then lie beside the cloud.
    """
    files: list[Path] = []
    sides = []
    for word in words:
        if Path(word).suffix in SUFFIXES:
            files.append(Path(word))
            continue
        try:
            sides.append(float(word))
        except ValueError as error:
            names = ", ".join(f"*{suffix}" for suffix in SUFFIXES)
            raise ConfigError(f"'--dem {word}': give the side of a cell in metres, or a file {names}") from error
        if not sides[-1] > 0.0:
            raise ConfigError(f"'--dem {sides[-1]}': the side of a cell must be more than 0")
        files += [cloud.with_suffix(f".{ending}") for ending in BESIDE]
    if len(sides) > 1:
        raise ConfigError(f"'--dem' has {len(sides)} sides of a cell: give one, and the names of files")
    if any(file.suffix in geotiff.SUFFIXES for file in files):
        geotiff.load_rasterio()
    return tuple(files), with_cell(terrain, sides[0]) if sides else terrain


def with_cell(terrain: TerrainConfig, cell_m: float) -> TerrainConfig:
    """Return parameters with another side of a cell."""
    return build(TerrainConfig, {**flatten(terrain), "cell_m": cell_m}, origin="side of a cell")


def grid_of_file(loaded: LoadedCloud, terrain: TerrainConfig) -> TerrainGrid:
    """Return the grid of a cloud that was read.

    A file does not say where the cameras were: all its points count, and the sigma of heights is overstated. Where it
    has no sigma, all points weigh the same and heights have none.
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
    """Write a grid; the format is that of the name's ending.

    An archive has the layers (rows along y, columns along x of LM), x and y of the outer corner of cell (0, 0), the
    side of a cell.
    """
    model, suffix = grid.elevation, path.suffix
    if suffix in geotiff.SUFFIXES:
        geotiff.save_geotiff(path, dem_bands(grid), model.origin_m, model.cell_m)
        return
    with atomic_path(path) as temporary:
        if suffix == ".npz":
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
        elif suffix == ".html":
            from sfr_loc_map.report.dem_page import dem_page  # few maps have a page

            temporary.write_text(dem_page(dem_bands(grid), model.origin_m, model.cell_m), encoding="utf-8")
        elif not cv2.imwrite(str(temporary), elevation_figure(model)):
            raise OutputError(f"cannot write '{path}': the image could not be encoded")


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


# ---- the figure of an elevation model


def elevation_figure(model: ElevationModel) -> ColourImage:
    """Return heights coloured and shaded, with axes in metres, a scale and a colour bar; y of LM upwards."""
    image, (x0, y0), range_m = shaded_heights(model)
    rows, columns = image.shape[:2]
    across, up = columns * model.cell_m, rows * model.cell_m
    zoom = LONGER_SIDE / max(rows, columns)
    width, height = max(1, round(columns * zoom)), max(1, round(rows * zoom))
    canvas = np.full((TOP + max(height, 200) + BOTTOM, LEFT + max(width, 200) + RIGHT, 3), PAPER, np.uint8)

    def write(text: str, column: int, row: int, share_left: float = 0.0) -> None:
        (length, _), _ = cv2.getTextSize(text, FONT, FONT_SIZE, 1)
        column -= length // 2 if share_left == 0.5 else length if share_left else 0
        cv2.putText(canvas, text, (column, row), FONT, FONT_SIZE, INK, 1, cv2.LINE_AA)

    method = cv2.INTER_NEAREST if zoom >= 1.0 else cv2.INTER_AREA
    canvas[TOP : TOP + height, LEFT : LEFT + width] = cv2.resize(image[::-1], (width, height), None, 0, 0, method)
    cv2.rectangle(canvas, (LEFT - 1, TOP - 1), (LEFT + width, TOP + height), INK)
    for x in ticks(x0, x0 + across):
        column, row = LEFT + round((x - x0) / across * width), TOP + height
        cv2.line(canvas, (column, row), (column, row + 5), INK)
        write(f"{x:g}", column, row + 18, 0.5)
    for y in ticks(y0, y0 + up):
        row = TOP + height - round((y - y0) / up * height)
        cv2.line(canvas, (LEFT - 6, row), (LEFT - 1, row), INK)
        write(f"{y:g}", LEFT - 10, row + 4, 1.0)
    write("x of LM, m", LEFT + width // 2, TOP + height + 36, 0.5)
    write("y of LM, m", 8, TOP - 14)

    low, high = range_m
    bar, length = LEFT + width + 30, max(height, 200)
    levels = np.linspace(high, low, length, dtype=np.float32)[:, None]
    canvas[TOP : TOP + length, bar : bar + BAR_WIDTH] = height_colours(levels, range_m)
    cv2.rectangle(canvas, (bar - 1, TOP - 1), (bar + BAR_WIDTH, TOP + length), INK)
    for level in ticks(low, high):
        row = TOP + round((high - level) / (high - low) * (length - 1))
        cv2.line(canvas, (bar + BAR_WIDTH, row), (bar + BAR_WIDTH + 5, row), INK)
        write(f"{level:g}", bar + BAR_WIDTH + 9, row + 4)
    write("height, m", bar - 4, TOP - 14)

    px_per_m = width / across
    scale_m = _round_step(width / px_per_m / 5.0)  # about a fifth of the width
    end, row = LEFT + round(scale_m * px_per_m), TOP + height + 58
    cv2.rectangle(canvas, (LEFT, row - 6), (end, row), INK, cv2.FILLED)
    write(f"{scale_m:g} m", end + 8, row)
    return canvas


def shaded_heights(model: ElevationModel) -> tuple[ColourImage, tuple[float, float], tuple[float, float]]:
    """Return heights as colours, shaded by their slopes; x and y of the outer corner; heights at the colours' ends.

    For the look of it gaps of a cell or two are bridged, and sparse rows and columns at the rim are left out.
    """
    spans = []
    for axis in (1, 0):  # the rows and columns between which nearly all cells with points lie
        share = np.cumsum((model.count > 0).sum(axis=axis)) / (model.count > 0).sum()
        first, last = np.searchsorted(share, RIM_SHARE), np.searchsorted(share, 1.0 - RIM_SHARE)
        spans.append(slice(int(first), int(last) + 1))
    rows, columns = spans
    weight = np.isfinite(model.height_m).astype(np.float32)
    weighted = np.where(weight > 0, model.height_m, 0.0)
    total, near_share = (cv2.GaussianBlur(image, (0, 0), 1.0) for image in (weighted, weight))
    near = np.asarray(total / np.maximum(near_share, 1e-6), np.float32)
    near[near_share < BRIDGED_SHARE] = np.nan
    heights = np.where(weight > 0, model.height_m, near)[rows, columns]
    known = np.isfinite(heights)
    filled = np.where(known, heights, np.float32(np.nanmedian(model.height_m) if known.any() else 0.0))
    slope_y, slope_x = np.gradient(filled.astype(np.float64), model.cell_m) if min(filled.shape) > 1 else (0.0, 0.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    shade = AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, 1.3)
    range_m = height_range(filled[known])
    image = height_colours(filled, range_m) * np.asarray(shade)[..., None]
    image[~known] = VOID
    x, y = model.origin_m
    corner = (x + columns.start * model.cell_m, y + rows.start * model.cell_m)
    return np.asarray(np.clip(image, 0.0, 255.0), np.uint8), corner, range_m


def height_range(height_m: NDArray[np.float32]) -> tuple[float, float]:
    """Return the heights at the two ends of the colours; 0 and 1 without any height."""
    if not height_m.size:
        return 0.0, 1.0
    low, high = np.quantile(height_m, HEIGHT_QUANTILES)
    return float(low), float(max(high, low + 1e-6))


def height_colours(height_m: NDArray[np.float32], range_m: tuple[float, float]) -> ColourImage:
    """Return colours `(..., 3)`, in the order blue, green, red, of heights."""
    level = np.clip((height_m - range_m[0]) / (range_m[1] - range_m[0]), 0.0, 1.0)
    flat = np.asarray(np.rint(255.0 * level), np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(flat, cv2.COLORMAP_VIRIDIS), np.uint8).reshape(*height_m.shape, 3)


def ticks(low: float, high: float) -> list[float]:
    """Return round numbers between two, about `TICKS` of them; their step is 1, 2 or 5 times a power of ten."""
    step = _round_step((high - low) / TICKS)
    return [n * step for n in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _round_step(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value * (1.0 - 1e-9))
