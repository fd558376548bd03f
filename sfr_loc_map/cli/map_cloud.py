"""`sfr map`: stereo pairs to a point cloud, offline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.common import (
    ConfigOption,
    RemapOption,
    SourceArgument,
    check_output,
    naming,
    parse_remaps,
    progress_bar,
    read_config,
)
from sfr_loc_map.errors import ConfigError, InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfr_loc_map.geometry.cloud import PointCloud
    from sfr_loc_map.geometry.transform import Transform
    from sfr_loc_map.pipeline.offline import MapRun


def map_cloud(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Cloud: .ply, .pcd or .npz.")],
    fuse: Annotated[bool, typer.Option("--fuse/--no-fuse", help="One cloud, or the points of every pair.")] = True,
    dem: Annotated[
        float | None,
        typer.Option(
            metavar="CELL_M", help="Also C.dem.npz and C.dem.png: height, sigma and count of cells this wide."
        ),
    ] = None,
    colour: Annotated[bool, typer.Option("--colour", help="Also C.colour.ply: points coloured by height.")] = False,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Also C.covariance.npz: 3 x 3 of each point, in the cloud's order.")
    ] = False,
    refine_poses: Annotated[
        bool, typer.Option("--refine-poses", help="Move the poses of later pairs to fit where pairs overlap.")
    ] = False,
    stats: Annotated[Path | None, typer.Option(help="CSV with a row for each call: time, memory, ...")] = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Map up to three stereo pairs, with the same code as the node."""
    from sfr_loc_map.io.cloud_file import SUFFIXES, save_cloud
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.pipeline.offline import map_pairs, save_stats

    check_output(output, SUFFIXES)
    check_output(stats)
    products = _products(output, dem=dem is not None, colour=colour, covariance=covariance)
    for path in products.values():
        check_output(path)
    if dem is not None and not dem > 0.0:
        raise ConfigError(f"'--dem {dem}': the side of a cell must be more than 0")
    parameters = read_config(MappingConfig, config, "mapping")
    if refine_poses:
        parameters = replace(parameters, refine_poses=True)
    sequence = open_source(source, parse_remaps(remap)).nav
    if sequence is None:
        raise InputError(f"no mapping pairs in '{source}': give a source that has them")
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("mapping", total=len(sequence))
        run = map_pairs(sequence, parameters, lambda done: bar.update(task, completed=done))
    cloud = run.fused.cloud if fuse else run.unfused
    save_cloud(output, cloud)
    if products:
        T_lm_left = run.fused.T_lm_left if fuse else tuple(item.view.T_lm_left for item in run.maps)
        _save_products(products, cloud, T_lm_left, sequence.rig.fx, dem)
    if stats is not None:
        save_stats(stats, run.records)
    for line in _warnings(run):
        typer.echo(f"Warning: {line}", err=True)
    typer.echo(f"{len(cloud)} points of {len(run.maps)} pairs: {output}", err=True)
    for path in products.values():
        typer.echo(str(path), err=True)


def _products(output: Path, *, dem: bool, colour: bool, covariance: bool) -> dict[str, Path]:
    wanted = {
        "dem.npz": dem,
        "dem.png": dem,
        "colour.ply": colour,
        "covariance.npz": covariance,
    }
    return {ending: output.with_suffix(f".{ending}") for ending, want in wanted.items() if want}


def _save_products(
    products: dict[str, Path], cloud: PointCloud, T_lm_left: Sequence[Transform], focal_px: float, cell_m: float | None
) -> None:
    from sfr_loc_map.mapping.elevation import elevation_from_cloud, point_covariances
    from sfr_loc_map.pipeline import map_products

    if cell_m is not None:
        model = elevation_from_cloud(cloud, T_lm_left, cell_m)
        map_products.save_elevation(products["dem.npz"], model)
        map_products.save_elevation_figure(products["dem.png"], model)
    if "colour.ply" in products:
        map_products.save_coloured_ply(products["colour.ply"], cloud)
    if "covariance.npz" in products:
        map_products.save_covariances(products["covariance.npz"], point_covariances(cloud, T_lm_left, focal_px))


def _warnings(run: MapRun) -> list[str]:
    """Return what is suspicious about each pair and about their fusion, one line each."""
    pairs = [f"pair {number}: {line}" for number, item in enumerate(run.maps) for line in item.warnings]
    return [*pairs, *run.fused.warnings]
