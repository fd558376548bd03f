"""`sfr map`: stereo pairs to a point cloud, offline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import (
    ConfigOption,
    RemapOption,
    SourceArgument,
    naming,
    open_panorama,
    progress_bar,
    read_config,
)
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, check_suffix, say


@app.command(
    name="map",
    epilog=examples(
        "sfr map data/ -o cloud.ply --stats stats.csv",
        "sfr map panorama.mcap -o cloud.npz --no-fuse",
        "sfr map data/ -o cloud.ply --dem 0.05 --colour --covariance",
    ),
)
def map_cloud(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="C.ply", help="Cloud: .ply, .pcd or .npz.")],
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
        bool, typer.Option("--refine-poses", help="Correct the poses of later pairs by registration of the overlaps.")
    ] = False,
    stats: Annotated[Path | None, typer.Option(metavar="S.csv", help="A row for each call: time, memory, ...")] = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Map up to three stereo pairs, with the same code as the node."""
    from sfr_loc_map.io.cloud_file import SUFFIXES
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.pipeline.map_outputs import MapOutputs, map_warnings, save_map
    from sfr_loc_map.pipeline.offline import map_pairs, save_stats

    check_suffix(output, SUFFIXES)
    outputs = MapOutputs(output, fuse, dem, colour, covariance)
    check_outputs(output, stats, *outputs.beside.values(), overwrite=overwrite, inputs=(source,))
    parameters = read_config(MappingConfig, config, "mapping")
    if refine_poses:
        parameters = replace(parameters, refine_poses=True)
    sequence = open_panorama(source, remap)
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("mapping", total=len(sequence))
        run = map_pairs(sequence, parameters, lambda done: bar.update(task, completed=done))
    cloud = save_map(run, sequence.rig.fx, outputs)
    if stats is not None:
        save_stats(stats, run.records)
    for line in map_warnings(run):
        say(f"Warning: {line}", err=True)
    say(f"{len(cloud)} points of {len(run.maps)} pairs: {output}", err=True)
    for path in outputs.beside.values():
        say(str(path), err=True)
